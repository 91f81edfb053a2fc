"""Figures for print: rate curves, bars by stage, and maps, as evaluators declare them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure

from codecbench.core.analysis.run_result import Column, RunResult
from codecbench.core.analysis.verdicts import intervals
from codecbench.core.contracts.errors import ParamsError
from codecbench.core.contracts.view import Drawing
from codecbench.core.engine.identity import content_digest
from codecbench.core.engine.planning.model import SequenceEntry
from codecbench.core.engine.storage.atomic import open_whole
from codecbench.core.report.views import (
    FAILED,
    PALETTE,
    STROKES,
    Bars,
    CellDrawing,
    CurveView,
    bars_views,
    curve_views,
    first_view,
    map_views,
    styles_of,
)

matplotlib.use("Agg")


STYLE: Final[Any] = {
    "font.size": 9, "axes.grid": True, "grid.alpha": 0.3, "axes.spines.top": False, "axes.spines.right": False,
    "figure.constrained_layout.use": True, "svg.hashsalt": "codecbench", "legend.frameon": False,
    "text.parse_math": False,
}  # fmt: skip

_NAME_BYTES: Final = 200
_NAME_LETTERS: Final = 40
"""Letters that are left of a longer name, before a digest of the whole."""

_FEWEST_TICKS: Final = 3
_MOST_TICKS: Final = 9
_HATCHES: Final = ("", "////", "||||", "xxxx")


def draw_all(run: RunResult, folder: Path, format_: str = "svg") -> Iterator[Path]:
    """Draw every figure that shows a difference into `folder`, and yield the path of each.

    Metrics that are the same for all codecs of a sequence, and maps of only the truth, get no figure.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with plt.rc_context(STYLE):
        for name, figure in _figures(run):
            path = folder / f"{name}.{format_}"
            with open_whole(path) as stream:
                figure.savefig(stream, format=format_, dpi=160, metadata={"Date": None} if format_ == "svg" else None)
            plt.close(figure)
            yield path


def _figures(run: RunResult) -> Iterator[tuple[str, Figure]]:
    over_rate = [view for view in curve_views(run) if view.x == run.rate]
    for entry in run.plan.sequences:
        rows = run.wide[run.wide["sequence"] == entry.name]
        for view in over_rate:
            figure = curve_figure(run, entry, view) if len(rows) == 1 or rows[view.y.name].nunique() > 1 else None
            if figure is not None:
                yield _file_name(entry.name, "rate", view.y.metric.name, view.y.evaluator.label), figure
    yield from map_figures(run)
    for bars in bars_views(run):
        stacks = bars_figure(run, bars)
        if stacks is not None:
            yield _file_name(bars.name), stacks


def curve_figure(run: RunResult, entry: SequenceEntry, view: CurveView) -> Figure | None:
    """Draw one line a curve, through its settings in order; None if no setting has both values.

    Error bars are 95 % confidence intervals, see `intervals`. Baselines are level lines and bands over the range of the
    others, whose rates they would otherwise press into a corner.
    """
    ends = intervals(run, view.y)
    baselines = {run.curves[key].curve for key in run.curves if key[0] in run.schema.baselines}
    lines: dict[str, list[tuple[float, float, float, float, float]]] = {}
    for row in run.wide[run.wide["sequence"] == entry.name].to_dict("records"):
        value, place = _displayed_value(row, view.y), run.curves[row["codec"], row["setting"]]
        low, high = ends.get((entry.name, row["codec"], row["setting"]), (math.nan, math.nan))
        down, up = (
            (max(0.0, value - low * view.y.factor), max(0.0, high * view.y.factor - value))
            if math.isfinite(high - low)
            else (0.0, 0.0)
        )
        point = (place.place, _displayed_value(row, view.x), value, down, up)
        if all(map(math.isfinite, point[1:3])):
            lines.setdefault(place.curve, []).append(point)
    if not lines:
        return None
    figure, axes = plt.subplots(figsize=(5.2, 4.0))
    handles = []
    styles = styles_of(run)
    for curve, points in lines.items():
        points.sort()
        style = styles[curve]
        if curve in baselines and len(points) == 1 and not baselines.issuperset(lines):
            _, _, value, down, up = points[0]
            axes.axhspan(value - down, value + up, color=style.color, alpha=0.15, linewidth=0)
            handles.append(axes.axhline(value, color=style.color, linestyle=style.linestyle, linewidth=1.2))
            continue
        _, across, values, *bars = zip(*points, strict=True)
        drawn = axes.errorbar(
            across, values, bars, label=curve, color=style.color, marker=style.marker,
            linestyle=style.linestyle, markersize=4, linewidth=1.2, elinewidth=0.6, capsize=2,
        )  # fmt: skip
        handles.append(drawn.lines[0])
    _scale(axes.xaxis, view.x)
    _scale(axes.yaxis, view.y)
    axes.set(xlabel=view.x.heading, ylabel=view.y.heading, title=entry.name)
    _legend_below(figure, handles, list(lines), columns=2, fontsize=7)
    return figure


