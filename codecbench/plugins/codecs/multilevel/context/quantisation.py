"""Quantisation with a dead zone, and reconstruction at the centroids of what was quantised; all of it on integers."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from codecbench.core.counting.kernel import kernel
from codecbench.plugins.codecs.dct.tables import Table
from codecbench.plugins.codecs.multilevel.context.transform import FRACTION_BITS, MAX_COEFFICIENT

STEP_BITS = 12
"""Fractional bits of a step."""
_MIN_STEP, _MAX_STEP = 1 << 8, 1 << 32

_NORMS = (3415, 3547, 4096, 4033, 4096, 4067, 4096, 4076)
"""How much a lapped basis function adds to the error of samples, by frequency down and across, in 1/4096."""

BIAS_ZONES, BIAS_SIZES = 3, 3
ZONES = np.array([0 if v + u < 2 else (1 if v + u < 5 else 2) for v in range(8) for u in range(8)], np.int32)
"""Three zones of frequency, in natural order."""
BIAS_BITS = 7
MIN_BIAS, MAX_BIAS = -38, 62
"""How much nearer to zero than its index a coefficient is reconstructed, in 1/128."""

USUAL_BIAS = 8

_RATIO_BITS = 8
RATIO_SHIFT = STEP_BITS - FRACTION_BITS + _RATIO_BITS
_NO_COEFFICIENT = (1 << 31) - 1
_ROUNDING = 92
"""0.36, so that what is below 0.64 of a step becomes zero, in 1/256."""
_DC_ROUNDING = 128


def steps_from_table(table: Table, factor: float, lapped: bool) -> NDArray[np.int64]:
    """Quantisation steps (64,), natural order, in 1/2^12: table * factor, over the norms of a lapped transform."""
    product = np.floor(table.reshape(64).astype(np.float64) * float(factor) * (1 << STEP_BITS) + 0.5)
    steps = np.clip(product, 1, _MAX_STEP).astype(np.int64)
    if lapped:
        norms = np.array(_NORMS, np.int64)
        steps = (steps << 24) // np.outer(norms, norms).reshape(64)
    return np.clip(steps, _MIN_STEP, _MAX_STEP)


@kernel(_nrt=False)
def ratio(magnitude: Any, step: Any) -> Any:
    """A coefficient's magnitude, 4 fractional bits, in steps, 12 fractional bits; in 1/256, rounded down."""
    return (np.int64(magnitude) << RATIO_SHIFT) // step


@kernel
def quantise(coefficients: Any, steps: Any, indices: Any) -> None:
    """Index of every coefficient, with a dead zone but for DC.

    coefficients, indices: (blocks, 64) int32. steps: (64,) int64.
    """
    # Below its bound an index is zero, which is far the most frequent: a division takes much longer.
    bounds = np.empty(64, np.int32)
    for place in range(64):
        rounding = _ROUNDING if place else _DC_ROUNDING
        bounds[place] = min(((256 - rounding) * steps[place]) >> RATIO_SHIFT, _NO_COEFFICIENT)
    for block in range(coefficients.shape[0]):
        for place in range(64):
            indices[block, place] = 0
        for place in range(64):
            coefficient = coefficients[block, place]
            if abs(coefficient) >= bounds[place]:
                rounding = _ROUNDING if place else _DC_ROUNDING
                index = (ratio(abs(coefficient), steps[place]) + rounding) >> _RATIO_BITS
                indices[block, place] = -index if coefficient < 0 else index


@kernel(_nrt=False)
def sum_excesses(coefficients: Any, steps: Any, indices: Any, sums: Any) -> None:
    """By zone and size of index, add up by how much indices exceed coefficients.

    sums: (3, 3, 2) int64, the sum in 1/256 and the count of each.
    """
    for block in range(coefficients.shape[0]):
        for place in range(1, 64):
            index = abs(indices[block, place])
            if index:
                zone = ZONES[place]
                size = min(index, BIAS_SIZES) - 1
                sums[zone, size, 0] += (index << _RATIO_BITS) - ratio(abs(coefficients[block, place]), steps[place])
                sums[zone, size, 1] += 1


def biases_from_sums(sums: NDArray[np.int64]) -> NDArray[np.int32]:
    """The biases (3, 3), in 1/128, of what `sum_excesses` added up."""
    total, count = sums[:, :, 0], np.maximum(sums[:, :, 1], 1)
    return np.asarray(np.clip((total + count) // (2 * count), MIN_BIAS, MAX_BIAS), np.int32)


@kernel(_nrt=False)
def dequantise(indices: Any, steps: Any, biases: Any, coefficients: Any) -> None:
    """Coefficients, 4 fractional bits, of indices: the index less its bias, toward zero, times the step."""
    shift = STEP_BITS - FRACTION_BITS + BIAS_BITS
    for block in range(coefficients.shape[0]):
        for place in range(64):
            index = np.int64(indices[block, place])
            if index == 0:
                coefficients[block, place] = 0
                continue
            magnitude = abs(index)
            size = magnitude if magnitude < BIAS_SIZES else BIAS_SIZES
            bias = biases[ZONES[place], size - 1] if place else 0
            value = (((magnitude << BIAS_BITS) - bias) * steps[place] + (1 << (shift - 1))) >> shift
            value = min(value, MAX_COEFFICIENT)
            coefficients[block, place] = -value if index < 0 else value
