"""What the settings of each curve gave at the same frames or repeats of a sequence."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from codecbench.core.analysis.columns import Column
from codecbench.core.analysis.evidence import Evidence, evidence_of_frames, evidence_of_repeats
from codecbench.core.analysis.run_result import Key, RunResult
from codecbench.core.analysis.table import CellResult
from codecbench.core.analysis.verdicts import as_quality, frame_matrix, values_of_repeats

Array = NDArray[np.float64]
Of = Literal["frames", "repeats"]

_EQUAL_RATES: Final = 1.1
"""Rates up to this factor apart count as equal where two curves share no more."""
_STEPS: Final = 33
"""Rates at which two curves are compared."""


@dataclass(frozen=True)
class CurveValues:
    """The settings of a curve, in order of rate.

    points: (S,) names. log_rates: (S,). qualities: (S, U), better when higher, of the same U frames or repeats for
    every curve; none is missing. missing: how many were, each of which counts as the worst that anybody had. of: frames
    or repeats.
    """

    points: tuple[str, ...]
    log_rates: Array
    qualities: Array
    missing: int
    of: Of

    def better_than(self, other: CurveValues, at: float | None = None) -> Evidence | None:
        """By how much this curve is better, on average over the log of the rates that both have; None for none.

        With `at`, at that rate alone.
        """
        low = max(self.log_rates[0], other.log_rates[0])
        high = min(self.log_rates[-1], other.log_rates[-1])
        if at is not None:
            if not (self.reaches(at) and other.reaches(at)):
                return None
            low = high = float(np.log(at))
        if low - high > np.log(_EQUAL_RATES):
            return None
        shared = np.linspace(low, high, _STEPS) if high > low else np.array([0.5 * (low + high)])
        differences = self.mean(shared) - other.mean(shared)
        return evidence_of_frames(differences) if self.of == "frames" else evidence_of_repeats(differences)

    def reaches(self, rate: float) -> bool:
        """Whether a rate lies among those of the settings, give or take what counts as equal."""
        margin = np.log(_EQUAL_RATES)
        return bool(self.log_rates[0] - margin <= np.log(rate) <= self.log_rates[-1] + margin)

    def nearest(self, rate: float) -> str:
        """The setting with the rate nearest to this one."""
        return self.points[int(np.argmin(np.abs(self.log_rates - np.log(rate))))]

    def mean(self, at: Array) -> Array:
        """(U,) mean over some log rates, linear between settings."""
        weights = [np.interp(at, self.log_rates, unit).mean() for unit in np.eye(len(self.log_rates))]
        return np.asarray(np.array(weights) @ self.qualities)


def curve_values(run: RunResult, column: Column, sequence: str) -> tuple[dict[str, CurveValues], dict[str, str]]:
    """The curves of a sequence by name, and why others are none.

    Places that no setting has a value of, such as frames without ground truth, count for nobody. An infinite value
    counts as the best or the worst that is finite.
    """
    rows, of = _rows(run, column, sequence)
    unknown: dict[str, list[str]] = defaultdict(list)
    for key in rows:
        point = run.curves[key[1:]]
        if np.isnan(run.rates.get(key, np.nan)):
            unknown[point.curve].append(point.point or "its setting")
    left_out = {curve: f"no rate is known of {', '.join(points)}" for curve, points in unknown.items()}
    measured = {key: values for key, values in rows.items() if run.curves[key[1:]].curve not in left_out}
    if not measured:
        return {}, left_out
    table = as_quality(np.array(list(measured.values())), column)
    table = table[:, ~np.isnan(table).all(axis=0)]
    if not np.isfinite(table).any():
        return {}, left_out | {run.curves[key[1:]].curve: "no value" for key in measured}
    missing = np.isnan(table).sum(axis=1)
    finite = table[np.isfinite(table)]
    bounded = np.clip(np.where(np.isnan(table), finite.min(), table), finite.min(), finite.max())
    places: dict[str, list[int]] = defaultdict(list)
    keys = list(measured)
    for place, key in enumerate(keys):
        places[run.curves[key[1:]].curve].append(place)
    rates = np.log([run.rates[key] for key in keys])
    found = {}
    for curve, members in places.items():
        order = sorted(members, key=lambda place: rates[place])
        lost = int(missing[order].sum())
        points = tuple(run.curves[keys[place][1:]].point for place in order)
        found[curve] = CurveValues(points, rates[order], bounded[order], lost, of)
    return found, left_out


def _rows(run: RunResult, column: Column, sequence: str) -> tuple[dict[Key, Array], Of]:
    """One row of values a setting, NaN where one is missing, and what they are of.

    Repeats that some setting has not run yet are left out, because they say nothing of it.
    """
    results = [
        result
        for result in run.results
        if result.cell.evaluator.title == column.evaluator.title
        and result.cell.sequence.name == sequence
        and result.status != "unsupported"
    ]
    key = (column.metric.name, column.stage, column.aggregate)
    if any(key in result.summaries for result in results):
        return _of_frames(results, column), "frames"
    found = {row: values for row, values in values_of_repeats(run, column).items() if row[0] == sequence}
    run_by_all = set.intersection(*({repeat for repeat, _ in values} for values in found.values())) if found else set()
    places = sorted({place for values in found.values() for place in values if place[0] in run_by_all})
    return {row: np.array([values.get(place, np.nan) for place in places]) for row, values in found.items()}, "repeats"


def _of_frames(results: list[CellResult], column: Column) -> dict[Key, Array]:
    """Means over repeats."""
    rows: dict[Key, list[Array]] = defaultdict(list)
    matrix = frame_matrix(results, column.metric.name, column.stage)[1]
    for result, values in zip(results, matrix, strict=True):
        rows[result.cell.sequence.name, result.cell.codec.name, result.cell.codec.label].append(values)
    return {key: np.mean(many, axis=0) for key, many in rows.items()}
