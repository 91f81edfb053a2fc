"""Rates and qualities of each curve's settings at the same frames or repeats of a sequence."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, Literal

import numpy as np
import scipy
from numpy.typing import NDArray

from codecbench.core.analysis.bjontegaard import LEAST_OVERLAP
from codecbench.core.analysis.evidence import Evidence, evidence_of_frames, evidence_of_repeats
from codecbench.core.analysis.run_result import Column, Key, RunResult
from codecbench.core.analysis.table import by_row
from codecbench.core.analysis.verdicts import as_quality, from_quality, values_of_repeats

Array = NDArray[np.float64]
Of = Literal["frames", "repeats"]
"""What the samples are."""

SMALLEST: Final = math.log(1.01)
"""The smallest difference worth knowing, as the log of a rate: 1 %."""
_SAME_RATE: Final = math.log(1.1)
"""Distance in log rate up to which a single setting is recommended for a rate."""
_ROUNDING: Final = 1e-9
_ALIKE: Final = 0.25
"""Settings of two curves are the same if they are nearer than this share of the least step between settings."""
_OUT_OF_ORDER: Final = 0.25
"""Share of the differences between settings of a codec, by size, in which more rate may be worse."""
_STEPS: Final = 33
"""Qualities at which two curves are compared."""


@dataclass(frozen=True)
class CurveValues:
    """The settings of a curve, in order of rate."""

    points: tuple[str, ...]
    """(S,) names."""
    rates: Array
    """(S, U), positive."""
    qualities: Array
    """(S, U), better when higher, of the same U frames or repeats for every curve, without missing values."""
    missing: int
    """How many qualities were missing; each counts as the worst of any setting."""
    of: Of

    @cached_property
    def log_rates(self) -> Array:
        """(S,) logarithms of the mean rates."""
        return np.asarray(np.log(self.rates.mean(axis=1)))

    @cached_property
    def means(self) -> Array:
        """(S,) mean qualities that never fall with the rate (isotonic regression)."""

        return np.asarray(scipy.optimize.isotonic_regression(self.qualities.mean(axis=1)).x)

    @cached_property
    def inverse(self) -> Callable[[Array], Array]:
        """The log rate that reaches a quality, monotone between settings (PCHIP, doi:10.1137/0717021)."""
        return _inverse(self.log_rates, self.means)

    @cached_property
    def leave_one_out(self) -> list[Callable[[Array], Array]]:
        """(S - 2,) `inverse` without each of the inner settings."""
        inner = range(1, len(self.means) - 1)
        return [_inverse(np.delete(self.log_rates, place), np.delete(self.means, place)) for place in inner]

    def gaps(self, qualities: Array) -> Array:
        """(S - 2,) possible errors of the mean log rate from the gaps beside each inner setting.

        They are extrapolated from the change without that setting. The area between a bent curve and its chord grows
        with the cube of a gap; for one chord over two gaps it grows with their product times their sum. A gap
        neighbors two inner settings, but only one at the ends. For two settings the error is infinite, as nothing shows
        how the curve bends between them.
        """
        levels = len(np.unique(self.means))
        if levels < 2 or np.isin(qualities, self.means).all():
            return np.zeros(max(1, len(self.means) - 2))
        if levels == 2:
            return np.array([math.inf])
        whole = self.inverse(qualities)
        changes = [np.mean(inverse(qualities) - whole) for inverse in self.leave_one_out]
        steps = np.diff(self.means)
        steps = np.maximum(steps, _ALIKE * steps.mean())
        cubes = np.r_[2.0, np.ones(len(steps) - 2), 2.0] * steps**3 if len(steps) > 2 else 2.0 * steps**3
        before, after = steps[:-1], steps[1:]
        return np.asarray(changes * (cubes[:-1] + cubes[1:]) / (6.0 * before * after * (before + after)))

    @cached_property
    def shifts(self) -> Array:
        """(S, U) by how much each frame or repeat moves the log rate at each setting's quality."""
        levels, places = np.unique(self.means, return_inverse=True)
        slopes = np.gradient(self.inverse(levels), levels) if len(levels) > 1 else np.zeros(1)
        of_rates = self.rates / self.rates.mean(axis=1, keepdims=True) - 1.0
        of_qualities = self.qualities - self.qualities.mean(axis=1, keepdims=True)
        return np.asarray(of_rates - slopes[places, None] * of_qualities)

    def changes(self, qualities: Array) -> Array:
        """(U,) by how much each frame or repeat moves the mean log rate at these qualities."""
        levels, places = np.unique(self.means, return_inverse=True)
        weights = np.array([np.interp(qualities, levels, row).mean() for row in np.eye(len(levels))])
        return np.asarray((weights / np.bincount(places))[places] @ self.shifts)

    def contains(self, rate: float) -> bool:
        """Whether a rate lies within those of the settings."""
        return bool(self.log_rates[0] - _ROUNDING <= np.log(rate) <= self.log_rates[-1] + _ROUNDING)

    def settings_at(self, rate: float) -> tuple[str, ...]:
        """The setting within a tenth of this rate, or else the two around it."""
        distances = np.abs(self.log_rates - np.log(rate))
        nearest = int(np.argmin(distances))
        if distances[nearest] <= _SAME_RATE or len(self.points) == 1:
            return (self.points[nearest],)
        above = int(np.clip(np.searchsorted(self.log_rates, np.log(rate)), 1, len(self.points) - 1))
        return self.points[above - 1], self.points[above]

    def mean_at(self, rate: float) -> float:
        """The mean quality at a rate, interpolated between the settings around it."""
        means, rates = _merge_ties(self.means, self.log_rates)
        if len(rates) == 1:
            return float(means[0])
        return float(_interpolator(rates, means)(np.clip(np.log(rate), rates[0], rates[-1])))


