"""Standard errors of mean differences, over independent repeats and over autocorrelated frames.

An interval depends on its two codecs alone, not on the others in the table. docs/verdict.md shows how often equal
codecs are ordered (false positives), and how often intervals cover the truth.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import scipy
from numpy.typing import NDArray

Array = NDArray[np.float64]

FEWEST_FRAMES: Final = 8
"""Frames below which their autocorrelation cannot be estimated."""
_ROUNDING: Final = 1e-12
"""Relative difference up to which values are equal."""
SIGNIFICANCE: Final = 0.05
"""Two-sided level of intervals and of the smallest detectable difference; one-sided level of a drift."""
_COSINES: Final = 0.4
"""Number of cosines over the number of frames to the power of 2/3 (Lazarus and others 2018, section 4)."""
_EACH: Final = 2
"""Cosines for each independent series; with fewer series, excess power of slow changes is harder to detect."""
_STEEP: Final = 0.4
_STEEP_ALONE: Final = 0.2
"""Levels of the F test for excess power of the slowest cosines, for several series and for one."""
_SHARE: Final = 0.8
"""Share of the degrees of freedom that is left after the same series chose B."""
_TINY: Final = float(np.finfo(float).tiny)


@dataclass(frozen=True)
class Evidence:
    """A mean difference with its variance, tested by Student's t."""

    mean: float
    variance: float
    """Of the mean; NaN if unknown."""
    freedom: float
    """Degrees of freedom of the variance; infinite if many frames differ by exactly the same."""
    doubt: float = 0.0
    """Systematic error of the mean that more samples would not reduce, such as from settings far apart."""
    count: int = 0
    """Frames or repeats."""
    worth: float = math.nan
    """Effective number of independent samples; NaN if unknown."""
    drifts: bool = False
    """Whether the slowest changes have significantly more power than the next, so that `variance` may be too small."""
    at_least: bool = False
    """Whether the mean is a bound, as one codec is better at no more rate; it has no interval, but a test."""

    @property
    def p_value(self) -> float:
        """The two-sided p-value of no difference."""
        return self.p_beyond(0.0)

    def p_beyond(self, least: float) -> float:
        """The two-sided p-value of a difference no larger than `least`, by Student's t.

        1 if repeats do not vary: a single one, or the same run several times, is no evidence.
        """
        distance = abs(self.mean) - (0.0 if self.at_least else least + self.doubt)
        if not distance > 0.0:
            return 1.0
        if math.isinf(self.freedom):
            return 0.0
        if not (self.freedom > 0 and self.variance > (_ROUNDING * self.mean) ** 2):
            return 1.0

        return float(2.0 * scipy.special.stdtr(self.freedom, -distance / math.sqrt(self.variance)))

    def reach(self, confidence: float) -> float:
        """Half the width of the confidence interval; infinite if unknown."""
        if self.at_least:
            return math.inf
        if math.isinf(self.freedom):
            return self.doubt
        if not (self.freedom > 0 and math.isfinite(self.variance)):
            return math.inf
        return self.doubt + student_quantile(0.5 + confidence / 2.0, self.freedom) * math.sqrt(self.variance)


def student_quantile(level: float, freedom: float) -> float:
    """The quantile of Student's t with `freedom` degrees of freedom at the probability `level`."""
    return float(scipy.special.stdtrit(freedom, level))


def evidence_of_repeats(differences: Array, alike: Array | None = None) -> Evidence:
    """Estimate the mean of (N,) independent differences, for the paired t-test (doi:10.1093/biomet/6.1.1).

    alike: (M, N) differences between settings of the same two codecs, which share their variance with the differences:
    the moderated t-test (Smyth 2004, doi:10.2202/1544-6115.1027).
    """
    count = len(differences)
    mean, same = _mean(differences)
    if count < 2 or same:
        return Evidence(mean, 0.0 if count > 1 else math.nan, max(0.0, count - 1.0), 0.0, count, count)
    series = _centered_series(differences, alike)
    variances, freedom = series.var(axis=1, ddof=1), count - 1.0
    prior, typical = _variance_prior(variances, freedom)
    if math.isinf(prior):
        variance, known = typical, math.inf
    else:
        variance, known = (prior * typical + freedom * variances[0]) / (prior + freedom), prior + freedom
    return Evidence(mean, variance / count, min(known, freedom * _independent_count(series)), 0.0, count, count)


