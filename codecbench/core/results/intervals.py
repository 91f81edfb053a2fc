"""How sure the values of the wide table are: intervals over repeats, or over frames where there is one repeat."""

from __future__ import annotations

import math
from collections import defaultdict

import numpy as np
from numpy.typing import NDArray

from codecbench.core.engine.aggregate import aggregate
from codecbench.core.results.columns import Column
from codecbench.core.results.evidence import evidence_of_frames, evidence_of_repeats, student_quantile
from codecbench.core.results.run_result import Key, RunResult
from codecbench.core.results.table import CellResult
from codecbench.core.results.verdicts import values_in

CONFIDENCE = 0.95
_FEWEST_REPEATS = 3
"""Below it an interval says nothing."""

Interval = tuple[float, float]


def intervals(run: RunResult, column: Column) -> dict[Key, Interval]:
    """The 95 % interval of a column's value in each row that has one.

    Of three repeats or more: by Student's t where the value is their mean, else by the bootstrap of their median. Of a
    single repeat: of the mean over its frames, neighbours of which are alike, see `evidence`. Infinite ones have none.
    """
    rows: dict[Key, list[CellResult]] = defaultdict(list)
    for result in run.of(column.evaluator.title):
        rows[result.cell.sequence.name, result.cell.codec.name, result.cell.codec.label].append(result)
    found = {row: _interval(results, column) for row, results in rows.items()}
    return {row: interval for row, interval in found.items() if interval is not None}


def _interval(results: list[CellResult], column: Column) -> Interval | None:
    values = np.array([value for result in results for value in values_in(result, column)])
    finite = values[np.isfinite(values)]
    if len(finite) >= _FEWEST_REPEATS and len(finite) == len(values):
        if column.aggregate == "mean":
            return _of_mean(finite, over_frames=False)
        return aggregate("ci95_low", finite), aggregate("ci95_high", finite)
    of_frames = (column.metric.name, column.stage, "mean")
    if len(results) == 1 and column.aggregate == "mean" and of_frames in results[0].summaries:
        series = results[0].values_of_frames(column.metric.name, column.stage)
        series = series[~np.isnan(series)]
        return _of_mean(series, over_frames=True) if np.isfinite(series).all() and len(series) else None
    return None


def _of_mean(values: NDArray[np.float64], *, over_frames: bool) -> Interval | None:
    evidence = evidence_of_frames(values) if over_frames else evidence_of_repeats(values)
    if not (evidence.freedom >= 1 and math.isfinite(evidence.variance)):
        return None
    half = student_quantile(0.5 + CONFIDENCE / 2, evidence.freedom) * math.sqrt(evidence.variance)
    return evidence.mean - half, evidence.mean + half
