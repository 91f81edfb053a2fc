"""How sure a mean difference is: of independent repeats, and of frames of which each resembles the next.

Source for frames: the equal-weighted cosine estimator of the variance of a mean, and its t-test, of Lazarus, Lewis,
Stock and Watson, Journal of Business & Economic Statistics 36(4), 2018, doi:10.1080/07350015.2018.1506926. Deviation:
fewer cosines than their rule where means of neighbours still resemble each other, because frames of a slow camera do.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FEWEST_FRAMES: Final = 8
"""Frames below which nothing can be said of how they depend on each other."""
_ROUNDING: Final = 1e-12
"""Relative differences up to this are none."""
_COSINES: Final = 0.41
"""Times the number of frames to the power of 2/3: the rule of the source."""
_SHARE: Final = 0.5
"""Cosines for each block of neighbours that is worth an independent one: by simulation, see docs/verdict.md."""
_FEWEST_COSINES: Final = 3


@dataclass(frozen=True)
class Evidence:
    """A mean difference, the variance of that mean, and the degrees of freedom with which the variance is known.

    The degrees of freedom are infinite where many frames differ by exactly the same.
    """

    mean: float
    variance: float
    freedom: float

    @property
    def p_value(self) -> float:
        """Two-sided, that there is no difference, by Student's t.

        1 where repeats do not vary: a single one, or the same run several times, is no evidence.
        """
        if math.isinf(self.freedom):
            return 0.0
        if not (self.freedom >= 1 and self.variance > (_ROUNDING * self.mean) ** 2):
            return 1.0
        from scipy.special import stdtr  # as in student_quantile

        return float(2.0 * stdtr(self.freedom, -abs(self.mean) / math.sqrt(self.variance)))


def student_quantile(level: float, freedom: float) -> float:
    """The value that Student's t with `freedom` degrees of freedom stays below with the probability `level`."""
    from scipy.special import stdtrit  # loads for a quarter of a second, and many commands ask for no quantile

    return float(stdtrit(freedom, level))


def evidence_of_repeats(differences: Array) -> Evidence:
    """What (N,) independent differences say: the paired t-test (Student 1908, doi:10.1093/biomet/6.1.1)."""
    count = len(differences)
    variance = float(np.var(differences, ddof=1)) / count if count > 1 else math.nan
    return Evidence(float(differences.mean()), variance, count - 1)


def evidence_of_frames(differences: Array) -> Evidence:
    """What (N,) differences of neighbours in time say: a t-test with a degree of freedom for each cosine that is used.

    Neighbouring frames show the same things, so that single ones are no independent samples. The variance of their mean
    is read from the slowest of their changes: the mean square of their projections on the first cosines.
    """
    count, mean = len(differences), float(differences.mean())
    centred = differences - mean
    if count < FEWEST_FRAMES:
        return Evidence(mean, math.nan, 0.0)
    if np.abs(centred).max() <= _ROUNDING * abs(mean):
        return Evidence(mean, 0.0, math.inf if mean else 0.0)
    cosines = _cosines(centred)
    times = (np.arange(count) + 0.5) / count
    projections = math.sqrt(2.0 / count) * np.cos(np.pi * np.outer(np.arange(1, cosines + 1), times)) @ centred
    return Evidence(mean, float(projections @ projections) / cosines / count, cosines)


def combined(found: Sequence[Evidence]) -> Evidence:
    """The mean over sequences, each of the same weight (Welch 1947, doi:10.1093/biomet/34.1-2.28).

    Where a sequence has a single value, sequences are the samples.
    """
    if len(found) == 1:
        return found[0]
    means = np.array([each.mean for each in found])
    if any(math.isnan(each.variance) for each in found):
        return evidence_of_repeats(means)
    variances = np.array([each.variance for each in found]) / len(found) ** 2
    total = float(variances.sum())
    spread = float(sum(variance**2 / each.freedom for variance, each in zip(variances, found, strict=True) if variance))
    exact = all(math.isinf(each.freedom) for each in found)
    return Evidence(float(means.mean()), total, total**2 / spread if spread else math.inf if exact else 0.0)


def _cosines(centred: Array) -> int:
    """On how many cosines the variance of the mean of a series (N,) about zero is read."""
    blocks = block_means(centred, math.isqrt(len(centred)))
    independent = len(blocks) / _time_constant(blocks)
    return max(_FEWEST_COSINES, int(min(_COSINES * len(centred) ** (2.0 / 3.0), _SHARE * independent)))


