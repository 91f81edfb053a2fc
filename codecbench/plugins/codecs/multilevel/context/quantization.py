"""Quantization on integers: a dead zone, reconstruction at centroids, and rate-distortion optimization.

The optimization's costs come from a simpler model than the coder's: each index in one of eight contexts of the
magnitudes around, with the frequencies of a first quantization. Bits are in 1/256, squared errors in
1/2^16 of a squared step.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from codecbench.core.counting.kernel import kernel
from codecbench.plugins.codecs.dct.tables import ZIGZAG, Table
from codecbench.plugins.codecs.multilevel.context.transform import FRACTION_BITS, MAX_COEFFICIENT

STEP_BITS = 12
"""Number of fractional bits of a step."""
_MIN_STEP, _MAX_STEP = 1 << 8, 1 << 32

_NORMS = (3415, 3547, 4096, 4033, 4096, 4067, 4096, 4076)
"""Norm of a lapped basis function in sample errors, by frequency down and across, in 1/4096."""

BIAS_ZONES, BIAS_SIZES = 3, 3
ZONES = np.array([0 if v + u < 2 else (1 if v + u < 5 else 2) for v in range(8) for u in range(8)], np.int32)
"""Three zones of frequency, in natural order."""
BIAS_BITS = 7
MIN_BIAS, MAX_BIAS = -38, 62
"""Limits of the bias toward zero of reconstructed coefficients, in 1/128."""

USUAL_BIAS = 8

_RATIO_BITS = 8
RATIO_SHIFT = STEP_BITS - FRACTION_BITS + _RATIO_BITS
_NO_COEFFICIENT = (1 << 31) - 1
_ROUNDING = 92
"""0.36 in 1/256, so that coefficients below 0.64 of a step become zero."""
_DC_ROUNDING = 128

PRICE = 38
"""Price of a bit in squared steps, in 1/256."""
_BIAS = 8
_CONTEXTS = 8
_SIGN_COST = 256
_LARGEST_COUNTED = 6
_DISTRIBUTIONS = 64 + 2
"""Binary decisions: zero or not at each place; one or more; from two on, more or not."""


def steps_from_table(table: Table, factor: float, lapped: bool) -> NDArray[np.int64]:
    """Return the steps (64,), natural order, in 1/2^12: table * factor, over the norms of a lapped transform."""
    product = np.floor(table.reshape(64).astype(np.float64) * float(factor) * (1 << STEP_BITS) + 0.5)
    steps = np.clip(product, 1, _MAX_STEP).astype(np.int64)
    if lapped:
        norms = np.array(_NORMS, np.int64)
        steps = (steps << 24) // np.outer(norms, norms).reshape(64)
    return np.clip(steps, _MIN_STEP, _MAX_STEP)


@kernel(_nrt=False)
def ratio(magnitude: Any, step: Any) -> Any:
    """Divide a magnitude, 4 fractional bits, by a step, 12 fractional bits; in 1/256, rounded down."""
    return (np.int64(magnitude) << RATIO_SHIFT) // step


@kernel
def quantise(coefficients: Any, steps: Any, indices: Any) -> None:
    """Quantize every coefficient, with a dead zone except for DC.

    coefficients, indices: (blocks, 64) int32. steps: (64,) int64.
    """
    # Most coefficients are below their bound, so most divisions are saved.
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
    """Sum the excess of indices over coefficients by zone and size of index.

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
    """Return the biases (3, 3), in 1/128, of the sums of `sum_excesses`."""
    total, count = sums[:, :, 0], np.maximum(sums[:, :, 1], 1)
    return np.asarray(np.clip((total + count) // (2 * count), MIN_BIAS, MAX_BIAS), np.int32)


@kernel(_nrt=False)
def dequantise(indices: Any, steps: Any, biases: Any, coefficients: Any) -> None:
    """Reconstruct coefficients, 4 fractional bits: the index minus its bias, toward zero, times the step."""
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


def _logarithms() -> NDArray[np.int64]:
    """Return log2(1 + i / 256) in 1/256, by squaring integers."""
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
    """Return log2 of a number above 0, in 1/256, of the number rounded down to 8 bits."""
    exponent = 0
    while number >> exponent > 1:
        exponent += 1
    mantissa = number >> (exponent - 8) if exponent > 8 else number << (8 - exponent)
    return 256 * exponent + _LOGARITHMS[mantissa - 256]


@kernel(_nrt=False)
def _context(indices: Any, block: Any, columns: Any, place: Any) -> Any:
    """Return one of eight contexts, by the magnitudes at this place in blocks around and before it in the block."""
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
    """Estimate the costs of both outcomes of each decision and context: costs (66, 8, 2) int64, filled.

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
            # Regularized with eight indices of the mean of all places, because some places see very few.
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
    """Return the bits of a nonzero index."""
    bits = costs[place, context, 1] + _SIGN_COST
    if magnitude == 1:
        return bits + costs[64, context, 0]
    return bits + costs[64, context, 1] + (magnitude - 2) * costs[65, context, 1] + costs[65, context, 0]


@kernel(_nrt=False)
def _error_of(size: Any, magnitude: Any) -> Any:
    """Return the squared error of a coefficient of `size` / 256 steps with the index `magnitude`."""
    error = size - (magnitude << 8) + (_BIAS if magnitude else 0)
    return error * error


@kernel(_nrt=False)
def optimise(coefficients: Any, steps: Any, columns: Any, costs: Any, indices: Any) -> None:
    """Choose the index of every coefficient except DC: the nearest, the one below, or zero; and the end of each block.

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
        _truncate_block(coefficients, steps, columns, costs, indices, block)


@kernel(_nrt=False)
def _truncate_block(coefficients: Any, steps: Any, columns: Any, costs: Any, indices: Any, block: Any) -> None:
    """Set the indices after the best end of a block to zero, which together may cost more than they gain."""
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
