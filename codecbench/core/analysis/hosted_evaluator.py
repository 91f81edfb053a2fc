"""Runs the comparison and the drawing of another distribution's evaluator in its host process."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, Final, TypeAlias

import numpy as np

from codecbench.core.contracts.errors import PluginError
from codecbench.core.contracts.evaluator import Evaluator, Measurement, Outcome
from codecbench.core.contracts.hooks import Kind
from codecbench.core.contracts.metric import Metric
from codecbench.core.contracts.view import Drawing, FrameTimeline, Line, TimelineRow, View
from codecbench.core.engine.planning.model import PluginSetting
from codecbench.core.engine.plugins.registry import Registry
from codecbench.core.engine.storage.samples import (
    MeasurementCheck,
    MeasurementError,
    json_from_measurement,
    measurement_from_json,
)
from codecbench.core.engine.text import clean_line

_MOST_POINTS: Final = 1_000_000
"""Points of one drawing."""

ResultsEvaluator: TypeAlias = "Evaluator[Any] | HostedEvaluator"


class HostedEvaluator:
    """The members of an Evaluator that results use; the plan of its run has its declarations.

    offers: the methods that it overrides.
    """

    metrics: tuple[Metric, ...] = ()
    views: tuple[View, ...] = ()

    def __init__(self, registry: Registry, setting: PluginSetting, offers: Collection[str]) -> None:
        self._registry, self._setting, self._offers = registry, setting, offers

    def compare(self, outcome: Outcome, baseline: list[Outcome]) -> Iterator[Measurement]:
        """Compare an outcome with the baseline's. Raises CodecbenchError if the plugin fails."""
        rows = self._call(
            "compare", compare_on_host, _json_from_outcome(outcome), [_json_from_outcome(other) for other in baseline]
        )
        return iter([measurement_from_json(row) for row in rows or ()])

    def drawing(self, outcome: Outcome) -> Drawing | None:
        """Draw a cell. Raises CodecbenchError if the plugin fails."""
        answer = self._call("drawing", draw_on_host, _json_from_outcome(outcome))
        if answer is None:
            return None
        lines = (
            Line(clean_line(name), stroke, np.array(points, float).reshape(-1, 2))
            for name, stroke, points in answer["lines"]
        )
        axes = tuple(clean_line(name) for name in answer["axes"])
        timeline = answer["timeline"] and _timeline(answer["timeline"])
        return Drawing(tuple(lines), clean_line(answer["caption"]), answer["holds"], axes, timeline)

    def _call(self, offer: str, function: Any, *outcomes: Any) -> Any:
        if offer not in self._offers:
            return None
        plugin: tuple[Kind, str] = "evaluator", self._setting.name
        return self._registry.ask(function, self._setting.name, self._setting.params, *outcomes, of=[plugin])


def _timeline(answer: dict[str, Any]) -> FrameTimeline:
    """Read the timeline of a drawing from JSON types."""
    positions = answer["positions"]
    return FrameTimeline(
        np.array(answer["frames"], np.int64),
        None if positions is None else np.array(positions, float).reshape(-1, 2),
        np.array(answer["errors"], float),
        clean_line(answer["unit"]),
        tuple(TimelineRow(clean_line(name), tone, np.array(holds, bool)) for name, tone, holds in answer["rows"]),
        clean_line(answer["quantity"]),
    )


def compare_on_host(
    registry: Registry, name: str, params: dict[str, Any], outcome: dict[str, Any], baseline: list[dict[str, Any]]
) -> list[list[Any]]:
    """Compare a cell with the baseline's, as JSON types, in the host process."""
    evaluator: Evaluator[Any] = registry.create("evaluator", name, params)
    yielded = evaluator.compare(_outcome_from_json(outcome), [_outcome_from_json(other) for other in baseline])
    try:
        return [json_from_measurement(measurement) for measurement in MeasurementCheck(evaluator, 0).check(yielded)]
    except MeasurementError as error:
        raise PluginError(f"compare: {error}") from error


def draw_on_host(
    registry: Registry, name: str, params: dict[str, Any], outcome: dict[str, Any]
) -> dict[str, Any] | None:
    """Draw a cell, as JSON types, in the host process."""
    evaluator: Evaluator[Any] = registry.create("evaluator", name, params)
    drawing = evaluator.drawing(_outcome_from_json(outcome))
    if drawing is None:
        return None
    in_timeline = 0 if drawing.timeline is None else len(drawing.timeline.frames) * (1 + len(drawing.timeline.rows))
    if (points := in_timeline + sum(len(line.points) for line in drawing.lines)) > _MOST_POINTS:
        raise PluginError(f"its drawing has {points:,} points; at most {_MOST_POINTS:,} are drawn")
    if not all(np.isfinite(line.points).all() for line in drawing.lines):
        raise PluginError("its drawing has points that are not finite")
    lines = [(line.name, line.stroke, line.points.tolist()) for line in drawing.lines]
    timeline = drawing.timeline
    return {
        "lines": lines,
        "caption": str(drawing.caption),
        "holds": None if drawing.holds is None else bool(drawing.holds),
        "axes": [str(name) for name in drawing.axes],
        "timeline": timeline
        and {
            "frames": timeline.frames.tolist(),
            "positions": None
            if timeline.positions is None
            else [[_none_for_nan(value) for value in place] for place in timeline.positions.tolist()],
            "errors": [_none_for_nan(value) for value in timeline.errors.tolist()],
            "unit": str(timeline.unit),
            "rows": [(str(row.name), row.tone, row.holds.tolist()) for row in timeline.rows],
            "quantity": str(timeline.quantity),
        },
    }


def _none_for_nan(value: float) -> float | None:
    return None if math.isnan(value) else value


def _json_from_outcome(outcome: Outcome) -> dict[str, Any]:
    rows = [json_from_measurement(measurement) for measurement in outcome.measurements]
    return {"repeat": outcome.repeat, "measurements": rows, "artifacts": str(outcome.artifacts.absolute())}


def _outcome_from_json(values: dict[str, Any]) -> Outcome:
    measurements = tuple(measurement_from_json(row) for row in values["measurements"])
    return Outcome(values["repeat"], measurements, Path(values["artifacts"]))
