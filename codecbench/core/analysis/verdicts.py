"""Values of codec settings, their confidence intervals, their Pareto front, and their order under other calibrations.

Everything depends on what evaluators declare of their metrics: role, direction, headline.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, cast

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from codecbench.core.analysis.evidence import SIGNIFICANCE, evidence_of_frames, evidence_of_repeats, student_quantile
from codecbench.core.analysis.run_result import Column, CurvePoint, Key, RunResult, judged_column
from codecbench.core.analysis.table import CellResult, by_row
from codecbench.core.engine.storage.aggregate import aggregate, percentile

Points = Mapping[tuple[str, str], CurvePoint]
"""The curve of each codec setting, by codec name and label."""
SequenceCurve = tuple[str, str]
"""A sequence and a curve on it."""
Place = tuple[int, int]
"""A repeat, and the index of a value in it: 0 if it has one."""


def as_quality(values: np.ndarray, column: Column) -> np.ndarray:
    """Convert values of a column to qualities, which are better when higher."""
    if column.metric.better == "higher":
        return values
    with np.errstate(divide="ignore", invalid="ignore"):
        return -np.log10(values) if column.metric.scale == "log" else -values


def from_quality(quality: float, column: Column) -> float:
    """Convert a quality from `as_quality` back to a value of the column."""
    if column.metric.better == "higher":
        return quality
    return float(10.0**-quality) if column.metric.scale == "log" else -quality


def values_of_repeats(run: RunResult, column: Column, *, failed: float = math.nan) -> dict[Key, dict[Place, float]]:
    """The values of each row by place, in order; a per-frame metric counts with its summary.

    A repeat that failed in any way has the value `failed`; one that has not run or is unsupported is left out.
    """
    by_row_and_place: dict[Key, dict[Place, float]] = defaultdict(dict)
    for result in sorted(run.results, key=lambda result: result.cell.repeat):
        if result.cell.evaluator.title != column.evaluator.title or result.status == "unsupported":
            continue
        values = values_in(result, column)
        for place, value in enumerate(values or ([] if result.status == "ok" else [failed])):
            by_row_and_place[result.row][result.cell.repeat, place] = value
    return dict(by_row_and_place)


def values_in(result: CellResult, column: Column) -> list[float]:
    """The values of one repeat; of a per-frame metric its summary."""
    values = [
        measured.value
        for measured in result.measurements
        if (measured.metric, measured.stage or "") == (column.metric.name, column.stage)
    ]
    over_frames = result.summaries.get((column.metric.name, column.stage, column.aggregate))
    return [over_frames] if over_frames is not None and not values else values


def median(values: Iterable[float]) -> float:
    """The median of the values that are not NaN; NaN if there are none."""
    known = [value for value in values if not math.isnan(value)]
    return float(np.median(known)) if known else math.nan


def anchors_of(curves: Mapping[str, Sequence[Any]], anchors: Iterable[str]) -> tuple[str, ...]:
    """The curves that others are compared with: the first of each anchor codec, or else the first of all.

    Only curves of several settings can be anchors.
    """
    several = [curve for curve, members in curves.items() if len(members) > 1]
    firsts: dict[str, str] = {}
    for curve in several:
        firsts.setdefault(curve.split(" ")[0], curve)
    return tuple(firsts[name] for name in anchors if name in firsts) or tuple(several[:1])


def pareto_settings(wide: pd.DataFrame, criteria: Iterable[Column]) -> tuple[list[str], np.ndarray]:
    """The criteria that some setting of one sequence has, and which settings are on their Pareto front.

    wide: rows of one sequence. An unknown cost (operations of an opaque library) counts as the worst. A setting of
    unknown rate, quality or task is not on the front and dominates none.
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
    """The criteria of the Pareto front: the rate, and every headline of quality, task, time and operations."""
    ranked = run.headlines("quality", "task", "time", "operations")
    return [column for column in (run.rate, *ranked) if column is not None and column.metric.better != "neither"]


def spread(values: np.ndarray) -> str:
    """Format the median and quartiles: `12.3 [11.0, 14.2]`."""
    present = values[~np.isnan(values)]
    if not len(present):
        return "–"
    middle, low, high = (percentile(present, share) for share in (50, 25, 75))
    return f"{middle:.3g}" if low == high else f"{middle:.3g} [{low:.3g}, {high:.3g}]"


