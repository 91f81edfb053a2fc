"""How sure a mean difference is: of independent repeats, and of frames of which each resembles the next.

How much frames resemble each other is estimated from all pairs of codecs together, because all coded the same frames: a
first-order autoregression plus noise of each frame, by Whittle's likelihood of cosines (1953, doi:10.1007/BF02590998),
averaged over a grid of models. The slowest cosines then correct the variance of each pair, as far as pairs differ (the
moderated t of Smyth 2004, doi:10.2202/1544-6115.1027). docs/verdict.md shows how often equal codecs are ordered.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

FEWEST_FRAMES: Final = 8
"""Frames below which nothing can be said of how they depend on each other."""
_ROUNDING: Final = 1e-12
"""Relative differences up to this are none."""
_MOST_BLOCKS: Final = 400
"""Longer series are averaged to so many blocks of neighbours: what matters is how slowly they change."""
_CORRELATIONS: Final = (0.2, 0.4, 0.6, 0.7, 0.8, 0.85, 0.9, 0.93, 0.95, 0.97, 0.98, 0.99, 0.995)
_NOISE_SHARES: Final = {0.0: 0.45, 0.25: 0.3, 0.5: 0.17, 0.75: 0.07, 0.9: 0.01}
"""Shares of independent noise, and how likely each is before anything is seen."""
_WHITE: Final = 0.4
"""How likely it is, before anything is seen, that frames do not resemble each other."""
_SLOW: Final = 6
"""So many of the slowest cosines say whether a pair is as the model has it."""
_TRUST: Final = 2.0
"""The model counts as this many times those cosines: with more a false order in a hundred tables is exceeded."""
_TAIL: Final = 0.1
"""The two-sided probability at which Student's t replaces the average over models."""


@dataclass(frozen=True)
class Evidence:
    """A mean difference, the variance of that mean, and the degrees of freedom with which the variance is known.

    The degrees of freedom are infinite where many frames differ by exactly the same. doubt: by how much the mean may be
    wrong for a reason that more frames would not mend, such as settings far apart.
    """

    mean: float
    variance: float
    freedom: float
    doubt: float = 0.0
    count: int = 0
    worth: float = math.nan
    drifts: bool = False

    @property
    def p_value(self) -> float:
        """Two-sided, that there is no difference."""
        return self.p_beyond(0.0)

    def p_beyond(self, least: float) -> float:
        """Two-sided, that the difference is no larger than `least`, by Student's t.

        1 where repeats do not vary: a single one, or the same run several times, is no evidence.
        """
        distance = abs(self.mean) - least - self.doubt
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
        if math.isinf(self.freedom):
            return self.doubt
        if not (self.freedom > 0 and math.isfinite(self.variance)):
            return math.inf
        return self.doubt + student_quantile(0.5 + confidence / 2.0, self.freedom) * math.sqrt(self.variance)


def student_quantile(level: float, freedom: float) -> float:
    """The value that Student's t with `freedom` degrees of freedom stays below with the probability `level`."""
    from scipy.special import stdtrit  # loads for a quarter of a second, and many commands ask for no quantile

    return float(stdtrit(freedom, level))


def evidence_of_repeats(differences: Array) -> Evidence:
    """What (N,) independent differences say: the paired t-test (Student 1908, doi:10.1093/biomet/6.1.1)."""
    return evidence_of_pairs(differences[None], 1, "repeats")[0]


def evidence_of_frames(differences: Array) -> Evidence:
    """What (N,) differences of neighbours in time say, with no other pair to tell how much they resemble each other."""
    return evidence_of_pairs(differences[None], 1, "frames")[0]


def evidence_of_pairs(differences: Array, independent: int, of: str, tail: float = _TAIL) -> list[Evidence]:
    """What (P, N) differences of P pairs say, each of the same N frames or repeats in the same order.

    independent: how many of the pairs are, one less than there are codecs. of: `frames` in order of time, or `repeats`.
    tail: the two-sided probability at which the evidence will be judged.
    """
    pairs, count = differences.shape
    means = differences.mean(axis=1)
    centered = differences - means[:, None]
    same = np.abs(centered).max(axis=1, initial=0.0) <= _ROUNDING * np.abs(means)
    least = FEWEST_FRAMES if of == "frames" else 2
    variances, freedom = np.full(pairs, np.nan), 0.0
    if count >= least and not same.all():
        if of == "frames":
            variances[~same], freedom = _of_frames(centered[~same], independent, tail)
        else:
            variances[~same], freedom = _of_repeats(centered[~same], independent)
    exact = math.inf if of == "frames" and count >= least else max(0.0, count - 1.0)
    return [
        Evidence(float(mean), 0.0 if equal and count >= least else float(variance),
                 (exact if mean or of == "repeats" else 0.0) if equal else freedom)
        for mean, variance, equal in zip(means, variances, same, strict=True)
    ]  # fmt: skip


def combined(evidence: Sequence[Evidence]) -> Evidence:
    """The mean over sequences, each of the same weight (Welch 1947, doi:10.1093/biomet/34.1-2.28).

    Where a sequence has a single value, sequences are the samples.
    """
    if len(evidence) == 1:
        return evidence[0]
    means = np.array([each.mean for each in evidence])
    doubt = float(np.mean([each.doubt for each in evidence]))
    if any(math.isnan(each.variance) for each in evidence):
        samples = evidence_of_repeats(means)
        return Evidence(samples.mean, samples.variance, samples.freedom, doubt)
    variances = np.array([each.variance for each in evidence]) / len(evidence) ** 2
    total = float(variances.sum())
    spread = float(sum(var**2 / each.freedom for var, each in zip(variances, evidence, strict=True) if var))
    exact = all(math.isinf(each.freedom) for each in evidence)
    return Evidence(float(means.mean()), total, total**2 / spread if spread else math.inf if exact else 0.0, doubt)


