"""Quantisation with a dead zone, and reconstruction at the centroids of what was quantised; all of it on integers."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from codecbench.core.counting.kernel import kernel
from codecbench.plugins.codecs.dct.tables import ZIGZAG, Table
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


PRICE = 38
"""Of a bit in squared steps, in 1/256."""
_BIAS = 8
_CONTEXTS = 8
_SIGN_COST = 256
_LARGEST_COUNTED = 6
_DISTRIBUTIONS = 64 + 2
"""Zero or not at each place; one or more; from two on, whether there is more."""


def _logarithms() -> NDArray[np.int64]:
    """log2(1 + i / 256) in 1/256, by squaring whole numbers."""
    values = []
    for mantissa in range(256, 512):
        number, bits = mantissa << 24, 0
        for _ in range(9):
            number = number * number >> 32
            bits <<= 1
            if number >> 33:
                number >>= 1
                bits |= 1
        values.append((bits + 1) >> 1)
    return np.array(values, np.int64)


_LOGARITHMS = _logarithms()


@kernel(_nrt=False)
def _logarithm(number: Any) -> Any:
    """log2 of a number above 0, in 1/256, rounded down to 8 bits of the number."""
    exponent = 0
    while number >> exponent > 1:
        exponent += 1
    mantissa = number >> (exponent - 8) if exponent > 8 else number << (8 - exponent)
    return 256 * exponent + _LOGARITHMS[mantissa - 256]


@kernel(_nrt=False)
def _context(indices: Any, block: Any, columns: Any, place: Any) -> Any:
    """One of eight, by the magnitudes at this place around and before it in the block."""
    total = 0
    if block % columns > 0:
        total += 2 * abs(indices[block - 1, place])
    if block >= columns:
        total += 2 * abs(indices[block - columns, place])
        if block % columns > 0:
            total += abs(indices[block - columns - 1, place])
        if block % columns < columns - 1:
            total += abs(indices[block - columns + 1, place])
    if place > 8:
        total += 2 * abs(indices[block, place - 8])
    if place & 7 and place != 1:
        total += 2 * abs(indices[block, place - 1])
    if place > 9 and place & 7:
        total += abs(indices[block, place - 9])
    if total < 4:
        return total
    if total < 6:
        return 4
    return 5 if total < 9 else (6 if total < 15 else 7)


@kernel
def estimate_costs(indices: Any, columns: Any, costs: Any) -> None:
    """What it costs to say that an index is zero or not, is one or more, is that or more: (66, 8, 2) int64, filled.

    indices: (n + 1, 64) int32, natural order, the last of no block. columns: blocks in a row.
    """
    counts = np.zeros((_DISTRIBUTIONS + 1, _CONTEXTS, 2), np.int64)
    for block in range(indices.shape[0] - 1):
        for place in range(1, 64):
            context = _context(indices, block, columns, place)
            magnitude = abs(indices[block, place])
            nonzero = 1 if magnitude else 0
            counts[place, context, nonzero] += 1
            counts[_DISTRIBUTIONS, context, nonzero] += 1
            if magnitude:
                counts[64, context, 1 if magnitude > 1 else 0] += 1
                for size in range(2, min(magnitude, _LARGEST_COUNTED) + 1):
                    counts[65, context, 1 if magnitude > size else 0] += 1
    for context in range(_CONTEXTS):
        for place in range(64):
            # Together with eight indices of the mean of all places: some places see very few.
            for bit in range(2):
                seen = counts[_DISTRIBUTIONS, context, bit]
                everything = counts[_DISTRIBUTIONS, context, 0] + counts[_DISTRIBUTIONS, context, 1]
                counts[place, context, bit] = (
                    16 * counts[place, context, bit] + 128 * (2 * seen + 1) // (2 * everything + 2) + 1
                )
        for number in range(64, _DISTRIBUTIONS):
            counts[number, context, 0] = 2 * counts[number, context, 0] + 1
            counts[number, context, 1] = 2 * counts[number, context, 1] + 1
        for number in range(_DISTRIBUTIONS):
            total = _logarithm(counts[number, context, 0] + counts[number, context, 1])
            costs[number, context, 0] = total - _logarithm(counts[number, context, 0])
            costs[number, context, 1] = total - _logarithm(counts[number, context, 1])


@kernel(_nrt=False)
def _cost_of(costs: Any, context: Any, place: Any, magnitude: Any) -> Any:
    """Bits of an index above zero."""
    bits = costs[place, context, 1] + _SIGN_COST
    if magnitude == 1:
        return bits + costs[64, context, 0]
    return bits + costs[64, context, 1] + (magnitude - 2) * costs[65, context, 1] + costs[65, context, 0]


@kernel(_nrt=False)
def _error_of(size: Any, magnitude: Any) -> Any:
    """The squared error of a coefficient of `size` / 256 steps whose index is `magnitude`."""
    error = size - (magnitude << 8) + (_BIAS if magnitude else 0)
    return error * error


@kernel(_nrt=False)
def optimise(coefficients: Any, steps: Any, columns: Any, costs: Any, indices: Any) -> None:
    """Choose the index of every coefficient but DC: the nearest, the one below, or none; and where a block ends.

    coefficients: (n, 64) int32. steps: (64,) int64. costs: as `estimate_costs` gives them. indices:
    (n + 1, 64) int32, changed.
    """
    for block in range(coefficients.shape[0]):
        for rank in range(1, 64):
            place = np.int64(ZIGZAG[rank])
            coefficient = np.int64(coefficients[block, place])
            if abs(coefficient) << RATIO_SHIFT < 128 * steps[place]:
                indices[block, place] = 0
                continue
            size = ratio(abs(coefficient), steps[place])
            nearest = (size + 128) >> 8
            context = _context(indices, block, columns, place)
            best = _error_of(size, 0) + PRICE * costs[place, context, 0]
            chosen = 0
            for magnitude in range(max(1, nearest - 1), nearest + 1):
                total = _error_of(size, magnitude) + PRICE * _cost_of(costs, context, place, magnitude)
                if total < best:
                    best = total
                    chosen = magnitude
            indices[block, place] = -chosen if coefficient < 0 else chosen
        _cut(coefficients, steps, columns, costs, indices, block)


@kernel(_nrt=False)
def _cut(coefficients: Any, steps: Any, columns: Any, costs: Any, indices: Any, block: Any) -> None:
    """Set what follows the best end of a block to zero: all of it together may cost more than it is worth."""
    gained = np.int64(0)
    lowest = np.int64(0)
    end = 64
    for rank in range(63, 0, -1):
        place = np.int64(ZIGZAG[rank])
        magnitude = abs(indices[block, place])
        if magnitude == 0:
            continue
        size = ratio(abs(coefficients[block, place]), steps[place])
        context = _context(indices, block, columns, place)
        bits = _cost_of(costs, context, place, magnitude) - costs[place, 0, 0]
        gained += _error_of(size, 0) - _error_of(size, magnitude) - PRICE * bits
        if gained < lowest:
            lowest = gained
            end = rank
    for rank in range(end, 64):
        indices[block, ZIGZAG[rank]] = 0