def block_means(values: Array, count: int) -> Array:
    """(B,) means of `count` contiguous blocks of (N,) values, of lengths as equal as can be; at most N."""
    edges = np.linspace(0, len(values), max(1, min(count, len(values))) + 1).round().astype(int)
    return np.asarray(np.add.reduceat(values, edges[:-1]) / np.diff(edges))


def _time_constant(values: Array) -> float:
    """How many values are worth one independent one, from the correlation of neighbours; at least 1.

    (1 + r) / (1 - r), where r is that correlation, corrected for its bias (Marriott and Pope 1954,
    doi:10.1093/biomet/41.3-4.390).
    """
    centred = values - values.mean()
    power = float(centred @ centred)
    if len(values) < 3 or power == 0.0:
        return 1.0
    found = float(centred[1:] @ centred[:-1]) / power
    correlation = min(max(found + (1.0 + 4.0 * found) / len(values), 0.0), 0.99)
    return (1.0 + correlation) / (1.0 - correlation)


Values = NDArray[np.float64]

SIGNIFICANCE: Final = 0.05
"""Two-sided, of intervals and of the smallest difference that can be shown."""
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


def paired_difference(first: Values, second: Values) -> PairedDifference:
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


LENGTHENING: Final = 1.5
_NOISE: Final = 2.0
"""Standard errors (of base-10 log n / n) up to which an autocorrelation counts as none (Politis and White)."""


def block_length(series: Values) -> int:
    """The length of blocks for the standard error of the mean of a series (N,), up to N / 3; 1 for fewer than eight."""
    count = len(series)
    if count < FEWEST_FRAMES:
        return 1
    longest = max(1, math.floor(min(3.0 * math.sqrt(count), count / 3.0)))
    return int(np.clip(round(LENGTHENING * _best_length(series)), math.ceil(count ** (1.0 / 3.0)), longest))


def _best_length(series: Values) -> float:
    """The length by Politis and White, 1 where neighbours do not resemble each other."""
    count = len(series)
    if np.ptp(series) == 0.0:
        return 1.0
    quiet = max(5, math.ceil(math.log10(count)))
    lags = min(math.ceil(math.sqrt(count)) + quiet, count - 1)
    centred = series - series.mean()
    covariances = np.array([centred[lag:] @ centred[: count - lag] for lag in range(lags + 1)]) / count
    reach = _last_dependent_lag(covariances / covariances[0], count, quiet)
    if reach == 0:
        return 1.0
    width = min(2 * reach, lags)
    steps = np.arange(1, width + 1)
    weights = np.minimum(1.0, 2.0 * (1.0 - steps / width))
    slope = 2.0 * np.sum(weights * steps * covariances[1 : width + 1])
    spectrum = covariances[0] + 2.0 * np.sum(weights * covariances[1 : width + 1])
    if spectrum <= 0.0:
        return 1.0
    return float((1.5 * (slope / spectrum) ** 2 * count) ** (1.0 / 3.0))  # (2 g^2 / (4/3 s^2))^(1/3) n^(1/3)


def longest_block(rows: Values) -> int:
    """The longest of the block lengths of rows (M, N) of the same frames; values that are not finite are left out."""
    return max((block_length(row[np.isfinite(row)]) for row in rows), default=1)


def drawn_blocks(rng: np.random.Generator, count: int, block: int) -> NDArray[np.int64]:
    """(count,) positions of a resample: runs of `block` neighbours, each from anywhere, the last one cut."""
    block = min(block, count)
    starts = rng.integers(0, count - block + 1, -(-count // block))
    return np.asarray((starts[:, None] + np.arange(block)).ravel()[:count])


def _last_dependent_lag(correlations: Values, count: int, quiet: int) -> int:
    """The lag after which `quiet` autocorrelations in a row are no more than noise; the last that is more, else."""
    noise = _NOISE * math.sqrt(math.log10(count) / count)
    loud = np.abs(correlations[1:]) >= noise
    for lag in range(len(loud) - quiet + 1):
        if not loud[lag : lag + quiet].any():
            return lag
    return int(np.flatnonzero(loud).max(initial=-1)) + 1