def evidence_of_frames(differences: Array, alike: Array | None = None, *, halved: bool = True) -> Evidence:
    """Estimate the mean of (N,) autocorrelated differences in the order of time.

    Equal-weighted cosines (Lazarus, Lewis, Stock and Watson 2018, doi:10.1080/07350015.2018.1506926): N times the
    variance of a mean is the mean power of the B slowest type-II cosines, for Student's t with B degrees of freedom.
    B is 0.4 N^(2/3), halved while the slowest B have more power than the next 2 B, but not below 2.

    alike: (M, N) differences between settings of the same two codecs. They are autocorrelated as the differences are,
    so that the ratio of slow power to all is averaged over them, or that of the differences if it is larger. It has
    B M^2 / sum(r^2) degrees of freedom, r the correlations of all (Satterthwaite 1946, doi:10.2307/3002019). B is at
    most twice that number of independent series, and may be halved down to 1. Choosing it costs a fifth of the degrees
    of freedom.

    halved: whether B may be halved. The interval of a single setting's mean must not: chance would give some settings
    few cosines, and one that is no better than another would pass before it.
    """
    count = len(differences)
    mean, same = _mean(differences)
    if count < FEWEST_FRAMES:
        return Evidence(mean, math.nan, 0.0, 0.0, count)
    if same:
        return Evidence(mean, 0.0, math.inf if mean else 0.0, 0.0, count, count)

    series = _centered_series(differences, alike)
    powers = scipy.fft.dct(series, norm="ortho", axis=1)[:, 1:] ** 2  # without the mean's
    independent = _independent_count(series)
    most = _COSINES * count ** (2.0 / 3.0)
    fewest, level, share = (2, _STEEP_ALONE, 1.0) if alike is None else (1, _STEEP, _SHARE)
    cosines = max(fewest, round(most if alike is None else min(most, _EACH * independent)))
    while True:
        nearby = powers[:, : 3 * cosines] / np.maximum(powers[:, : 3 * cosines].mean(axis=1, keepdims=True), _TINY)
        rise = float(nearby[:, :cosines].mean() / max(float(nearby[:, cosines:].mean()), _TINY))
        chance = float(scipy.special.fdtrc(cosines * independent, 2.0 * cosines * independent, rise))
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


def _centered_series(differences: Array, alike: Array | None) -> Array:
    """(1 + M, N) the differences and those like them, less their means; without those that do not vary."""
    rows = differences[None] if alike is None else np.vstack([differences, alike])
    centered = rows - rows.mean(axis=1, keepdims=True)
    sizes = np.abs(centered).max(axis=1)
    return np.asarray(centered[sizes > 1e-9 * sizes[0]])


def _independent_count(series: Array) -> float:
    """The effective number of independent series in (M, N) centered ones; less if N is small."""
    scaled = series / np.sqrt((series**2).sum(axis=1, keepdims=True))
    return 1.0 if len(series) == 1 else float(len(series) ** 2 / ((scaled @ scaled.T) ** 2).sum())


def combine(evidence: Sequence[Evidence]) -> Evidence:
    """Average over sequences of equal weight (Welch 1947, doi:10.1093/biomet/34.1-2.28).

    If the variance on a sequence is unknown, sequences are the samples.
    """
    if len(evidence) == 1:
        return evidence[0]
    means = np.array([item.mean for item in evidence])
    doubt = float(np.mean([item.doubt for item in evidence]))
    count, at_least = sum(item.count for item in evidence), any(item.at_least for item in evidence)
    if any(math.isnan(item.variance) for item in evidence):
        samples = evidence_of_repeats(means)
        return replace(samples, doubt=doubt, at_least=at_least)
    variances = np.array([item.variance for item in evidence]) / len(evidence) ** 2
    total = float(variances.sum())
    spread = float(sum(var**2 / item.freedom for var, item in zip(variances, evidence, strict=True) if var))
    exact = all(math.isinf(item.freedom) for item in evidence)
    freedom = total**2 / spread if spread else math.inf if exact else 0.0
    worth, drifts = sum(item.worth for item in evidence), all(item.drifts for item in evidence)
    return Evidence(float(means.mean()), total, freedom, doubt, count, worth, drifts, at_least)


def _variance_prior(variances: Array, freedom: float) -> tuple[float, float]:
    """Degrees of freedom and value of the variances' prior (Smyth 2004, section 6.2); (0, 1) for one variance."""

    if len(variances) < 2:
        return 0.0, 1.0
    logs = np.log(np.maximum(variances, _TINY)) - scipy.special.digamma(freedom / 2.0) + math.log(freedom / 2.0)
    excess = float(logs.var(ddof=1) - scipy.special.polygamma(1, freedom / 2.0))
    if excess <= 0.0:
        return math.inf, math.exp(float(logs.mean()))
    half = 0.5 + 1.0 / excess  # Newton's method for the inverse of the trigamma function
    for _ in range(50):
        trigamma = float(scipy.special.polygamma(1, half))
        half += trigamma * (1.0 - trigamma / excess) / float(scipy.special.polygamma(2, half))
    return 2.0 * half, math.exp(float(logs.mean() + scipy.special.digamma(half)) - math.log(half))


POWER: Final = 0.8
"""Statistical power at which a smallest detectable difference is computed."""


@dataclass(frozen=True)
class PairedDifference:
    """By how much the mean of one series of frames exceeds that of another; NaN for fewer than eight frames."""

    mean: float
    """The mean difference."""
    standard_error: float
    freedom: float
    """Degrees of freedom of the standard error."""
    interval: tuple[float, float]
    """The 95 % confidence interval."""
    p_value: float
    """Two-sided."""
    detectable: float
    """The smallest difference that is significant at 5 % with a power of 80 %."""
    frames: int
    """Frames with both values."""
    missing: int
    """Frames with one value."""


def paired_difference(first: Array, second: Array) -> PairedDifference:
    """Test the mean difference `first` - `second` of two series of (N,) values of the same frames, in order.

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
    evidence = evidence_of_frames(differences)
    error, freedom = math.sqrt(evidence.variance), evidence.freedom
    reach, more = (
        student_quantile(level, freedom) * error if error else 0.0 for level in (1 - SIGNIFICANCE / 2, POWER)
    )
    interval = (evidence.mean - reach, evidence.mean + reach)
    return PairedDifference(evidence.mean, error, freedom, interval, evidence.p_value, reach + more, count, missing)
