"""How sure a mean difference is: of independent repeats, and of frames of which each resembles the next.

An interval is made of its two codecs alone, whoever else is in the table. docs/verdict.md shows how often equal codecs
are ordered, and how often intervals cover the truth.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FEWEST_FRAMES: Final = 8
"""Frames below which nothing can be said of how they depend on each other."""
_ROUNDING: Final = 1e-12
"""Relative differences up to this are none."""
SIGNIFICANCE: Final = 0.05
"""Two-sided, of intervals and of the smallest difference that can be shown; one-sided, of a drift."""
_COSINES: Final = 0.4
"""So many cosines times the number of frames to the power of 2/3 (Lazarus and others 2018, section 4)."""
_EACH: Final = 2
"""So many cosines for each independent series, as fewer series show less well that slow changes have more power."""
_STEEP: Final = 0.4
_STEEP_ALONE: Final = 0.2
"""Levels of the F test that the slowest cosines have more power than the next: many series are tested at the tails."""
_SHARE: Final = 0.8
"""Share of the degrees of freedom that is left after B was chosen by the same series."""
_TINY: Final = float(np.finfo(float).tiny)


@dataclass(frozen=True)
class Evidence:
    """A mean difference, the variance of that mean, and the degrees of freedom with which the variance is known.

    The degrees of freedom are infinite if many frames differ by exactly the same. doubt: by how much the mean may be
    wrong for a reason that more frames would not mend, such as settings far apart. count: frames or repeats. worth: how
    many independent ones they count as; NaN if that is not known. drifts: the slowest changes have significantly more
    power than the next, so that the variance may be too small. at_least: the mean is a bound, as one codec is better at
    no more rate; then it has no interval, and the test is of that.
    """

    mean: float
    variance: float
    freedom: float
    doubt: float = 0.0
    count: int = 0
    worth: float = math.nan
    drifts: bool = False
    at_least: bool = False

    @property
    def p_value(self) -> float:
        """Two-sided, that there is no difference."""
        return self.p_beyond(0.0)

    def p_beyond(self, least: float) -> float:
        """Two-sided, that the difference is no larger than `least`, by Student's t.

        1 where repeats do not vary: a single one, or the same run several times, is no evidence.
        """
        distance = abs(self.mean) - (0.0 if self.at_least else least + self.doubt)
        if not distance > 0.0:
            return 1.0
        if math.isinf(self.freedom):
            return 0.0
        if not (self.freedom > 0 and self.variance > (_ROUNDING * self.mean) ** 2):
            return 1.0
        from scipy.special import stdtr  # as in student_quantile

        return float(2.0 * stdtr(self.freedom, -distance / math.sqrt(self.variance)))

    def reach(self, confidence: float) -> float:
        """Half the width of the interval with this confidence; infinite if nothing is known."""
        if self.at_least:
            return math.inf
        if math.isinf(self.freedom):
            return self.doubt
        if not (self.freedom > 0 and math.isfinite(self.variance)):
            return math.inf
        return self.doubt + student_quantile(0.5 + confidence / 2.0, self.freedom) * math.sqrt(self.variance)


def student_quantile(level: float, freedom: float) -> float:
    """The value that Student's t with `freedom` degrees of freedom stays below with the probability `level`."""
    from scipy.special import stdtrit  # loads for a quarter of a second, and many commands ask for no quantile

    return float(stdtrit(freedom, level))


def evidence_of_repeats(differences: Array, alike: Array | None = None) -> Evidence:
    """What (N,) independent differences say: the paired t-test (Student 1908, doi:10.1093/biomet/6.1.1).

    alike: (M, N) differences between settings of the same two codecs, which say how much such differences scatter: then
    the moderated t-test (Smyth 2004, doi:10.2202/1544-6115.1027).
    """
    count = len(differences)
    mean, same = _mean(differences)
    if count < 2 or same:
        return Evidence(mean, 0.0 if count > 1 else math.nan, max(0.0, count - 1.0), 0.0, count, count)
    series = _varying(differences, alike)
    variances, freedom = series.var(axis=1, ddof=1), count - 1.0
    prior, typical = _common(variances, freedom)
    if math.isinf(prior):
        variance, known = typical, math.inf
    else:
        variance, known = (prior * typical + freedom * variances[0]) / (prior + freedom), prior + freedom
    return Evidence(mean, variance / count, min(known, freedom * _independent(series)), 0.0, count, count)