def _scale(axis: Any, column: Column) -> None:
    """Set the scale that a metric declares; logarithmic axes have ticks at 1, 2 and 5, at 1, or evenly spaced ones."""
    if column.metric.scale == "log":
        getattr(axis.axes, f"set_{axis.axis_name}scale")("log")
        low, high = axis.get_view_interval()
        locator: Any = matplotlib.ticker.MaxNLocator(5)
        for subs in ((1.0,), (1.0, 2.0, 5.0)):
            steps = matplotlib.ticker.LogLocator(subs=subs, numticks=_MOST_TICKS)
            if _FEWEST_TICKS <= sum(low <= tick <= high for tick in steps.tick_values(low, high)) <= _MOST_TICKS:
                locator = steps
        axis.set_major_locator(locator)
        axis.set_major_formatter(matplotlib.ticker.FormatStrFormatter("%g"))
        axis.set_minor_formatter(matplotlib.ticker.NullFormatter())


def _displayed_value(row: dict[Any, Any], column: Column) -> float:
    """A value of the table in the displayed unit."""
    return float(row[column.name]) * column.factor


def map_figures(run: RunResult) -> Iterator[tuple[str, Figure]]:
    """Draw small multiples for each sequence and codec over its settings, of the first repeat."""
    for view in map_views(run):
        groups: dict[tuple[str, str, str], list[CellDrawing]] = {}
        with_path = set()
        for drawn in view.drawings:
            cell = drawn.result.cell
            groups.setdefault((cell.sequence.name, cell.codec.name, cell.evaluator.label), []).append(drawn)
            if any(line.stroke != "truth" for line in drawn.drawing.lines):
                with_path.add(cell.sequence.name)
        for (sequence, codec, label), members in groups.items():
            if sequence not in with_path:
                continue
            title = f"{sequence}: {codec} {label}".strip()
            yield _file_name(sequence, view.name, codec, label), _multiples(title, members)


def _multiples(title: str, members: list[CellDrawing]) -> Figure:
    across = min(4, len(members))
    down = math.ceil(len(members) / across)
    figure, grid = plt.subplots(down, across, figsize=(max(3.6, 2.6 * across), 2.7 * down + 0.5), squeeze=False)
    for axes in grid.flat[len(members) :]:
        axes.set_visible(False)
    for axes, drawn in zip(grid.flat, members, strict=False):
        codec = drawn.result.cell.codec
        _draw(axes, codec.label or codec.name, drawn.drawing)
    handles = {
        label: handle for axes in grid.flat for handle, label in zip(*axes.get_legend_handles_labels(), strict=True)
    }
    _legend_below(figure, list(handles.values()), list(handles), columns=3, fontsize=8)
    figure.suptitle(title, fontsize=10)
    return figure


def _draw(axes: Any, name: str, drawing: Drawing) -> None:
    for line in drawing.lines:
        style = STROKES[line.stroke]
        axes.plot(*line.points.T, label=line.name, color=style.color, linestyle=style.dash, linewidth=style.width)
    axes.set_xlabel(drawing.labels[0], fontsize=6)
    axes.set_ylabel(drawing.labels[1], fontsize=6)
    if not drawing.axes:
        axes.set_aspect("equal", adjustable="datalim")
    axes.set_title(f"{name}\n{drawing.caption}", fontsize=7, color=FAILED if drawing.holds is False else "black")
    axes.tick_params(labelsize=6)


