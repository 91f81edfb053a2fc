"""What the report's script draws from, as JSON types: rows, columns, views, and how each is drawn."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Any

import numpy as np

from codecbench.core.contracts.view import Course, Lane
from codecbench.core.results.answers import judged_column
from codecbench.core.results.columns import Column
from codecbench.core.results.export import json_value
from codecbench.core.results.intervals import intervals
from codecbench.core.results.notes import caveats
from codecbench.core.results.run_result import RunResult
from codecbench.core.results.style import PALETTE, STROKES
from codecbench.core.results.views import Map, bars_views, curve_views, map_views

_MOST_POINTS = 400
_FEWEST_POINTS = 60
_ALL_POINTS = 60_000
"""Points of a drawn line that the page keeps, at the most and the least, and of all that it draws about."""
_STEPS = 4000
"""Coordinates are rounded to this share of what a drawing spans."""


def page_data(run: RunResult) -> dict[str, Any]:
    """Everything that the page draws but its pictures of frames."""
    shown = {name: column for name, column in run.columns.items() if "/" not in column.stage}
    return {
        "name": run.plan.name,
        "table": table(run),
        "columns": {name: _column(column) for name, column in shown.items()},
        "sequences": [entry.name for entry in run.plan.sequences],
        "baselines": sorted(run.meaning.baselines),
        "styles": {curve: asdict(style) for curve, style in run.styles.items()},
        "strokes": {name: asdict(style) for name, style in STROKES.items()},
        "palette": PALETTE,
        "presets": [{"title": view.title, "x": view.x.name, "y": view.y.name} for view in curve_views(run)],
        "first": _first_preset(run),
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


def _first_preset(run: RunResult) -> int:
    """The curve that is shown first: over the rate, what codecs are judged by."""
    judged = judged_column(run)
    places = [at for at, view in enumerate(curve_views(run)) if view.x == run.rate and view.y == judged]
    return places[0] if places else 0


def table(run: RunResult) -> dict[str, list[Any]]:
    """The wide table by column, as JSON can hold it: infinities as text, missing values as null."""
    wide = run.wide
    found = {str(name): [json_value(value) for value in wide[name].tolist()] for name in wide.columns}
    points = [run.curves[key] for key in zip(wide["codec"], wide["setting"], strict=True)]
    return found | {"curve": [point.curve for point in points], "place": [point.place for point in points]}


def _column(column: Column) -> dict[str, Any]:
    metric = column.metric
    return {
        "group": column.evaluator.title,
        "label": column.heading,
        "factor": column.factor,
        "better": metric.better,
        "scale": metric.scale,
        "summary": metric.summary,
    }


def _intervals(run: RunResult) -> dict[str, list[list[float] | None]]:
    """The intervals of headlines, row by row of the table."""
    keys = list(zip(run.wide["sequence"], run.wide["codec"], run.wide["setting"], strict=True))
    known = {column.name: intervals(run, column) for column in run.headlines()}
    return {
        name: [[_rounded(end) for end in found[key]] if key in found else None for key in keys]
        for name, found in known.items()
        if found
    }


def _rounded(value: float) -> float:
    return float(f"{value:.6g}")


def maps(run: RunResult) -> list[dict[str, Any]]:
    """The drawings of each map view, first repeats, and what is to be known of them; equal paths are kept once."""
    return [_map(view) | {"caveats": caveats(run, [view.name])} for view in map_views(run)]


def _map(view: Map) -> dict[str, Any]:
    most = max(_FEWEST_POINTS, min(_MOST_POINTS, _ALL_POINTS // max(1, len(view.drawings))))
    paths: dict[str, int] = {}
    kept: list[list[list[float]]] = []

    def kept_path(points: np.ndarray, step: float) -> int:
        path = _thinned(points, most, step)
        key = json.dumps(path)
        if key not in paths:
            paths[key] = len(kept)
            kept.append(path)
        return paths[key]

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
                "axes": list(drawing.axes),
                "lines": [
                    {"name": line.name, "stroke": line.stroke, "path": kept_path(line.points, step)}
                    for line in drawing.lines
                ],
                "course": drawing.course and _course(drawing.course, most, step),
            }
        )
    strokes = {line.name: line.stroke for drawn in view.drawings for line in drawn.drawing.lines}
    return {"title": view.view.title, "note": view.view.note, "strokes": strokes, "paths": kept, "drawings": drawings}


def _course(course: Course, most: int, step: float) -> dict[str, Any] | None:
    """A course in at most so many parts, of which each keeps its largest error; its lanes in parts of their own."""
    count = len(course.frames)
    if not count:
        return None
    starts = _starts(count, most)
    worst = np.fmax.reduceat(course.errors, starts)
    x, y = (
        (None, None) if course.positions is None else (_steps(course.positions[starts, axis], step) for axis in (0, 1))
    )
    return {
        "frames": course.frames[starts].tolist(),
        "last": int(course.frames[-1]),
        "x": x,
        "y": y,
        "errors": [None if np.isnan(error) else _rounded(error) for error in worst.tolist()],
        "unit": course.unit,
        "quantity": course.quantity,
        "lanes": [_lane(lane) for lane in course.lanes],
    }


def _lane(lane: Lane) -> dict[str, Any]:
    """A lane with a digit for each part: in how many ninths of its frames it holds, rounded up to hide none."""
    starts = _starts(len(lane.holds), _MOST_POINTS)
    shares = np.add.reduceat(lane.holds, starts) / np.diff([*starts, len(lane.holds)])
    levels = "".join(str(level) for level in np.ceil(9 * shares).astype(int))
    return {"name": lane.name, "tone": lane.tone, "share": _rounded(float(lane.holds.mean())), "levels": levels}


def _starts(count: int, most: int) -> np.ndarray:
    """Where parts of a series begin that are as long as each other, at most so many."""
    return np.linspace(0, count, min(count, most), endpoint=False).astype(int)


def _picks(count: int, most: int) -> np.ndarray:
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(int))


def _thinned(points: np.ndarray, most: int, step: float) -> list[Any]:
    """At most so many points of a (N, 2) path as rounded x and y lists."""
    picks = _picks(len(points), most)
    return [_steps(points[picks, axis], step) for axis in (0, 1)]


def _steps(values: np.ndarray, step: float) -> list[float | None]:
    return [None if np.isnan(value) else _rounded(round(value / step) * step) for value in values.tolist()]