def evidence_of_frames(differences: Array, alike: Array | None = None, *, halved: bool = True) -> Evidence:
    """What (N,) differences of neighbors in time say of their mean.

    Equal-weighted cosines (Lazarus, Lewis, Stock and Watson 2018, doi:10.1080/07350015.2018.1506926): N times the
    variance of a mean is the mean power of the B slowest type-II cosines, for Student's t with B degrees of freedom.
    B is 0.4 N^(2/3), halved while the slowest B have more power than the next 2 B, but not below 2.

    alike: (M, N) differences between settings of the same two codecs. They resemble their neighbors as the differences
    themselves do, so that the ratio of slow power to all is their mean, or that of the differences if it is larger. It
    has B M^2 / sum(r^2) degrees of freedom, r the correlations of all (Satterthwaite 1946, doi:10.2307/3002019). B is
    at most twice that number of independent series, and may be halved down to 1; a fifth of the degrees of freedom is
    spent on choosing it.

    halved: whether B may be halved. Not for the interval of one setting's own mean: which settings have few cosines is
    then much by chance, and one that is no better than another would pass before it.
    """
    count = len(differences)
    mean, same = _mean(differences)
    if count < FEWEST_FRAMES:
        return Evidence(mean, math.nan, 0.0, 0.0, count)
    if same:
        return Evidence(mean, 0.0, math.inf if mean else 0.0, 0.0, count, count)
    from scipy.fft import dct
    from scipy.special import fdtrc  # loads for a quarter of a second, and many commands ask for no quantile

    series = _varying(differences, alike)
    powers = dct(series, norm="ortho", axis=1)[:, 1:] ** 2  # without the mean's
    independent = _independent(series)
    most = _COSINES * count ** (2.0 / 3.0)
    fewest, level, share = (2, _STEEP_ALONE, 1.0) if alike is None else (1, _STEEP, _SHARE)
    cosines = max(fewest, round(most if alike is None else min(most, _EACH * independent)))
    while True:
        nearby = powers[:, : 3 * cosines] / np.maximum(powers[:, : 3 * cosines].mean(axis=1, keepdims=True), _TINY)
        rise = float(nearby[:, :cosines].mean() / max(float(nearby[:, cosines:].mean()), _TINY))
        chance = float(fdtrc(cosines * independent, 2.0 * cosines * independent, rise))
        if not halved or chance >= level or cosines // 2 < fewest:
            break
        cosines //= 2
    ratios = powers[:, :cosines].mean(axis=1) / powers.mean(axis=1)
    ratio = max(float(ratios[0]), float(ratios.mean()))
    variance, freedom = ratio * float(powers[0].sum()) / (count - 1) / count, share * cosines * independent
    return Evidence(
        mean, variance, freedom, 0.0, count, min(count, count / max(ratio, _ROUNDING)), chance < SIGNIFICANCE
    )


def _mean(differences: Array) -> tuple[float, bool]:
    """The mean, and whether all are equal to it."""
    mean = float(differences.mean())
    return mean, bool(np.abs(differences - mean).max(initial=0.0) <= _ROUNDING * abs(mean))


def _varying(differences: Array, alike: Array | None) -> Array:
    """(1 + M, N) the differences and those like them, about their means; without those that do not vary."""
    rows = differences[None] if alike is None else np.vstack([differences, alike])
    centered = rows - rows.mean(axis=1, keepdims=True)
    sizes = np.abs(centered).max(axis=1)
    return np.asarray(centered[sizes > 1e-9 * sizes[0]])


def _independent(series: Array) -> float:
    """How many independent series (M, N) about zero are worth, by their correlations; fewer if N is small."""
    scaled = series / np.sqrt((series**2).sum(axis=1, keepdims=True))
    return 1.0 if len(series) == 1 else float(len(series) ** 2 / ((scaled @ scaled.T) ** 2).sum())


