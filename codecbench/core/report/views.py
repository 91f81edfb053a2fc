"""What a run offers to draw: curves by the roles of its metrics, and the views that its evaluators declare."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import combinations
from typing import Final

from codecbench.core.analysis.choosing import Demand, candidates, links_with_readers
from codecbench.core.analysis.limits import criteria, tests_of
from codecbench.core.analysis.passing import Level, parts
from codecbench.core.analysis.run_result import Column, RunResult, judged_column
from codecbench.core.analysis.table import CellResult
from codecbench.core.contracts.view import Drawing, Stroke, View, ViewKind
from codecbench.core.engine.identity import seed_from
from codecbench.core.report.answers import answers_of_settings


@dataclass(frozen=True)
class CurveView:
    """A column over another."""

    title: str
    x: Column
    y: Column


@dataclass(frozen=True)
class Bar:
    """Part of a bar: what one stage takes of a metric under one codec setting."""

    choice: str
    direction: str
    stage: str
    sequence: str
    setting: str
    value: float


@dataclass(frozen=True)
class Bars:
    """A view of kind `bars` with its parts. name: of the evaluator. unit: of the values."""

    name: str
    view: View
    unit: str
    parts: tuple[Bar, ...]


@dataclass(frozen=True)
class CellDrawing:
    """A drawing beside the cell that it is of."""

    result: CellResult
    drawing: Drawing


@dataclass(frozen=True)
class Map:
    """A view of kind `map` with the drawings of its cells' first repeats. name: of the evaluator."""

    name: str
    view: View
    drawings: tuple[CellDrawing, ...]


def curve_views(run: RunResult) -> list[CurveView]:
    """Curves that are offered first.

    Quality and tasks over the rate, then what evaluators declare, then the first quality over times, then one task
    over another evaluator's; where that is nothing, any headline over another.
    """
    rate, qualities, tasks = run.rate, run.headlines("quality"), run.headlines("task")
    pairs: list[tuple[str, Column, Column]] = [] if rate is None else [("", rate, y) for y in (*qualities, *tasks)]
    pairs += list(_declared_curves(run))
    pairs += [("", time, qualities[0]) for time in run.headlines("time") if qualities]
    pairs += [("", x, y) for x, y in combinations(tasks, 2) if x.evaluator.name != y.evaluator.name]
    pairs = pairs or [("", x, y) for x, y in combinations(run.headlines(), 2)]
    return [CurveView(title or _title(x, y), x, y) for title, x, y in pairs]


def first_view(run: RunResult) -> CurveView | None:
    """The curve that is shown first: over the rate, what most settings have a value of among what is judged and asked.

    A search measures some of what is asked at few settings alone.
    """
    judged = judged_column(run)
    asked = [judged, *(column for columns in criteria(run) for column in columns)]
    views = [view for view in curve_views(run) if view.x == run.rate and view.y in asked]
    values = run.wide.notna().sum()
    return max(views, key=lambda view: (values[view.y.name], view.y == judged), default=None)


@dataclass(frozen=True)
class Pick:
    """A setting that the answer names of a curve: the last that passes, or where none does, what came nearest."""

    codec: str
    setting: str
    passes: bool


def answer_picks(run: RunResult, link: str = "") -> list[Pick]:
    """A setting of each curve, that of the answer first; of a run over links, those that pass over one of them."""
    found: dict[str, tuple[str, bool]] = {}
    if links := links_with_readers(run):
        able = candidates(run, Demand(link or links[0]))
        for each in able:
            if each.verdict == "passes" and each.sequence == able[0].sequence:
                found.setdefault(each.curve, (each.point, True))
    else:
        told = answers_of_settings(run)[0].answers
        found = {each.curve: (each.shown.point, each.shown is each.limit.lowest) for each in told if each.shown}
    keys = {(point.curve, point.point): key for key, point in run.curves.items()}
    return [Pick(*keys[curve, point], passes) for curve, (point, passes) in found.items()]


def bounds(run: RunResult) -> dict[str, dict[str, float]]:
    """What is asked of columns by name and sequence, in the unit of the table, where that is a number."""
    found: dict[str, dict[str, float]] = {}
    for columns in criteria(run):
        for (sequence, *_), test in tests_of(run, columns).items():
            for part in parts(test):
                if isinstance(part, Level) and math.isfinite(part.bound):
                    found.setdefault(part.column.name, {}).setdefault(sequence, part.bound)
    return found


def _title(x: Column, y: Column) -> str:
    words = f"{x.label} and {y.label}"
    return words[:1].upper() + words[1:]


def _declared_curves(run: RunResult) -> Iterator[tuple[str, Column, Column]]:
    for title, view in _views(run, "curve"):
        usual = {
            column.metric.name: column
            for column in run.columns.values()
            if column.evaluator.title == title and column.is_usual and "/" not in column.stage
        }
        first, last = (usual.get(name) for name in (view.metrics[0], view.metrics[-1]))
        across = first if len(view.metrics) == 2 else run.rate
        if across is not None and last is not None:
            setting = f" ({last.evaluator.label})" if last.evaluator.label else ""
            yield view.title + setting, across, last


