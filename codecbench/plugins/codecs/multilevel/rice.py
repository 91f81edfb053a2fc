"""Fast coding of a level's table: tuples and counts as Rice codes, which take about a third more bytes.

Under ascending keys tuples are sorted by their last digit, then by the one before it, and so on. So if all later digits
equal those of the row above, a digit is at least the one above it. Otherwise it has no such bound, and its difference
from the digit of a zero coefficient is coded.

A number n is coded as n >> k ones, a zero, and its k lower bits; k follows the mean of the last numbers of its kind, as
in LOCO-I (Weinberger, Seroussi and Sapiro, 2000). Numbers of 24 ones or more are coded as 24 ones and all their bits.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from codecbench.core.counting.kernel import kernel
from codecbench.plugins.codecs.multilevel.arithmetic import UNWRITTEN, next_byte
from codecbench.plugins.codecs.multilevel.tables import (
    BAD_COUNTS,
    COUNT_KINDS,
    OUT_OF_RANGE,
    OVERRUN,
    magnitude,
)

_MOST_ONES = 24
_NUMBER_BITS = 26
"""Size of the largest number, a count."""
_LONGEST = _MOST_ONES + _NUMBER_BITS
_ROOM = 8
"""Upper bound of a number's size in bytes."""
_FIRST_SUM = 8
_MEMORY = 32
"""Means are over the last 16 to 32 numbers."""


@kernel
def encode_ordered_tuples(tuples: Any, counts: Any, usual: Any, out: Any) -> Any:
    """Code a table by its tuples.

    tuples: (U, g) int32, ascending, the last digit the most significant. counts: (U,) int64, or (0,) if a level
    above follows. usual: the digit of a zero coefficient. Returns the length of the output, or -1 if `out` is short.
    """
    size, group = tuples.shape
    sums, seen = _new_means(group)
    previous = _lowest_tuple(group)
    before = np.int64(0)
    buffer = np.int64(0)
    bits = 0
    position = 0
    for row in range(size):
        if position + (group + 2) * _ROOM > out.shape[0]:
            return -1
        changed = 0
        for j in range(group - 1, -1, -1):
            digit = np.int64(tuples[row, j])
            kind = 2 * j + changed
            if changed == 1:
                number = _fold(digit - usual)
            else:
                number = digit - _smallest_digit(previous, j)
                if digit != previous[j]:
                    changed = 1
            previous[j] = digit
            buffer, bits, position = _encode_number(buffer, bits, position, out, sums, seen, kind, number)
        if counts.shape[0] > 0:
            kind = 2 * group + magnitude(before, COUNT_KINDS)
            before = counts[row] - 1
            buffer, bits, position = _encode_number(buffer, bits, position, out, sums, seen, kind, before)
    if bits > 0:
        out[position] = np.uint8(buffer << (8 - bits))
        position += 1
    return position


@kernel
def decode_ordered_tuples(data: Any, radix: Any, total: Any, usual: Any, tuples: Any, counts: Any) -> Any:
    """Decode what `encode_ordered_tuples` wrote into tuples (U, g) int32 and counts (U,) or (0,) int64.

    Returns bytes read plus UNWRITTEN, as for the other tables, or OVERRUN, OUT_OF_RANGE (a digit not in
    0..radix-1, or bits that no encoder writes) or BAD_COUNTS (counts that do not sum to `total`). Tuples ascend by
    construction.
    """
    size, group = tuples.shape
    sums, seen = _new_means(group)
    previous = _lowest_tuple(group)
    before = np.int64(0)
    left = total
    buffer = np.int64(0)
    bits = 0
    position = 0
    for row in range(size):
        if position > data.shape[0] + _ROOM:
            return OVERRUN
        changed = 0
        for j in range(group - 1, -1, -1):
            kind = 2 * j + changed
            number, buffer, bits, position = _decode_number(buffer, bits, position, data, sums, seen, kind)
            if number < 0:
                return OUT_OF_RANGE
            if changed == 1:
                digit = usual + _unfold(number)
            else:
                digit = number + _smallest_digit(previous, j)
                if digit != previous[j]:
                    changed = 1
            if digit < 0 or digit >= radix:
                return OUT_OF_RANGE
            previous[j] = digit
            tuples[row, j] = digit
        if counts.shape[0] > 0:
            kind = 2 * group + magnitude(before, COUNT_KINDS)
            before, buffer, bits, position = _decode_number(buffer, bits, position, data, sums, seen, kind)
            if before < 0 or before >= left:
                return BAD_COUNTS
            counts[row] = before + 1
            left -= before + 1
    if counts.shape[0] > 0 and left != 0:
        return BAD_COUNTS
    if buffer >> (bits & ~7):  # the padding of the last byte
        return OUT_OF_RANGE
    return position - (bits >> 3) + UNWRITTEN