def _of_repeats(centered: Array, independent: int) -> tuple[Array, float]:
    """Variances of the means of (P, N) independent values, and the degrees of freedom of all."""
    count = centered.shape[1]
    freedom = count - 1.0
    variances = (centered**2).sum(axis=1) / freedom
    prior, typical = _common(variances, freedom)
    if math.isinf(prior):
        return np.full(len(variances), typical) / count, freedom * independent
    known = min(prior + freedom, freedom * max(1, independent))
    return (prior * typical + freedom * variances) / (prior + freedom) / count, known


def _of_frames(centered: Array, independent: int, tail: float) -> tuple[Array, float]:
    """Variances of the means of (P, N) series about zero, and the degrees of freedom of all."""
    from scipy.fft import dct
    from scipy.special import stdtr  # as in student_quantile

    if centered.shape[1] > _MOST_BLOCKS:
        centered = np.array([block_means(series, _MOST_BLOCKS) for series in centered])
    count = centered.shape[1]
    powers = np.maximum(dct(centered, norm="ortho", axis=1)[:, 1:] ** 2, np.finfo(float).tiny)
    spectra, sums, log_priors = _models(count)
    scales = (powers[None] / spectra[:, None]).mean(axis=2)
    misfit = (((count - 1) * np.log(scales)).mean(axis=1) + np.log(spectra).sum(axis=1)) * max(1, independent)
    weights = np.exp(log_priors - 0.5 * misfit - (log_priors - 0.5 * misfit).max())
    weights /= weights.sum()
    slow = min(_SLOW, count - 1)
    expected = np.einsum("m,mk,mp->pk", weights, spectra[:, :slow], scales)
    ratios = (powers[:, :slow] / expected).mean(axis=1)
    prior, typical = _common(ratios, slow) if len(ratios) > 1 else (_TRUST * slow, 1.0)
    typical = max(typical, 1.0)
    if math.isinf(prior):
        ratios = np.full(len(ratios), typical)
    else:
        ratios = (prior * typical + slow * ratios) / (prior + slow)
    freedom = min(prior + slow, _TRUST * slow * max(1, independent))
    errors = np.sqrt(sums[:, None] * scales * ratios / count)  # of the mean, by model and pair
    low, high = np.zeros(len(ratios)), 1e3 * errors.max(axis=0)
    for _ in range(60):  # where the average over models has the tail, by bisection
        middle = 0.5 * (low + high)
        beyond = weights @ (2.0 * stdtr(freedom, -middle / errors)) > tail
        low, high = np.where(beyond, middle, low), np.where(beyond, high, middle)
    return (high / student_quantile(1.0 - tail / 2.0, freedom)) ** 2, freedom


@lru_cache(maxsize=4)
def _models(count: int) -> tuple[Array, Array, Array]:
    """(M, N-1) power of each cosine by model, (M,) N times the variance of the mean, (M,) logs of the prior."""
    lags = np.abs(np.subtract.outer(np.arange(count), np.arange(count)))
    cosines = np.cos(np.pi * np.outer(np.arange(1, count), np.arange(count) + 0.5) / count) * math.sqrt(2.0 / count)
    spectra, sums, priors = [np.ones(count - 1)], [1.0], [_WHITE]
    for correlation in _CORRELATIONS:
        matrix = correlation**lags
        spectrum, total = np.einsum("ij,ij->i", cosines @ matrix, cosines), float(matrix.sum()) / count
        for noise, share in _NOISE_SHARES.items():
            spectra.append(noise + (1.0 - noise) * spectrum)
            sums.append(noise + (1.0 - noise) * total)
            priors.append((1.0 - _WHITE) * share / len(_CORRELATIONS))
    return np.array(spectra), np.array(sums), np.log(priors)


def _common(variances: Array, freedom: float) -> tuple[float, float]:
    """Degrees of freedom and value of what variances have in common (Smyth 2004, section 6.2); none for one."""
    from scipy.special import digamma, polygamma  # as in student_quantile

    if len(variances) < 2:
        return 0.0, 1.0
    logs = np.log(np.maximum(variances, np.finfo(float).tiny)) - digamma(freedom / 2.0) + math.log(freedom / 2.0)
    excess = float(logs.var(ddof=1) - polygamma(1, freedom / 2.0))
    if excess <= 0.0:
        return math.inf, math.exp(float(logs.mean()))
    half = 0.5 + 1.0 / excess  # Newton's method for the inverse of the trigamma function
    for _ in range(50):
        trigamma = float(polygamma(1, half))
        half += trigamma * (1.0 - trigamma / excess) / float(polygamma(2, half))
    return 2.0 * half, math.exp(float(logs.mean() + digamma(half)) - math.log(half))


def block_means(values: Array, count: int) -> Array:
    """(B,) means of `count` contiguous blocks of (N,) values, of lengths as equal as can be; at most N."""
    edges = np.linspace(0, len(values), max(1, min(count, len(values))) + 1).round().astype(int)
    return np.asarray(np.add.reduceat(values, edges[:-1]) / np.diff(edges))


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
