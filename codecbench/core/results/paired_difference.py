"""Two settings on the same frames: by how much they differ, and what difference so many frames could show."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from codecbench.core.results.evidence import FEWEST_FRAMES, evidence_of_frames, student_quantile

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
