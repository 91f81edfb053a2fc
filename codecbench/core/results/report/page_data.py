"""What the report's script draws from, as JSON types: rows, columns, views, and how each is drawn."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np
import pandas as pd

from codecbench.core.results.columns import Column
from codecbench.core.results.export import json_value
from codecbench.core.results.run_result import RunResult
from codecbench.core.results.style import PALETTE, STROKES
from codecbench.core.results.views import bars_views, curve_views, map_views

_MOST_POINTS = 400
"""Points of a drawn line that the page keeps."""


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
        "intervals": intervals(run.wide),
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
    """The wide table by column, as JSON can hold it: infinities as text, missing values as null."""
    wide = run.wide
    found = {str(name): [json_value(value) for value in wide[name].tolist()] for name in wide.columns}
    found["curve"] = [run.curves[key].curve for key in zip(wide["codec"], wide["setting"], strict=True)]
    return found


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


def intervals(wide: pd.DataFrame) -> dict[str, tuple[str, str]]:
    """Columns of medians that have a confidence interval beside them."""
    names = set(wide.columns)
    found = {}
    for name in names:
        stem = name.rpartition(".")[0]
        low, high = f"{stem}.ci95_low", f"{stem}.ci95_high"
        if name.endswith(".median") and low in names and high in names:
            found[name] = (low, high)
    return found


def maps(run: RunResult) -> list[dict[str, Any]]:
    """The drawings of each map view, first repeats, with lines as rounded x and y lists."""
    return [
        {
            "title": view.view.title,
            "note": view.view.note,
            "strokes": {line.name: line.stroke for drawn in view.drawings for line in drawn.drawing.lines},
            "drawings": [
                {
                    "sequence": drawn.result.cell.sequence.name,
                    "codec": drawn.result.cell.codec.name,
                    "setting": " ".join(
                        filter(None, (drawn.result.cell.codec.label, drawn.result.cell.evaluator.label))
                    ),
                    "caption": drawn.drawing.caption,
                    "holds": drawn.drawing.holds,
                    "lines": [
                        {"name": line.name, "stroke": line.stroke, "points": _thinned(line.points)}
                        for line in drawn.drawing.lines
                    ],
                }
                for drawn in view.drawings
            ],
        }
        for view in map_views(run)
    ]


def _thinned(points: np.ndarray) -> list[list[float]]:
    """At most `_MOST_POINTS` points of a (N, 2) path as rounded x and y lists."""
    picks = np.unique(np.linspace(0, len(points) - 1, min(len(points), _MOST_POINTS)).round().astype(int))
    return [[round(float(value), 4) for value in points[picks, axis]] for axis in (0, 1)]
