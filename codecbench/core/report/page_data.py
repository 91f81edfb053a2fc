"""The data of the report's script, as JSON types: rows, columns, views and their styles."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any, Final

import numpy as np

from codecbench.core.analysis.ranking import NO_COMMON_RATE, Ranking, rankings_on
from codecbench.core.analysis.run_result import Column, RunResult
from codecbench.core.analysis.table import json_value
from codecbench.core.analysis.verdicts import (
    intervals,
    pareto_criteria,
    pareto_settings,
    spread,
)
from codecbench.core.contracts.view import FrameTimeline, TimelineRow
from codecbench.core.report.formatting import signed_percent, uninformative_notes
from codecbench.core.report.tables import caveats, three_digits
from codecbench.core.report.views import (
    PALETTE,
    STROKES,
    Map,
    answer_picks,
    bars_views,
    bounds,
    curve_views,
    first_view,
    map_views,
    styles_of,
)

_MOST_POINTS = 400
_FEWEST_POINTS = 60
_ALL_POINTS = 60_000
"""Points of a line that the page stores, at most and at least, and about the total of all lines."""
_STEPS = 4000
"""Steps over the span of a drawing, to which coordinates are rounded."""


def page_data(run: RunResult) -> dict[str, Any]:
    """Everything that the page draws except frames."""
    columns = {name: column for name, column in run.columns.items() if "/" not in column.stage}
    views, first = curve_views(run), first_view(run)
    return {
        "name": run.plan.name,
        "table": table(run),
        "columns": {name: _column(column) for name, column in columns.items()},
        "sequences": [entry.name for entry in run.plan.sequences],
        "baselines": sorted(run.schema.baselines),
        "styles": {curve: asdict(style) for curve, style in styles_of(run).items()},
        "strokes": {name: asdict(style) for name, style in STROKES.items()},
        "palette": PALETTE,
        "presets": [{"title": view.title, "x": view.x.name, "y": view.y.name} for view in views],
        "first": 0 if first is None else views.index(first),
        "asked": bounds(run),
        "picks": [asdict(pick) for pick in answer_picks(run)],
        "intervals": _intervals(run),
        "rate": run.rate.name if run.rate else None,
        "brief": [column.name for column in run.headlines()],
        "bars_views": [
            {
                "title": bars.view.title,
                "note": bars.view.note,
                "unit": bars.unit,
                "parts": [asdict(part) for part in bars.parts],
            }
            for bars in bars_views(run)
        ],
        "map_views": maps(run),
    }


def table(run: RunResult) -> dict[str, list[Any]]:
    """The wide table by column, as JSON types: infinities as text, missing values as null."""
    wide = run.wide
    columns = {str(name): [json_value(value) for value in wide[name].tolist()] for name in wide.columns}
    points = [run.curves[row[1:]] for row in run.rows]
    return columns | {"curve": [point.curve for point in points], "place": [point.place for point in points]}


def _column(column: Column) -> dict[str, Any]:
    metric = column.metric
    return {
        "group": column.evaluator.title,
        "label": column.heading,
        "factor": column.factor,
        "better": column.better,
        "scale": metric.scale,
        "summary": metric.summary,
    }


def _intervals(run: RunResult) -> dict[str, list[list[float] | None]]:
    """The confidence intervals of headlines, row by row of the table."""
    by_column = {column.name: intervals(run, column) for column in run.headlines()}
    return {
        name: [[_round(end) for end in by_row[key]] if key in by_row else None for key in run.rows]
        for name, by_row in by_column.items()
        if by_row
    }


def _round(value: float) -> float:
    return float(f"{value:.6g}")


def maps(run: RunResult) -> list[dict[str, Any]]:
    """The drawings of each map view, of first repeats, with their caveats; equal paths are stored once."""
    return [_map(view) | {"caveats": caveats(run, [view.name])} for view in map_views(run)]


def _map(view: Map) -> dict[str, Any]:
    most = max(_FEWEST_POINTS, min(_MOST_POINTS, _ALL_POINTS // max(1, len(view.drawings))))
    places: dict[str, int] = {}
    paths: list[list[list[float]]] = []

    def path_place(points: np.ndarray, step: float) -> int:
        path = _thin(points, most, step)
        key = json.dumps(path)
        if key not in places:
            places[key] = len(paths)
            paths.append(path)
        return places[key]

    drawings = []
    for drawn in view.drawings:
        cell, drawing = drawn.result.cell, drawn.drawing
        span = max((float(np.ptp(line.points, axis=0).max()) for line in drawing.lines if len(line.points)), default=1)
        step = 10.0 ** np.floor(np.log10(span / _STEPS)) if span > 0 else 1.0
        drawings.append(
            {
                "sequence": cell.sequence.name,
                "codec": cell.codec.name,
                "setting": cell.codec.label,
                "way": cell.evaluator.label,
                "caption": drawing.caption,
                "holds": drawing.holds,
                "axes": list(drawing.labels),
                "is_plane": not drawing.axes,
                "lines": [
                    {"name": line.name, "stroke": line.stroke, "path": path_place(line.points, step)}
                    for line in drawing.lines
                ],
                "timeline": drawing.timeline and _timeline(drawing.timeline, most, step),
            }
        )
    strokes = {line.name: line.stroke for drawn in view.drawings for line in drawn.drawing.lines}
    return {"title": view.view.title, "note": view.view.note, "strokes": strokes, "paths": paths, "drawings": drawings}


def _timeline(timeline: FrameTimeline, most: int, step: float) -> dict[str, Any] | None:
    """Reduce a timeline to at most `most` parts with their largest errors; its rows have parts of their own."""
    count = len(timeline.frames)
    if not count:
        return None
    starts = _starts(count, most)
    worst = np.fmax.reduceat(timeline.errors, starts)
    x, y = (
        (None, None)
        if timeline.positions is None
        else (_steps(timeline.positions[starts, axis], step) for axis in (0, 1))
    )
    return {
        "frames": timeline.frames[starts].tolist(),
        "last": int(timeline.frames[-1]),
        "x": x,
        "y": y,
        "errors": [None if np.isnan(error) else _round(error) for error in worst.tolist()],
        "unit": timeline.unit,
        "quantity": timeline.quantity,
        "rows": [_row(row) for row in timeline.rows],
    }


def _row(row: TimelineRow) -> dict[str, Any]:
    """Reduce a row to a digit for each part: the ninths of its frames that hold, rounded up to hide none."""
    starts = _starts(len(row.holds), _MOST_POINTS)
    shares = np.add.reduceat(row.holds, starts) / np.diff([*starts, len(row.holds)])
    levels = "".join(str(level) for level in np.ceil(9 * shares).astype(int))
    return {"name": row.name, "tone": row.tone, "share": _round(float(row.holds.mean())), "levels": levels}


def _starts(count: int, most: int) -> np.ndarray:
    """The starts of at most `most` equally long parts of a series."""
    return np.linspace(0, count, min(count, most), endpoint=False).astype(int)


def _thin(points: np.ndarray, most: int, step: float) -> list[Any]:
    """Thin a (N, 2) path to at most `most` points, as rounded x and y lists."""
    picks = np.unique(np.linspace(0, len(points) - 1, min(len(points), most)).round().astype(int))
    return [_steps(points[picks, axis], step) for axis in (0, 1)]


def _steps(values: np.ndarray, step: float) -> list[float | None]:
    return [None if np.isnan(value) else _round(round(value / step) * step) for value in values.tolist()]


_LEADS: Final = "on the Pareto front"


def verdict_tables(run: RunResult) -> list[dict[str, Any]]:
    """A table for each sequence, for the template."""
    judged = [column for column in run.headlines("quality", "task") if column.metric.better != "neither"]
    ranges = [column for column in (run.rate, *run.headlines("quality")[:1]) if column is not None]
    times = run.headlines("time")
    heads = ["curve", "settings", "Pareto front", *(column.heading for column in ranges)]
    criteria = pareto_criteria(run)
    tables = []
    for entry in run.plan.sequences:
        wide = run.wide[run.wide["sequence"] == entry.name]
        used, front = pareto_settings(wide, criteria)
        curves: dict[str, list[Any]] = {}
        for record, leads in zip(wide.to_dict("records"), front, strict=True):
            curve = run.curves[record["codec"], record["setting"]].curve
            curves.setdefault(curve, []).append({**record, _LEADS: leads})
        rankings = [ranking for column in judged for ranking in rankings_on(run, column, [[entry.name]])]
        rows = []
        for curve, records in curves.items():
            row = [curve, str(len(records)), f"{sum(record[_LEADS] for record in records)} of {len(records)}"]
            row += [_range(records, column) for column in ranges]
            rows.append([*row, *(spread(_values(records, column)) for column in times)])
        tables.append(
            {
                "sequence": entry.name,
                "heads": [*heads, *(column.heading for column in times)],
                "rows": rows,
                "note": f"Pareto front: settings that no other beats in all of {', '.join(used)}." if used else "",
                "beside": [_difference_table(rankings, anchor, list(curves)) for anchor in _anchors(rankings)],
                "missing": _missing(rankings),
            }
        )
    return tables


def _anchors(rankings: list[Ranking]) -> list[str]:
    """The anchors that any curve was compared with."""
    anchors = dict.fromkeys(anchor for ranking in rankings for anchor in ranking.anchors)
    return [anchor for anchor in anchors if any(_differences(ranking, anchor) for ranking in rankings)]


def _differences(ranking: Ranking, anchor: str) -> dict[str, str]:
    """The additional rate of the curves that were compared with an anchor."""
    if anchor not in ranking.anchors:
        return {}
    by_curve = {ranked.curve: ranking.evidence(ranked.curve, anchor) for ranked in ranking.ranked}
    return {curve: signed_percent(evidence) for curve, evidence in by_curve.items() if evidence}


def _difference_table(rankings: list[Ranking], anchor: str, curves: list[str]) -> dict[str, Any]:
    """The differences from an anchor: a column for each ranking that has some, a row for each curve that has some."""
    columns = {ranking.column.label: cells for ranking in rankings if (cells := _differences(ranking, anchor))}
    rows = [[curve, *(cells.get(curve, "–") for cells in columns.values())] for curve in curves]
    return {
        "title": f"Rate vs. {anchor}",
        "heads": ["curve", *columns],
        "rows": [row for row in rows if set(row[1:]) != {"–"}],
    }


def _missing(rankings: list[Ranking]) -> list[str]:
    """Say why codecs have no rate vs. an anchor, each reason once for all its columns."""
    columns: dict[str, list[str]] = {}
    for ranking in rankings:
        reasons = [f"{curve} is not ranked: {reason}" for curve, reason in ranking.left_out.items()]
        for anchor in ranking.anchors:
            apart = ranking.without_common_rate(anchor)
            reasons += [f"{curve} was not compared with {anchor}: {NO_COMMON_RATE}" for curve in apart]
        for reason in reasons:
            columns.setdefault(reason, []).append(ranking.column.label)
    silent = [sentence for ranking in rankings for sentence in uninformative_notes(ranking)]
    return [*silent, *(f"{', '.join(labels)}: {reason}." for reason, labels in columns.items())]


def _values(records: list[Any], column: Column) -> np.ndarray:
    """The values of a column in the displayed unit."""
    return np.array([float(record.get(column.name, np.nan)) * column.factor for record in records])


def _range(records: list[Any], column: Column) -> str:
    values = _values(records, column)
    values = values[~np.isnan(values)]
    if not len(values):
        return "–"
    low, high = values.min(), values.max()
    least, most = three_digits(low), three_digits(high)
    return (least if least == most else f"{least} to {most}").replace("inf", "∞")
