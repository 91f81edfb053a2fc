"""Indices chosen by what they cost: rate-distortion optimised quantisation, on integers as all of the profile.

The costs are those of a simpler model than the coder's: each index in one of eight contexts of the magnitudes around,
with the frequencies that a first quantisation has. Bits are in 1/256, squared errors in 1/2^16 of a squared step.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from codecbench.core.counting.kernel import kernel
from codecbench.plugins.codecs.dct.tables import ZIGZAG
from codecbench.plugins.codecs.multilevel.context.quantisation import RATIO_SHIFT, ratio

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
