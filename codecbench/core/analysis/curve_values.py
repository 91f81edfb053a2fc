"""What the settings of each curve gave at the same frames or repeats of a sequence."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from codecbench.core.analysis.bjontegaard import LEAST_OVERLAP
from codecbench.core.analysis.columns import Column
from codecbench.core.analysis.evidence import Evidence, evidence_of_frames, evidence_of_repeats
from codecbench.core.analysis.run_result import Key, RunResult
from codecbench.core.analysis.table import by_row
from codecbench.core.analysis.verdicts import as_quality, from_quality, values_of_repeats

Array = NDArray[np.float64]
Of = Literal["frames", "repeats"]

SMALLEST: Final = math.log(1.01)
"""The smallest difference worth knowing, as the log of a rate: 1 %."""
_SAME_RATE: Final = math.log(1.1)
"""Up to so far from a rate a setting is recommended for it."""
_ROUNDING: Final = 1e-9
_ALIKE: Final = 0.25
"""Settings of two curves are the same if they are nearer than this share of the least step between settings."""
_OUT_OF_ORDER: Final = 0.25
"""Up to such a share of the differences between settings of a codec, by size, more rate may be worse."""
_STEPS: Final = 33
"""Qualities at which two curves are compared."""


@dataclass(frozen=True)
class CurveValues:
    """The settings of a curve, in order of rate.

    points: (S,) names. rates: (S, U), positive. qualities: (S, U), better when higher, of the same U frames or repeats
    for every curve; none is missing. missing: how many were, each of which counts as the worst that anybody had. of:
    frames or repeats.
    """

    points: tuple[str, ...]
    rates: Array
    qualities: Array
    missing: int
    of: Of

    @cached_property
    def log_rates(self) -> Array:
        """(S,) logarithms of the mean rates."""
        return np.asarray(np.log(self.rates.mean(axis=1)))

    @cached_property
    def means(self) -> Array:
        """(S,) mean qualities that never fall with the rate (isotonic regression by pooling adjacent violators)."""
        from scipy.optimize import isotonic_regression  # loads for half a second

        return np.asarray(isotonic_regression(self.qualities.mean(axis=1)).x)

    @cached_property
    def inverse(self) -> Callable[[Array], Array]:
        """The log rate at which a quality is reached, monotone between settings (PCHIP, doi:10.1137/0717021)."""
        return _inverse(self.log_rates, self.means)

    @cached_property
    def without(self) -> list[Callable[[Array], Array]]:
        """(S - 2,) `inverse` without each of the inner settings."""
        inner = range(1, len(self.means) - 1)
        return [_inverse(np.delete(self.log_rates, place), np.delete(self.means, place)) for place in inner]

    def gaps(self, qualities: Array) -> Array:
        """(S - 2,) by how much the mean log rate may be wrong because of the gaps beside each inner setting.

        From what it changes without the setting. The area between a bent curve and its chord grows with the cube of a
        gap, and with the product of both gaps and their sum where one chord spans both; a gap has two such settings,
        but one at the ends. Infinite for two settings, of which nothing says how the curve bends between them.
        """
        levels = len(np.unique(self.means))
        if levels < 2 or np.isin(qualities, self.means).all():
            return np.zeros(max(1, len(self.means) - 2))
        if levels == 2:
            return np.array([math.inf])
        whole = self.inverse(qualities)
        without = [np.mean(inverse(qualities) - whole) for inverse in self.without]
        steps = np.diff(self.means)
        steps = np.maximum(steps, _ALIKE * steps.mean())
        cubes = np.r_[2.0, np.ones(len(steps) - 2), 2.0] * steps**3 if len(steps) > 2 else 2.0 * steps**3
        before, after = steps[:-1], steps[1:]
        return np.asarray(without * (cubes[:-1] + cubes[1:]) / (6.0 * before * after * (before + after)))

    @cached_property
    def moved(self) -> Array:
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
        return np.asarray((weights / np.bincount(places))[places] @ self.moved)

    def contains(self, rate: float) -> bool:
        """Whether a rate lies between those of the settings, or is that of one."""
        return bool(self.log_rates[0] - _ROUNDING <= np.log(rate) <= self.log_rates[-1] + _ROUNDING)

    def settings_at(self, rate: float) -> tuple[str, ...]:
        """The setting whose rate is this one within a tenth, else the two around it."""
        distances = np.abs(self.log_rates - np.log(rate))
        nearest = int(np.argmin(distances))
        if distances[nearest] <= _SAME_RATE or len(self.points) == 1:
            return (self.points[nearest],)
        above = int(np.clip(np.searchsorted(self.log_rates, np.log(rate)), 1, len(self.points) - 1))
        return self.points[above - 1], self.points[above]

    def mean_at(self, rate: float) -> float:
        """The mean quality at a rate, between the two settings around it."""
        means, rates = _distinct(self.means, self.log_rates)
        if len(rates) == 1:
            return float(means[0])
        from scipy.interpolate import PchipInterpolator  # loads for half a second

        return float(PchipInterpolator(rates, means)(np.clip(np.log(rate), rates[0], rates[-1])))


@dataclass(frozen=True)
class Difference:
    """What is known of two curves before frames or repeats are asked how sure it is.

    mean: log of how many times the rate of the first the second takes. changes: (U,), of that mean. alike: (M, U),
    differences between settings of the two, which vary as the changes do. doubt and at_least: as in `Evidence`.
    """

    mean: float
    changes: Array
    alike: Array
    doubt: float = 0.0
    at_least: bool = False

    def evidence(self, of: Of) -> Evidence:
        """How sure it is by these frames or repeats."""
        asked = evidence_of_frames if of == "frames" else evidence_of_repeats
        return replace(asked(self.changes, self.alike), doubt=self.doubt, at_least=self.at_least)


def difference(first: CurveValues, second: CurveValues, at: float | None = None) -> Difference | None:
    """How much less rate the first takes at equal quality, on average over the qualities that both reach.

    With `at`, at the quality that the two have at this rate on average. If they share less than a quarter of the
    qualities of either, by how much at least if one is better at no more rate. None if neither is.
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
    nearest = {(one, int(np.argmin(row))) for one, row in enumerate(apart)}
    nearest |= {(int(np.argmin(column)), other) for other, column in enumerate(apart.T)}
    alike = np.array([second.moved[other] - first.moved[one] for one, other in sorted(nearest)])
    return Difference(mean, mean + changes, alike, _doubt(first, second, qualities))