@dataclass(frozen=True)
class Difference:
    """The difference in rate of two curves, by frame or repeat."""

    mean: float
    """Log of the second curve's rate over the first's."""
    changes: Array
    """(U,) the mean as each frame or repeat has it."""
    alike: Array
    """(M, U) differences between settings of the two, which vary as `changes` does."""
    doubt: float = 0.0
    """As in `Evidence`."""
    at_least: bool = False
    """As in `Evidence`."""

    def evidence(self, of: Of) -> Evidence:
        """The mean with its standard error."""
        estimate = evidence_of_frames if of == "frames" else evidence_of_repeats
        return replace(estimate(self.changes, self.alike), doubt=self.doubt, at_least=self.at_least)


def difference(first: CurveValues, second: CurveValues, at: float | None = None) -> Difference | None:
    """Compute how much less rate the first takes at equal quality, on average over the qualities that both reach.

    at: a rate; then only the quality counts that the two have there on average. If they share less than a quarter of
    either's qualities, the difference is a bound if one is better at no more rate, else None.
    """
    if at is not None and not (first.contains(at) and second.contains(at)):
        return None
    low, high = max(first.means[0], second.means[0]), min(first.means[-1], second.means[-1])
    span = min(np.ptp(first.means), np.ptp(second.means))
    if low > high or (at is None and high - low < LEAST_OVERLAP * span):
        return _dominance(first, second)
    if at is not None:
        qualities = np.clip([0.5 * (first.mean_at(at) + second.mean_at(at))], low, high)
    else:
        qualities = np.linspace(low, high, _STEPS) if high > low else np.array([low])
    mean = float(np.mean(second.inverse(qualities) - first.inverse(qualities)))
    changes = second.changes(qualities) - first.changes(qualities)
    apart = np.abs(first.means[:, None] - second.means)
    nearest = {(i, int(np.argmin(row))) for i, row in enumerate(apart)}
    nearest |= {(int(np.argmin(column)), j) for j, column in enumerate(apart.T)}
    alike = np.array([second.shifts[j] - first.shifts[i] for i, j in sorted(nearest)])
    return Difference(mean, mean + changes, alike, _doubt(first, second, qualities))


