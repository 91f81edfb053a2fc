"""The views of a run and their styles: curves by the roles of its metrics, and the views that evaluators declare."""

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
    """Part of a bar: the share of one stage in a metric under one codec setting."""

    choice: str
    """The label of the metric."""
    direction: str
    stage: str
    sequence: str
    setting: str
    value: float


@dataclass(frozen=True)
class Bars:
    """A view of kind `bars` with its parts."""

    name: str
    """Of the evaluator."""
    view: View
    unit: str
    parts: tuple[Bar, ...]


@dataclass(frozen=True)
class CellDrawing:
    """A drawing and its cell."""

    result: CellResult
    drawing: Drawing


@dataclass(frozen=True)
class Map:
    """A view of kind `map` with the drawings of its cells' first repeats."""

    name: str
    """Of the evaluator."""
    view: View
    drawings: tuple[CellDrawing, ...]


def curve_views(run: RunResult) -> list[CurveView]:
    """The curves that the page offers, in order.

    These are quality and tasks over the rate, the views that evaluators declare, the first quality over times, and
    tasks over tasks of other evaluators; if there are none of these, any headline over another.
    """
    rate, qualities, tasks = run.rate, run.headlines("quality"), run.headlines("task")
    pairs: list[tuple[str, Column, Column]] = [] if rate is None else [("", rate, y) for y in (*qualities, *tasks)]
    pairs += list(_declared_curves(run))
    pairs += [("", time, qualities[0]) for time in run.headlines("time") if qualities]
    pairs += [("", x, y) for x, y in combinations(tasks, 2) if x.evaluator.name != y.evaluator.name]
    pairs = pairs or [("", x, y) for x, y in combinations(run.headlines(), 2)]
    return [CurveView(title or _title(x, y), x, y) for title, x, y in pairs]


def first_view(run: RunResult) -> CurveView | None:
    """The curve that is shown first: over the rate, the criterion of which most settings have a value.

    A search measures some criteria at few settings only.
    """
    judged = judged_column(run)
    columns = [judged, *(column for group in criteria(run) for column in group)]
    views = [view for view in curve_views(run) if view.x == run.rate and view.y in columns]
    values = run.wide.notna().sum()
    return max(views, key=lambda view: (values[view.y.name], view.y == judged), default=None)


@dataclass(frozen=True)
class Pick:
    """The setting that the answer names of a curve: the last that passes, or else the nearest."""

    codec: str
    setting: str
    passes: bool


def answer_picks(run: RunResult, link: str = "") -> list[Pick]:
    """A setting of each curve, that of the answer first; for a run over links, those that pass over one of them."""
    points: dict[str, tuple[str, bool]] = {}
    if links := links_with_readers(run):
        settings = candidates(run, Demand(link or links[0]))
        for setting in settings:
            if setting.verdict == "passes" and setting.sequence == settings[0].sequence:
                points.setdefault(setting.curve, (setting.point, True))
    else:
        for answer in answers_of_settings(run)[0].answers:
            if answer.setting:
                points[answer.curve] = answer.setting.point, answer.setting is answer.limit.lowest
    keys = {(point.curve, point.point): key for key, point in run.curves.items()}
    return [Pick(*keys[curve, point], passes) for curve, (point, passes) in points.items()]


def bounds(run: RunResult) -> dict[str, dict[str, float]]:
    """The bounds of columns by name and sequence, in the unit of the table, as far as they are numbers."""
    by_column: dict[str, dict[str, float]] = {}
    for columns in criteria(run):
        for (sequence, *_), test in tests_of(run, columns).items():
            for part in parts(test):
                if isinstance(part, Level) and math.isfinite(part.bound):
                    by_column.setdefault(part.column.name, {}).setdefault(sequence, part.bound)
    return by_column


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
    bars = []
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
            bars.append(Bars(title, view, columns[0].unit, parts))
    return bars