def _doubt(first: CurveValues, second: CurveValues, qualities: Array) -> float:
    """By how much a mean difference in log rate may be wrong because no setting lies between those there are.

    Curves with settings at the same rates or qualities are wrong alike, so that only the difference counts.
    """
    gaps = first.gaps(qualities), second.gaps(qualities)
    if any(np.isinf(each).any() for each in gaps):
        return math.inf
    alike = len(first.points) == len(second.points) > 1 and any(
        np.abs(own - other).max() <= _ALIKE * min(np.diff(own).min(), np.diff(other).min())
        for own, other in ((first.log_rates, second.log_rates), (first.means, second.means))
    )
    if alike and len(gaps[0]) == len(gaps[1]):
        return float(np.abs(gaps[0] - gaps[1]).sum())
    return float(np.abs(gaps[0]).sum() + np.abs(gaps[1]).sum())


def _dominance(first: CurveValues, second: CurveValues) -> Difference | None:
    """The difference of two curves of which one is better at no more rate, whatever the other spends.

    Each setting of the other is compared with the dearest of the better curve that costs no more, if there is one; the
    pair that is least sure decides. The size is by how much less rate the best quality of the other is exceeded as
    surely. Frames vary as the cube root of their quality does, so that what is better on every frame counts, by however
    much on each.
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
    rates, levels = _distinct(log_rates, means)
    if len(levels) == 1:
        return lambda qualities: np.full(len(qualities), rates[0])
    from scipy.interpolate import PchipInterpolator  # loads for half a second

    curve = PchipInterpolator(levels, rates, extrapolate=True)
    return lambda qualities: np.asarray(curve(np.clip(qualities, levels[0], levels[-1])))


def _distinct(values: Array, levels: Array) -> tuple[Array, Array]:
    """Both in order of the levels, none of them twice: settings of one level count with the mean of their values."""
    distinct, places = np.unique(levels, return_inverse=True)
    return np.bincount(places, values) / np.bincount(places), distinct


def curve_values(run: RunResult, column: Column, sequence: str) -> tuple[dict[str, CurveValues], dict[str, str]]:
    """The curves of a sequence by name, and why others are none.

    Places that no setting has a value of, such as frames without ground truth, count for nobody. An infinite value
    counts as the best or the worst that is finite. A setting whose rate is not known is left out of its curve.
    """
    rows, of = _rows(run, column, sequence)
    measured = {key: values for key, values in rows.items() if run.rates.get(key, np.nan) > 0}
    known = {run.curves[key[1:]].curve for key in measured}
    unknown: dict[str, list[str]] = defaultdict(list)
    for key in rows:
        point = run.curves[key[1:]]
        if point.curve not in known:
            unknown[point.curve].append(point.point or "its setting")
    left_out = {curve: f"no rate is known of {', '.join(points)}" for curve, points in unknown.items()}
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
    """Why a column is uninformative on a sequence; empty where it is not. curves, left_out: as by `curve_values`.

    The baseline has to be better than the coarsest settings, and finer settings better than coarser ones. Only codecs
    of several settings say anything of that, and quality, which is measured beside the raw frame, need not show it.
    """
    if not curves:
        return "no setting has a value" if "no value" in left_out.values() else ""
    baselines = {point.curve for (codec, _), point in run.curves.items() if codec in run.schema.baselines}
    means = {curve: found.qualities.mean(axis=1) for curve, found in curves.items()}
    swept = [mean for curve, mean in means.items() if len(mean) > 1 and curve not in baselines]
    if not swept or column.metric.role == "quality":
        return ""
    steps = np.concatenate([(mean - mean[:, None])[np.triu_indices(len(mean), 1)] for mean in swept])
    size = np.abs(steps).sum()
    if size <= _ROUNDING * np.abs(np.concatenate(swept)).max():
        return "all settings of a codec are alike"
    raw, coarsest = [means[curve].mean() for curve in means if curve in baselines], np.median([m[0] for m in swept])
    if raw and np.mean(raw) <= coarsest:
        best, worst = (f"{from_quality(float(x), column) * column.factor:.3g}" for x in (np.mean(raw), coarsest))
        return f"{' and '.join(sorted(baselines))} ({best}) is no better than the coarsest settings ({worst})"
    wrong = -steps[steps < 0].sum() / size
    return (
        "" if wrong <= _OUT_OF_ORDER else f"finer settings are worse in {100 * wrong:.0f} % of the differences, by size"
    )


def _rates(run: RunResult, keys: list[Key], judged: NDArray[np.bool_] | None, units: int) -> Array:
    """(S, U) rates of settings at the judged frames, with each setting's mean rate; the same for all repeats."""
    assert run.rate is not None
    means = np.array([run.rates[key] for key in keys])
    rates = np.repeat(means[:, None], units, axis=1)
    if judged is None:
        return rates
    cells = {each.row: each for each in run.of(run.rate.evaluator.title)}
    for place, key in enumerate(keys):
        if key in cells:
            own = cells[key].values_of_frames(run.rate.metric.name, run.rate.stage)[judged]
            if np.isfinite(own).all() and own.mean() > 0:
                rates[place] = own * (means[place] / own.mean())
    return rates


def _rows(run: RunResult, column: Column, sequence: str) -> tuple[dict[Key, Array], Of]:
    """One row of values a setting, NaN where one is missing, and what they are of; of frames means over repeats.

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
        rows = {row: [each.values_of_frames(column.metric.name, column.stage) for each in repeats]
                for row, repeats in by_row(results).items()}  # fmt: skip
        return {row: np.mean(values, axis=0) for row, values in rows.items()}, "frames"
    found = {row: values for row, values in values_of_repeats(run, column).items() if row[0] == sequence}
    run_by_all = set.intersection(*({repeat for repeat, _ in values} for values in found.values())) if found else set()
    places = sorted({place for values in found.values() for place in values if place[0] in run_by_all})
    return {row: np.array([values.get(place, np.nan) for place in places]) for row, values in found.items()}, "repeats"