def _doubt(first: CurveValues, second: CurveValues, qualities: Array) -> float:
    """The possible error of a mean difference in log rate from gaps between settings.

    Curves with settings at the same rates or qualities err alike, so that only the difference counts.
    """
    gaps = first.gaps(qualities), second.gaps(qualities)
    if any(np.isinf(errors).any() for errors in gaps):
        return math.inf
    alike = len(first.points) == len(second.points) > 1 and any(
        np.abs(a - b).max() <= _ALIKE * min(np.diff(a).min(), np.diff(b).min())
        for a, b in ((first.log_rates, second.log_rates), (first.means, second.means))
    )
    if alike and len(gaps[0]) == len(gaps[1]):
        return float(np.abs(gaps[0] - gaps[1]).sum())
    return float(np.abs(gaps[0]).sum() + np.abs(gaps[1]).sum())


def _dominance(first: CurveValues, second: CurveValues) -> Difference | None:
    """Bound the difference of two curves if one is better at no more rate, whatever the other spends.

    Each setting of the worse curve is compared with the most expensive one of the better curve that costs no more, if
    there is one. The least sure of these pairs decides. The size is the rate saved by the cheapest setting that exceeds
    the worse curve's best quality as surely. Differences count by their cube root, so that being better on every frame
    counts, by however much on each.
    """
    for better, worse, sign in ((first, second, 1.0), (second, first, -1.0)):
        affordable = np.searchsorted(better.log_rates, worse.log_rates + _ROUNDING, side="right") - 1
        rivals = np.flatnonzero(affordable >= 0)
        if not len(rivals):
            continue
        gains = np.cbrt(better.qualities[:, None] - worse.qualities)
        means = gains.mean(axis=2)
        sure = means / np.maximum(gains.std(axis=2), _ROUNDING)
        decides = min(zip(affordable[rivals], rivals, strict=True), key=lambda pair: sure[pair])
        if sure[decides] <= 0.0:
            continue
        cheapest = int(np.argmax(sure[:, -1] >= sure[decides]))
        size = sign * max(float(worse.log_rates[-1] - better.log_rates[cheapest]), _ROUNDING)
        scaled = size / means[decides] * gains
        return Difference(size, scaled[decides], scaled.reshape(-1, gains.shape[2]), at_least=True)
    return None


def _inverse(log_rates: Array, means: Array) -> Callable[[Array], Array]:
    """Interpolate the log rate over the quality."""
    rates, levels = _merge_ties(log_rates, means)
    if len(levels) == 1:
        return lambda qualities: np.full(len(qualities), rates[0])
    curve = _interpolator(levels, rates)
    return lambda qualities: np.asarray(curve(np.clip(qualities, levels[0], levels[-1])))


def _interpolator(places: Array, values: Array) -> Callable[[Array | float], Array]:
    """Interpolate values monotonically between places (PCHIP)."""
    interpolator: Callable[[Array | float], Array] = scipy.interpolate.PchipInterpolator(
        places, values, extrapolate=True
    )
    return interpolator


def _merge_ties(values: Array, levels: Array) -> tuple[Array, Array]:
    """Sort both by level, and replace settings of equal level by the mean of their values."""
    distinct, places = np.unique(levels, return_inverse=True)
    return np.bincount(places, values) / np.bincount(places), distinct


def curve_values(run: RunResult, column: Column, sequence: str) -> tuple[dict[str, CurveValues], dict[str, str]]:
    """The curves of a sequence by name, and why others are left out.

    Frames or repeats at which no setting has a value, such as those without ground truth, are ignored. An infinite
    value counts as the best or worst finite one. A setting of unknown rate is left out of its curve.
    """
    rows, of = _rows(run, column, sequence)
    measured = {key: values for key, values in rows.items() if run.rates.get(key, np.nan) > 0}
    known = {run.curves[key[1:]].curve for key in measured}
    unknown: dict[str, list[str]] = defaultdict(list)
    for key in rows:
        point = run.curves[key[1:]]
        if point.curve not in known:
            unknown[point.curve].append(point.point or "its setting")
    left_out = {curve: f"unknown rate: {', '.join(points)}" for curve, points in unknown.items()}
    if not measured:
        return {}, left_out
    table = as_quality(np.array(list(measured.values())), column)
    judged = ~np.isnan(table).all(axis=0)
    table = table[:, judged]
    if not np.isfinite(table).any():
        return {}, left_out | {run.curves[key[1:]].curve: "no value" for key in measured}
    missing = np.isnan(table).sum(axis=1)
    finite = table[np.isfinite(table)]
    bounded = np.clip(np.where(np.isnan(table), finite.min(), table), finite.min(), finite.max())
    of_units = _rates(run, list(measured), judged if of == "frames" else None, table.shape[1])
    places: dict[str, list[int]] = defaultdict(list)
    keys = list(measured)
    for place, key in enumerate(keys):
        places[run.curves[key[1:]].curve].append(place)
    curves = {}
    for curve, members in places.items():
        order = sorted(members, key=lambda place: run.rates[keys[place]])
        lost = int(missing[order].sum())
        points = tuple(run.curves[keys[place][1:]].point for place in order)
        curves[curve] = CurveValues(points, of_units[order], bounded[order], lost, of)
    return curves, left_out