def bars_figure(run: RunResult, bars: Bars) -> Figure | None:
    """Draw stacked stages of the first sequence: a row a metric, a picture a direction; None if it has none."""
    sequence = run.plan.sequences[0].name
    stacks: dict[str, dict[str, dict[str, dict[str, float]]]] = {}
    for part in bars.parts:
        if part.sequence == sequence:
            stages = stacks.setdefault(part.choice, {}).setdefault(part.direction, {})
            stages.setdefault(part.stage, {})[part.setting] = part.value
    if not stacks:
        return None
    names = list(dict.fromkeys(part.stage for part in bars.parts))
    directions = list(dict.fromkeys(part.direction for part in bars.parts))
    settings = {
        choice: list(
            dict.fromkeys(setting for stages in pictures.values() for stage in stages.values() for setting in stage)
        )
        for choice, pictures in stacks.items()
    }
    heights = [0.16 * len(known) + 0.7 for known in settings.values()]
    figure, grid = plt.subplots(
        len(stacks), len(directions), figsize=(2.0 + 2.8 * len(directions), sum(heights) + 0.25 * len(names) / 4 + 0.4),
        squeeze=False, sharey="row", height_ratios=heights,
    )  # fmt: skip
    for row, (choice, pictures) in zip(grid, stacks.items(), strict=True):
        for axes, direction in zip(row, directions, strict=True):
            _stack(axes, settings[choice], pictures.get(direction, {}), names)
            axes.set_title(f"{choice}, {direction}", fontsize=8)
            axes.set_xlabel(f"{bars.unit} a frame", fontsize=7)
        row[0].invert_yaxis()
    swatches = [matplotlib.patches.Patch(**_fill(at)) for at in range(len(names))]
    _legend_below(figure, swatches, names, columns=4, fontsize=7)
    return figure


def _legend_below(figure: Figure, handles: list[Any], names: list[str], columns: int, fontsize: int) -> None:
    """Add a legend in so many columns, or as many as fit the figure's width: names may be long."""
    for ncols in range(columns, 0, -1):
        legend = figure.legend(handles, names, loc="outside lower center", ncols=ncols, fontsize=fontsize)
        if ncols == 1 or legend.get_window_extent().width <= figure.bbox.width:
            return
        legend.remove()


def _stack(axes: Any, settings: list[str], stages: dict[str, dict[str, float]], names: list[str]) -> None:
    starts = np.zeros(len(settings))
    for at, name in enumerate(names):
        values = np.array([stages.get(name, {}).get(setting, 0.0) for setting in settings])
        axes.barh(settings, values, left=starts, **_fill(at))
        starts += values
    axes.tick_params(labelsize=6)
    axes.grid(visible=False, axis="y")
    axes.set_axisbelow(True)


def _fill(at: int) -> dict[str, Any]:
    """Color and pattern of a stage; patterns distinguish those of equal color."""
    turns, color = divmod(at, len(PALETTE))
    return {
        "facecolor": PALETTE[color],
        "hatch": _HATCHES[turns % len(_HATCHES)],
        "edgecolor": "white",
        "linewidth": 0,
    }


def _file_name(*parts: str) -> str:
    """Join the non-empty parts by dashes, with letters and a length that every file system allows."""
    name = "-".join(
        "".join(letter if letter.isalnum() or letter in "._-" else "_" for letter in part) for part in parts if part
    )
    if len(name.encode()) <= _NAME_BYTES:
        return name
    return f"{name[:_NAME_LETTERS]}-{content_digest(name.encode())[:8]}"


def one_figure(run: RunResult, what: str = "", sequence: str | None = None) -> Figure:
    """See `RunResult.plot`."""
    views, names = curve_views(run), [entry.name for entry in run.plan.sequences]
    if sequence is not None and sequence not in names:
        raise ParamsError(f"the run has no sequence {sequence!r}; it has {', '.join(names)}")
    across, _, up = what.partition("-")
    matches = [view for view in views if _matches(view.x, across) and _matches(view.y, up)]
    if not what:
        matches = [view for view in [first_view(run)] if view is not None]
    for entry in run.plan.sequences:
        if sequence in (None, entry.name):
            for view in matches:
                with plt.rc_context(STYLE):
                    figure = curve_figure(run, entry, view)
                if figure is not None:
                    plt.close(figure)  # the caller's alone: pyplot would show it a second time in a notebook
                    return figure
    there = ", ".join(dict.fromkeys(f"{view.x.metric.name}-{view.y.metric.name}" for view in views))
    raise ParamsError(f"no figure {what!r} of {sequence or 'any sequence'}; there are {there or 'none'}")


def _matches(column: Column, word: str) -> bool:
    """Whether the word occurs in the column's names or role."""
    return (
        word.lower()
        in f"{column.metric.name} {column.label} {column.metric.column_header} {column.metric.role}".lower()
    )
