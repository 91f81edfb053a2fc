"""Blocks of neighbours: how to draw from frames of which each resembles the next.

Sources: the moving-block bootstrap of Kuensch, Annals of Statistics 17(3), 1989, doi:10.1214/aos/1176347265; the length
of its blocks after Politis and White, Econometric Reviews 23(1), 2004, doi:10.1081/ETR-120028836, with the correction
of Patton, Politis and White, Econometric Reviews 28(4), 2009, doi:10.1080/07474930802459016. Deviation: blocks are
LENGTHENING times as long and never shorter than the cube root of the number of values, because errors that are too
small, as they are for a few hundred frames, would find differences where there are none.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from codecbench.core.results.evidence import FEWEST_FRAMES

Values = NDArray[np.float64]

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