def objection(run: RunResult, column: Column, curves: dict[str, CurveValues], left_out: dict[str, str]) -> str:
    """Say why a column is uninformative on a sequence; empty if it is not. curves, left_out: as by `curve_values`.

    The baseline has to be better than the coarsest settings, and finer settings better than coarser ones. Only codecs
    of several settings can show that. Quality is exempt, as it is measured against the raw frame.
    """
    if not curves:
        return "no setting has a value" if "no value" in left_out.values() else ""
    baselines = {point.curve for (codec, _), point in run.curves.items() if codec in run.schema.baselines}
    means = {curve: values.qualities.mean(axis=1) for curve, values in curves.items()}
    swept = [mean for curve, mean in means.items() if len(mean) > 1 and curve not in baselines]
    if not swept or column.metric.role == "quality":
        return ""
    steps = np.concatenate([(mean - mean[:, None])[np.triu_indices(len(mean), 1)] for mean in swept])
    size = np.abs(steps).sum()
    if size <= _ROUNDING * np.abs(np.concatenate(swept)).max():
        return "all settings of a codec have equal values"
    raw, coarsest = [means[curve].mean() for curve in means if curve in baselines], np.median([m[0] for m in swept])
    if raw and np.mean(raw) <= coarsest:
        best, worst = (f"{from_quality(float(x), column) * column.factor:.3g}" for x in (np.mean(raw), coarsest))
        return f"{' and '.join(sorted(baselines))} ({best}) is no better than the coarsest settings ({worst})"
    wrong = -steps[steps < 0].sum() / size
    return (
        ""
        if wrong <= _OUT_OF_ORDER
        else f"finer settings are worse in {100 * wrong:.0f} % of the differences, weighted by size"
    )


def _rates(run: RunResult, keys: list[Key], judged: NDArray[np.bool_] | None, units: int) -> Array:
    """(S, U) rates of settings at the judged frames, scaled to each setting's mean rate; constant over repeats."""
    assert run.rate is not None
    means = np.array([run.rates[key] for key in keys])
    rates = np.repeat(means[:, None], units, axis=1)
    if judged is None:
        return rates
    cells = {result.row: result for result in run.of(run.rate.evaluator.title)}
    for place, key in enumerate(keys):
        if key in cells:
            of_frames = cells[key].values_of_frames(run.rate.metric.name, run.rate.stage)[judged]
            if np.isfinite(of_frames).all() and of_frames.mean() > 0:
                rates[place] = of_frames * (means[place] / of_frames.mean())
    return rates


def _rows(run: RunResult, column: Column, sequence: str) -> tuple[dict[Key, Array], Of]:
    """One row of values a setting, with NaN for missing ones, and whether they are of frames (means over repeats).

    Repeats that some setting has not run yet are left out.
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
        rows = {row: [result.values_of_frames(column.metric.name, column.stage) for result in repeats]
                for row, repeats in by_row(results).items()}  # fmt: skip
        return {row: np.mean(values, axis=0) for row, values in rows.items()}, "frames"
    by_place = {row: values for row, values in values_of_repeats(run, column).items() if row[0] == sequence}
    repeats_of_rows = [{repeat for repeat, _ in values} for values in by_place.values()]
    run_by_all = set.intersection(*repeats_of_rows) if repeats_of_rows else set()
    places = sorted({place for values in by_place.values() for place in values if place[0] in run_by_all})
    rows_of_repeats = {row: np.array([of.get(place, np.nan) for place in places]) for row, of in by_place.items()}
    return rows_of_repeats, "repeats"
