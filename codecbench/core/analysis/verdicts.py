"""What a run says about each codec, sequence by sequence: values, their intervals, and what no other setting beats.

All of it goes by what evaluators declare of their metrics: role, direction, headline.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal, cast

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from codecbench.core.analysis.columns import Column
from codecbench.core.analysis.evidence import evidence_of_frames, evidence_of_repeats, student_quantile
from codecbench.core.analysis.run_result import CurvePoint, Key, RunResult
from codecbench.core.analysis.table import CellResult, by_row
from codecbench.core.engine.storage.aggregate import aggregate, percentile

Points = Mapping[tuple[str, str], CurvePoint]
"""The curve of each codec setting, by codec name and label."""
SequenceCurve = tuple[str, str]
"""A sequence and a curve on it."""
Place = tuple[int, int]
"""A repeat, and which of its values of a metric: 0 where it has one."""


def as_quality(values: np.ndarray, column: Column) -> np.ndarray:
    """Values that are better when higher."""
    if column.metric.better == "higher":
        return values
    with np.errstate(divide="ignore", invalid="ignore"):
        return -np.log10(values) if column.metric.scale == "log" else -values


def from_quality(quality: float, column: Column) -> float:
    """A value of a column from what `as_quality` made of it."""
    if column.metric.better == "higher":
        return quality
    return float(10.0**-quality) if column.metric.scale == "log" else -quality


def values_of_repeats(run: RunResult, column: Column, *, failed: float = math.nan) -> dict[Key, dict[Place, float]]:
    """The values of each row by where they were measured, in order; a metric of frames counts with its summary.

    A repeat that failed, whatever became of it, has the value `failed`; one that has not been run, or cannot be, is
    left out.
    """
    found: dict[Key, dict[Place, float]] = defaultdict(dict)
    for result in sorted(run.results, key=lambda result: result.cell.repeat):
        if result.cell.evaluator.title != column.evaluator.title or result.status == "unsupported":
            continue
        own = values_in(result, column)
        for place, value in enumerate(own or ([] if result.status == "ok" else [failed])):
            found[result.row][result.cell.repeat, place] = value
    return dict(found)


def values_in(result: CellResult, column: Column) -> list[float]:
    """The values of one repeat: of a metric of frames its summary."""
    own = [
        measured.value
        for measured in result.measurements
        if (measured.metric, measured.stage or "") == (column.metric.name, column.stage)
    ]
    over_frames = result.summaries.get((column.metric.name, column.stage, column.aggregate))
    return [over_frames] if over_frames is not None and not own else own


def anchors_of(curves: Mapping[str, Sequence[Any]], anchors: Iterable[str]) -> tuple[str, ...]:
    """The curves that others are compared with: the first of each codec that is an anchor, or else the first of all.

    Only curves of several settings can be one.
    """
    several = [curve for curve, members in curves.items() if len(members) > 1]
    firsts: dict[str, str] = {}
    for curve in several:
        firsts.setdefault(curve.split(" ")[0], curve)
    return tuple(firsts[name] for name in anchors if name in firsts) or tuple(several[:1])


def pareto_settings(wide: pd.DataFrame, criteria: Iterable[Column]) -> tuple[list[str], np.ndarray]:
    """The criteria that some setting of one sequence has, and which settings no other beats in all of them.

    wide: rows of one sequence. What is missing never wins: a cost that is not known (operations of an opaque library)
    counts as the worst, and a setting whose rate, quality or task is not known is not on the front and beats nobody.
    """
    usable = [column for column in criteria if column.name in wide.columns and wide[column.name].notna().any()]
    if not usable:
        return [], np.zeros(len(wide), dtype=bool)
    ways = [cast(Literal["higher", "lower"], column.metric.better) for column in usable]
    values = wide[[column.name for column in usable]].to_numpy(float, copy=True)
    for at, column in enumerate(usable):
        if column.metric.role in ("time", "operations"):
            worst = -math.inf if column.metric.better == "higher" else math.inf
            values[np.isnan(values[:, at]), at] = worst
    return [column.label for column in usable], pareto_front(values, ways)


def pareto_criteria(run: RunResult) -> list[Column]:
    """What settings are compared in at once: the rate, and every headline of quality, task, time and operations."""
    ranked = run.headlines("quality", "task", "time", "operations")
    return [column for column in (run.rate, *ranked) if column is not None and column.metric.better != "neither"]


def spread(values: np.ndarray) -> str:
    """`12.3 [11.0, 14.2]`: median and quartiles, for people."""
    present = values[~np.isnan(values)]
    if not len(present):
        return "–"
    middle, low, high = (percentile(present, share) for share in (50, 25, 75))
    return f"{middle:.3g}" if low == high else f"{middle:.3g} [{low:.3g}, {high:.3g}]"


def pareto_front(values: ArrayLike, better: Sequence[Literal["higher", "lower"]]) -> NDArray[np.bool_]:
    """Mark the rows that no other row dominates.

    values: (N, D), one row a setting, one column a criterion. A row dominates another where it is at least
    as good in every column and better in one. Rows with a NaN (a failure) are never on the front and
    dominate nobody. Equal rows are on the front together. Raises ValueError where `better` does not fit.
    """
    array = np.atleast_2d(np.asarray(values, dtype=np.float64))
    if array.shape[1] != len(better):
        raise ValueError(f"{array.shape[1]} columns but {len(better)} directions")
    unknown = set(better) - {"higher", "lower"}
    if unknown:
        raise ValueError(f"direction must be 'higher' or 'lower'; got {sorted(unknown)}")
    costs = array * np.where(np.array(better) == "higher", -1.0, 1.0)
    present = ~np.isnan(costs).any(axis=1)
    others = costs[present]
    beaten = [((others <= own).all(axis=1) & (others < own).any(axis=1)).any() for own in costs]
    return np.asarray(present & ~np.array(beaten, dtype=bool))


CONFIDENCE = 0.95
_FEWEST_REPEATS = 3
"""Below it an interval says nothing."""

Interval = tuple[float, float]


def intervals(run: RunResult, column: Column) -> dict[Key, Interval]:
    """The 95 % interval of a column's value in each row that has one.

    Of three repeats or more: by Student's t where the value is their mean, else by the bootstrap of their median. Of a
    single repeat: of the mean over its frames, neighbours of which are alike, see `evidence`. Infinite ones have none.
    """
    rows = by_row(run.of(column.evaluator.title))
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
    evidence = evidence_of_frames(values, halved=False) if over_frames else evidence_of_repeats(values)
    if not (evidence.freedom >= 1 and math.isfinite(evidence.variance)):
        return None
    half = student_quantile(0.5 + CONFIDENCE / 2, evidence.freedom) * math.sqrt(evidence.variance)
    return evidence.mean - half, evidence.mean + half