@kernel
def _new_means(group: Any) -> Any:
    """Return initial sums and counts of numbers by kind: digits, after equal ones or not, and counts."""
    kinds = 2 * group + COUNT_KINDS
    sums = np.full(kinds, _FIRST_SUM, np.int64)
    seen = np.ones(kinds, np.int64)
    return sums, seen


@kernel
def _lowest_tuple(group: Any) -> Any:
    """Return a tuple below all others."""
    previous = np.zeros(group, np.int64)
    previous[0] = -1
    return previous


@kernel
def _smallest_digit(previous: Any, place: Any) -> Any:
    """Return the smallest digit after equal ones: no tuple equals the one before it."""
    return previous[place] + (1 if place == 0 else 0)


@kernel
def _fold(difference: Any) -> Any:
    """Map 0, 1, -1, 2, -2 ... to 0, 1, 2, 3, 4 ..."""
    return 2 * difference - 1 if difference > 0 else -2 * difference


@kernel
def _unfold(number: Any) -> Any:
    return (number + 1) >> 1 if number & 1 else -(number >> 1)


@kernel(_nrt=False)
def _parameter(sums: Any, seen: Any, kind: Any) -> Any:
    """Return k so that 2^k is about the mean of a kind."""
    k = 0
    while (seen[kind] << k) < sums[kind]:
        k += 1
    return k


@kernel(_nrt=False)
def _update_mean(sums: Any, seen: Any, kind: Any, number: Any) -> None:
    sums[kind] += number
    seen[kind] += 1
    if seen[kind] == _MEMORY:
        sums[kind] >>= 1
        seen[kind] >>= 1


# Inline for the same reason as in `tables`.
@kernel(_nrt=False, forceinline=True)
def _encode_number(
    buffer: Any, bits: Any, position: Any, out: Any, sums: Any, seen: Any, kind: Any, number: Any
) -> Any:
    """Code one number; returns the new buffer, its number of bits (at most 7), and the position."""
    k = _parameter(sums, seen, kind)
    _update_mean(sums, seen, kind, number)
    ones = number >> k
    if ones < _MOST_ONES:
        code = (((1 << ones) - 1) << (k + 1)) | (number & ((1 << k) - 1))
        length = ones + 1 + k
    else:
        code = (((1 << _MOST_ONES) - 1) << _NUMBER_BITS) | number
        length = _LONGEST
    buffer = (buffer << length) | code
    bits += length
    while bits >= 8:
        bits -= 8
        out[position] = np.uint8((buffer >> bits) & 255)
        position += 1
    return buffer & ((1 << bits) - 1), bits, position


@kernel(_nrt=False, forceinline=True)
def _decode_number(buffer: Any, bits: Any, position: Any, data: Any, sums: Any, seen: Any, kind: Any) -> Any:
    """Decode a number, or -1 for a code that no encoder writes; returns the new buffer, its bits, and position too."""
    while bits < _LONGEST:
        buffer = (buffer << 8) | next_byte(data, position)
        bits += 8
        position += 1
    k = _parameter(sums, seen, kind)
    ones = 0
    while ones < _MOST_ONES and (buffer >> (bits - 1 - ones)) & 1:
        ones += 1
    if ones < _MOST_ONES:
        bits -= ones + 1 + k
        number = (ones << k) | ((buffer >> bits) & ((1 << k) - 1))
    else:
        bits -= _LONGEST
        number = (buffer >> bits) & ((1 << _NUMBER_BITS) - 1)
        if (number >> k) < _MOST_ONES:
            number = np.int64(-1)
    _update_mean(sums, seen, kind, max(number, 0))
    return number, buffer & ((1 << bits) - 1), bits, position