def pareto_front(values: ArrayLike, better: Sequence[Literal["higher", "lower"]]) -> NDArray[np.bool_]:
    """Mark the rows that no other row dominates.

    values: (N, D), one row a setting, one column a criterion. A row dominates another if it is at least as good in
    every column and better in one. Rows with a NaN (a failure) are never on the front and dominate none. Equal rows are
    on the front together. Raises ValueError if `better` does not fit.
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
    dominated = [((others <= row).all(axis=1) & (others < row).any(axis=1)).any() for row in costs]
    return np.asarray(present & ~np.array(dominated, dtype=bool))


CONFIDENCE = 0.95
_FEWEST_REPEATS = 3
"""Repeats below which there is no interval."""

Interval = tuple[float, float]


def intervals(run: RunResult, column: Column) -> dict[Key, Interval]:
    """The 95 % confidence interval of a column's value in each row that has one.

    For three repeats or more it is of their mean, by Student's t, or of their median, by the bootstrap. For a single
    repeat it is of the mean over its autocorrelated frames, see `evidence`. Infinite values have none.
    """
    rows = by_row(run.of(column.evaluator.title))
    by_key = {row: _interval(results, column) for row, results in rows.items()}
    return {row: interval for row, interval in by_key.items() if interval is not None}


def _interval(results: list[CellResult], column: Column) -> Interval | None:
    values = np.array([value for result in results for value in values_in(result, column)])
    finite = values[np.isfinite(values)]
    if len(finite) >= _FEWEST_REPEATS and len(finite) == len(values):
        if column.aggregate == "mean":
            return _interval_of_mean(finite, over_frames=False)
        return aggregate("ci95_low", finite), aggregate("ci95_high", finite)
    of_frames = (column.metric.name, column.stage, "mean")
    if len(results) == 1 and column.aggregate == "mean" and of_frames in results[0].summaries:
        series = results[0].values_of_frames(column.metric.name, column.stage)
        series = series[~np.isnan(series)]
        return _interval_of_mean(series, over_frames=True) if np.isfinite(series).all() and len(series) else None
    return None


def _interval_of_mean(values: NDArray[np.float64], *, over_frames: bool) -> Interval | None:
    evidence = evidence_of_frames(values, halved=False) if over_frames else evidence_of_repeats(values)
    if not (evidence.freedom >= 1 and math.isfinite(evidence.variance)):
        return None
    half = student_quantile(0.5 + CONFIDENCE / 2, evidence.freedom) * math.sqrt(evidence.variance)
    return evidence.mean - half, evidence.mean + half


Medians = tuple[float, float]
"""Medians of a setting and of the baseline over the repeats that both have."""


@dataclass(frozen=True)
class Orders:
    """The significant orders of a setting and the baseline under several calibrations."""

    setting: str
    better: Mapping[str, Medians]
    """By sequence on which the setting is significantly better."""
    worse: Mapping[str, Medians]
    """By sequence on which the setting is significantly worse."""

    @property
    def is_reversed(self) -> bool:
        """Whether the order depends on the calibration."""
        return bool(self.better and self.worse)

    @property
    def is_comparable(self) -> bool:
        """Whether the order is significant on two sequences or more."""
        return len(self.better) + len(self.worse) > 1


@dataclass(frozen=True)
class Calibrations:
    """A sequence that a run also has under wrong calibrations, and the orders of its settings there."""

    sequence: str
    others: tuple[str, ...]
    """The same sequence under wrong calibrations."""
    baseline: str
    medians: Mapping[str, float]
    """The baseline's medians over repeats, by sequence on which it has a value."""
    column: Column
    """The column that decides the orders."""
    settings: tuple[Orders, ...]
    """Empty if the run has no baseline."""


def calibrations(run: RunResult) -> Iterator[Calibrations]:
    """Yield every sequence that a run has under several calibrations, if the run has a judged column.

    An order is significant by the paired t-test over the repeats that both have.
    """
    column = judged_column(run)
    if run.as_calibrated is run or column is None:
        return
    values = values_of_repeats(run, column)
    raw = next((key for key in run.curves if key[0] in run.schema.baselines), ("", ""))
    tried = [key for key in run.curves if raw[0] and key[0] not in run.schema.baselines]
    for entry in run.as_calibrated.plan.sequences:
        others = tuple(other.name for other in run.plan.sequences if other.as_calibrated == entry.fingerprint)
        if others:
            of_raw = {name: values.get((name, *raw), {}) for name in (entry.name, *others)}
            medians = {name: value for name, raws in of_raw.items() if not math.isnan(value := median(raws.values()))}
            settings = tuple(
                _orders(key, {name: _compare(values.get((name, *key), {}), of_raw[name], column) for name in of_raw})
                for key in tried
            )
            yield Calibrations(entry.name, others, raw[0], medians, column, settings)


def _orders(key: tuple[str, str], comparisons: Mapping[str, tuple[int, Medians]]) -> Orders:
    better, worse = ({name: both for name, (sign, both) in comparisons.items() if sign == side} for side in (1, -1))
    return Orders(" ".join(key).strip(), better, worse)


def _compare(values: Mapping[Place, float], raw: Mapping[Place, float], column: Column) -> tuple[int, Medians]:
    """Compare a setting with the baseline: 1 if significantly better, -1 if worse, else 0; with both medians."""
    pairs = np.array([(values[place], raw[place]) for place in values if place in raw]).reshape(-1, 2)
    better = -np.diff(as_quality(pairs, column), axis=1)[:, 0]
    pairs, better = pairs[np.isfinite(better)], better[np.isfinite(better)]
    if not len(better):
        return 0, (np.nan, np.nan)
    evidence = evidence_of_repeats(better)
    median_of_setting, raw_median = np.median(pairs, axis=0)
    sign = int(np.sign(evidence.mean)) * (evidence.p_value < SIGNIFICANCE)
    return sign, (float(median_of_setting), float(raw_median))