def _bars(run: RunResult, column: Column) -> Iterator[Bar]:
    direction, _, stage = column.stage.partition("/")
    for record in run.wide[["sequence", "codec", "setting", column.name]].to_dict("records"):
        value = float(record[column.name])
        if not math.isnan(value):
            setting = f"{record['codec']} {record['setting']}".strip()
            yield Bar(column.metric.label, direction, stage, record["sequence"], setting, value * column.factor)


def map_views(run: RunResult) -> list[Map]:
    """The drawings that evaluators make of their cells, in the order of the plan."""
    by_view: dict[tuple[str, View], list[CellDrawing]] = {}
    for title, view in _views(run, "map"):
        for result in run.of(title):
            drawing = result.drawing() if result.cell.repeat == 0 else None
            if drawing is not None and drawing.lines:
                by_view.setdefault((result.cell.evaluator.name, view), []).append(CellDrawing(result, drawing))
    order = {result.cell.id: position for position, result in enumerate(run.results)}
    return [
        Map(name, view, tuple(sorted(drawn, key=lambda drawn_cell: order[drawn_cell.result.cell.id])))
        for (name, view), drawn in by_view.items()
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
"""Six colors of Okabe and Ito, which color-blind readers can distinguish, and six that go with them."""
_SEED: Final = 11_705_624
"""Seed of the hash from names to colors; with it those of examples/reference.yaml differ."""
NEUTRAL: Final = "#777777"
"""Color of references: baseline codecs, ground truth."""
FAILED: Final = "#a02020"

_MARKERS: Final = (
    ("o", "circle"), ("s", "square"), ("D", "diamond"), ("^", "triangle-up"), ("P", "cross"), ("X", "x"),
    ("*", "star"), ("h", "hexagon"),
)  # fmt: skip
_DASHES: Final[tuple[tuple[float, ...], ...]] = ((), (5.0, 2.0), (1.5, 1.5), (6.0, 2.0, 1.5, 2.0))


@dataclass(frozen=True)
class CurveStyle:
    """The style of a curve."""

    color: str
    marker: str
    """Name of the marker in matplotlib."""
    symbol: str
    """Name of the marker on the page."""
    dashes: tuple[float, ...] = ()
    """Lengths of dashes and gaps in points."""

    @property
    def linestyle(self) -> tuple[float, tuple[float, ...]] | str:
        """The dashes for matplotlib."""
        return (0.0, self.dashes) if self.dashes else "-"


@dataclass(frozen=True)
class LineStyle:
    """The style of a drawing's line."""

    color: str
    dash: str
    """The dash in matplotlib."""
    dashes: str
    """The dash on the page."""
    width: float
    """In points."""


STROKES: Final[dict[Stroke, LineStyle]] = {
    "truth": LineStyle("#8a8f98", "-", "", 3.6),
    "before": LineStyle(_ORANGE, "--", "3 2", 1.2),
    "after": LineStyle(PALETTE[0], "-", "", 1.4),
}


def curve_styles(curves: Iterable[str], baselines: Iterable[str]) -> dict[str, CurveStyle]:
    """A style for every curve of a run, the same in every figure and on the page.

    A codec's color depends on its name alone, so that it is the same in every run. Up to eight curves of a color, of
    one codec or of several, differ in dashes and markers. baselines: names of codecs whose curves are neutral.
    """
    neutral = set(baselines)
    styles: dict[str, CurveStyle] = {}
    used: Counter[int] = Counter()
    for curve in dict.fromkeys(curves):
        codec = curve.split(" ")[0]
        if codec in neutral:
            styles[curve] = CurveStyle(NEUTRAL, *_MARKERS[0])
            continue
        color = seed_from(codec, _SEED) % len(PALETTE)
        marker, symbol = _MARKERS[(color + used[color]) % len(_MARKERS)]
        styles[curve] = CurveStyle(PALETTE[color], marker, symbol, _DASHES[used[color] % len(_DASHES)])
        used[color] += 1
    return styles


def styles_of(run: RunResult) -> dict[str, CurveStyle]:
    """The style of each curve of a run."""
    return curve_styles((point.curve for point in run.curves.values()), run.schema.baselines)