def combined(evidence: Sequence[Evidence]) -> Evidence:
    """The mean over sequences, each of the same weight (Welch 1947, doi:10.1093/biomet/34.1-2.28).

    Where a sequence has a single value, sequences are the samples.
    """
    if len(evidence) == 1:
        return evidence[0]
    means = np.array([each.mean for each in evidence])
    doubt = float(np.mean([each.doubt for each in evidence]))
    count, at_least = sum(each.count for each in evidence), any(each.at_least for each in evidence)
    if any(math.isnan(each.variance) for each in evidence):
        samples = evidence_of_repeats(means)
        return replace(samples, doubt=doubt, at_least=at_least)
    variances = np.array([each.variance for each in evidence]) / len(evidence) ** 2
    total = float(variances.sum())
    spread = float(sum(var**2 / each.freedom for var, each in zip(variances, evidence, strict=True) if var))
    exact = all(math.isinf(each.freedom) for each in evidence)
    freedom = total**2 / spread if spread else math.inf if exact else 0.0
    worth, drifts = sum(each.worth for each in evidence), all(each.drifts for each in evidence)
    return Evidence(float(means.mean()), total, freedom, doubt, count, worth, drifts, at_least)


def _common(variances: Array, freedom: float) -> tuple[float, float]:
    """Degrees of freedom and value of what variances have in common (Smyth 2004, section 6.2); none for one."""
    from scipy.special import digamma, polygamma  # as in student_quantile

    if len(variances) < 2:
        return 0.0, 1.0
    logs = np.log(np.maximum(variances, _TINY)) - digamma(freedom / 2.0) + math.log(freedom / 2.0)
    excess = float(logs.var(ddof=1) - polygamma(1, freedom / 2.0))
    if excess <= 0.0:
        return math.inf, math.exp(float(logs.mean()))
    half = 0.5 + 1.0 / excess  # Newton's method for the inverse of the trigamma function
    for _ in range(50):
        trigamma = float(polygamma(1, half))
        half += trigamma * (1.0 - trigamma / excess) / float(polygamma(2, half))
    return 2.0 * half, math.exp(float(logs.mean() + digamma(half)) - math.log(half))


POWER: Final = 0.8
"""How often a difference of that size would be found."""


@dataclass(frozen=True)
class PairedDifference:
    """By how much the mean of one series of frames exceeds that of another of the same frames.

    mean: the difference. standard_error: of that mean. freedom: the degrees of freedom with which it is known.
    interval: of 95 %. p_value: two-sided, that no difference would look like this. detectable: the smallest difference
    that so many frames show at 5 % in four of five cases. frames: that have both values. missing: that have one. All
    numbers are NaN for fewer than eight frames.
    """

    mean: float
    standard_error: float
    freedom: float
    interval: tuple[float, float]
    p_value: float
    detectable: float
    frames: int
    missing: int


def paired_difference(first: Array, second: Array) -> PairedDifference:
    """What (N,) values of the same frames in the same order say of the difference `first` - `second`.

    Values that are not finite are missing. Equal series have a p-value of 1. Raises ValueError for series of different
    lengths.
    """
    if first.shape != second.shape or first.ndim != 1:
        raise ValueError(f"two series of the same frames have one length; got {first.shape} and {second.shape}")
    both = np.isfinite(first) & np.isfinite(second)
    differences = first[both] - second[both]
    missing = int(np.count_nonzero(np.isfinite(first) != np.isfinite(second)))
    count = len(differences)
    if count < FEWEST_FRAMES:
        nan = math.nan
        return PairedDifference(nan, nan, nan, (nan, nan), nan, nan, count, missing)
    found = evidence_of_frames(differences)
    error, freedom = math.sqrt(found.variance), found.freedom
    reach, more = (
        student_quantile(level, freedom) * error if error else 0.0 for level in (1 - SIGNIFICANCE / 2, POWER)
    )
    interval = (found.mean - reach, found.mean + reach)
    return PairedDifference(found.mean, error, freedom, interval, found.p_value, reach + more, count, missing)
