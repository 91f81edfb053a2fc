"""Blocks of neighbours: how to draw from, and how sure to be of, frames of which each resembles the next.

Sources: the moving-block bootstrap of Kuensch, Annals of Statistics 17(3), 1989, doi:10.1214/aos/1176347265; the length
of its blocks after Politis and White, Econometric Reviews 23(1), 2004, doi:10.1081/ETR-120028836, with the correction
of Patton, Politis and White, Econometric Reviews 28(4), 2009, doi:10.1080/07474930802459016. Deviation: blocks are
LENGTHENING times as long and never shorter than the cube root of the number of values, because errors that are too
small, as they are for a few hundred frames, would find differences where there are none.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

Values = NDArray[np.float64]

SIGNIFICANCE: Final = 0.05
"""Two-sided, of intervals and of the smallest difference that can be shown."""
POWER: Final = 0.8
"""How often a difference of that size would be found."""
_FEWEST: Final = 8
"""Values below which nothing can be said of how they depend on each other."""
LENGTHENING: Final = 1.5
_NOISE: Final = 2.0
"""Standard errors (of base-10 log n / n) up to which an autocorrelation counts as none (Politis and White)."""


@dataclass(frozen=True)
class PairedDifference:
    """By how much the mean of one series of frames exceeds that of another of the same frames.

    mean: the difference. standard_error: of the moving-block bootstrap. interval: of 95 %. p_value: two-sided, that no
    difference would look like this. detectable: the smallest difference that so many frames show at 5 % in four of five
    cases. frames: that have both values. missing: that have one. block: its length in frames. All numbers are NaN for
    fewer than eight frames.
    """

    mean: float
    standard_error: float
    interval: tuple[float, float]
    p_value: float
    detectable: float
    frames: int
    missing: int
    block: int


def paired_difference(first: Values, second: Values) -> PairedDifference:
    """What (N,) values of the same frames in the same order say of the difference `first` - `second`.

    Source of the test: the mean over its standard error beside Student's t with as many degrees of freedom as there are
    whole blocks, less one. Equal series have a p-value of 1.
    """
    if first.shape != second.shape or first.ndim != 1:
        raise ValueError(f"two series of the same frames have one length; got {first.shape} and {second.shape}")
    both = np.isfinite(first) & np.isfinite(second)
    differences = first[both] - second[both]
    missing = int(np.count_nonzero(np.isfinite(first) != np.isfinite(second)))
    count = len(differences)
    if count < _FEWEST:
        nan = math.nan
        return PairedDifference(nan, nan, (nan, nan), nan, nan, count, missing, 1)
    block = block_length(differences)
    error, mean = standard_error(differences, block), float(differences.mean())
    freedom = max(count / block - 1.0, 1.0)
    reach = float(student.ppf(1.0 - SIGNIFICANCE / 2.0, freedom))
    if error > 0.0:
        chance = float(2.0 * student.sf(abs(mean) / error, freedom))
    else:
        chance = 1.0 if mean == 0.0 else 0.0
    detectable = (reach + float(student.ppf(POWER, freedom))) * error
    interval = (mean - reach * error, mean + reach * error)
    return PairedDifference(mean, error, interval, chance, detectable, count, missing, block)


def standard_error(series: Values, block: int) -> float:
    """Standard error of the mean of a series (N,) by the moving-block bootstrap, in its closed form.

    The variance of the means of all N - block + 1 runs of neighbours, over the number of blocks in a resample. As the
    mean of all is estimated from the same series, the share of one block is added.
    """
    count = len(series)
    sums = np.concatenate([[0.0], np.cumsum(series - series.mean())])
    means = (sums[block:] - sums[:-block]) / block
    return float(np.sqrt(np.mean(means**2) * block / count * count / max(count - block, 1)))


def block_length(series: Values) -> int:
    """The length of blocks for the standard error of the mean of a series (N,), up to N / 3; 1 for fewer than eight."""
    count = len(series)
    if count < _FEWEST:
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