def bars_views(run: RunResult) -> list[Bars]:
    """The bars that evaluators declare, for the stages that the run has."""
    found = []
    for title, view in _views(run, "bars"):
        columns = [
            column
            for metric in view.metrics
            for column in run.columns.values()
            if column.evaluator.title == title
            and column.metric.name == metric
            and column.is_usual
            and "/" in column.stage
        ]
        parts = tuple(part for column in columns for part in _bars(run, column))
        if parts:
            found.append(Bars(title, view, columns[0].unit, parts))
    return found


def _bars(run: RunResult, column: Column) -> Iterator[Bar]:
    direction, _, stage = column.stage.partition("/")
    for record in run.wide[["sequence", "codec", "setting", column.name]].to_dict("records"):
        value = float(record[column.name])
        if not math.isnan(value):
            setting = f"{record['codec']} {record['setting']}".strip()
            yield Bar(column.metric.label, direction, stage, record["sequence"], setting, value * column.factor)


def map_views(run: RunResult) -> list[Map]:
    """The drawings that evaluators make of what their cells left, in the order of the plan."""
    found: dict[tuple[str, View], list[CellDrawing]] = {}
    for title, view in _views(run, "map"):
        for result in run.of(title):
            drawing = result.drawing() if result.cell.repeat == 0 else None
            if drawing is not None and drawing.lines:
                found.setdefault((result.cell.evaluator.name, view), []).append(CellDrawing(result, drawing))
    order = {result.cell.id: position for position, result in enumerate(run.results)}
    return [
        Map(name, view, tuple(sorted(drawn, key=lambda drawn_cell: order[drawn_cell.result.cell.id])))
        for (name, view), drawn in found.items()
    ]


def _views(run: RunResult, kind: ViewKind) -> Iterator[tuple[str, View]]:
    for title, views in run.schema.views.items():
        for view in views:
            if view.kind == kind:
                yield title, view


_ORANGE: Final = "#E69F00"
PALETTE: Final = (
    "#0072B2", "#D55E00", "#5D3A9B", "#994F00", "#009E73", "#005F6B", "#1A85FF", "#CC79A7", "#7F3B08", _ORANGE,
    "#56B4E9", "#882255",
)  # fmt: skip
"""Six colors of Okabe and Ito, which color-blind readers can tell apart, and six that go with them."""
_SEED: Final = 11_705_624
"""Of the hash that gives names their colors: one by which those of examples/reference.yaml differ."""
NEUTRAL: Final = "#777777"
"""What others are compared with: baseline codecs, ground truth."""
FAILED: Final = "#a02020"

_MARKERS: Final = (
    ("o", "circle"), ("s", "square"), ("D", "diamond"), ("^", "triangle-up"), ("P", "cross"), ("X", "x"),
    ("*", "star"), ("h", "hexagon"),
)  # fmt: skip
_DASHES: Final[tuple[tuple[float, ...], ...]] = ((), (5.0, 2.0), (1.5, 1.5), (6.0, 2.0, 1.5, 2.0))


@dataclass(frozen=True)
class CurveStyle:
    """Colour of a curve, the marker's name in matplotlib and on the page, and lengths of dashes and gaps in points."""

    colour: str
    marker: str
    symbol: str
    dashes: tuple[float, ...] = ()

    @property
    def linestyle(self) -> tuple[float, tuple[float, ...]] | str:
        """The dashes as matplotlib takes them."""
        return (0.0, self.dashes) if self.dashes else "-"


@dataclass(frozen=True)
class LineStyle:
    """Colour, dash in matplotlib and on the page, and width in points of a drawing's line."""

    colour: str
    dash: str
    dashes: str
    width: float


STROKES: Final[dict[Stroke, LineStyle]] = {
    "truth": LineStyle("#8a8f98", "-", "", 3.6),
    "before": LineStyle(_ORANGE, "--", "3 2", 1.2),
    "after": LineStyle(PALETTE[0], "-", "", 1.4),
}


def curve_styles(curves: Iterable[str], baselines: Iterable[str]) -> dict[str, CurveStyle]:
    """A style for every curve of a run, the same in every figure and on the page.

    A codec's color is that of its name, in every run and where its plugin is not installed too. Curves of a color, of
    one codec or of several, differ in dashes and markers, up to eight. baselines: names of codecs whose curves are
    neutral.
    """
    neutral = set(baselines)
    styles: dict[str, CurveStyle] = {}
    used: Counter[int] = Counter()
    for curve in dict.fromkeys(curves):
        codec = curve.split(" ")[0]
        if codec in neutral:
            styles[curve] = CurveStyle(NEUTRAL, *_MARKERS[0])
            continue
        colour = seed_from(codec, _SEED) % len(PALETTE)
        marker, symbol = _MARKERS[(colour + used[colour]) % len(_MARKERS)]
        styles[curve] = CurveStyle(PALETTE[colour], marker, symbol, _DASHES[used[colour] % len(_DASHES)])
        used[colour] += 1
    return styles


def styles_of(run: RunResult) -> dict[str, CurveStyle]:
    """How each curve of a run is drawn."""
    return curve_styles((point.curve for point in run.curves.values()), run.schema.baselines)
