"""Coding of a level's table in a hurry: tuples and counts as Rice codes, which take about a third more bytes.

Under ascending keys tuples are sorted by their last digit, then by the one before it, and so on. So a digit after equal
ones is as large as the one above it, or larger; after one that differs it has no such bound, and is told by how far it
is from the digit of a zero coefficient.

A number n is coded as n >> k ones, a zero, and its k lower bits; k follows the mean of the last numbers of its kind, as
in LOCO-I (Weinberger, Seroussi and Sapiro, 2000). Instead of 24 ones or more, 24 ones and all bits of the number.
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
"""Of the largest number, a count."""
_LONGEST = _MOST_ONES + _NUMBER_BITS
_ROOM = 8
"""Bytes that no single number can exceed."""
_FIRST_SUM = 8
_MEMORY = 32
"""A mean is taken over the last 16 to 32 numbers."""


@kernel
def encode_ordered_tuples(tuples: Any, counts: Any, usual: Any, out: Any) -> Any:
    """Code a table by its tuples.

    tuples: (U, g) int32, ascending, the last digit the most significant. counts: (U,) int64, or (0,) where a level
    above follows. usual: the digit of a zero coefficient. Returns the length of the output, or -1 where `out` is too
    short.
    """
    size, group = tuples.shape
    sums, seen = _new_means(group)
    previous = _before_the_first(group)
    before = np.int64(0)
    buffer = np.int64(0)
    held = 0
    position = 0
    for row in range(size):
        if position + (group + 2) * _ROOM > out.shape[0]:
            return -1
        changed = 0
        for j in range(group - 1, -1, -1):
            digit = np.int64(tuples[row, j])
            kind = 2 * j + changed
            if changed == 1:
                number = _folded(digit - usual)
            else:
                number = digit - _least(previous, j)
                if digit != previous[j]:
                    changed = 1
            previous[j] = digit
            buffer, held, position = _put(buffer, held, position, out, sums, seen, kind, number)
        if counts.shape[0] > 0:
            kind = 2 * group + magnitude(before, COUNT_KINDS)
            before = counts[row] - 1
            buffer, held, position = _put(buffer, held, position, out, sums, seen, kind, before)
    if held > 0:
        out[position] = np.uint8(buffer << (8 - held))
        position += 1
    return position


@kernel
def decode_ordered_tuples(data: Any, radix: Any, total: Any, usual: Any, tuples: Any, counts: Any) -> Any:
    """Decode what `encode_ordered_tuples` wrote into tuples (U, g) int32 and counts (U,) or (0,) int64.

    Returns bytes read, with UNWRITTEN more as the other tables have them, or OVERRUN, OUT_OF_RANGE (a digit not in
    0..radix-1, or bits that no encoder writes) or BAD_COUNTS (counts that do not sum to `total`). Tuples ascend by
    construction.
    """
    size, group = tuples.shape
    sums, seen = _new_means(group)
    previous = _before_the_first(group)
    before = np.int64(0)
    left = total
    buffer = np.int64(0)
    held = 0
    position = 0
    for row in range(size):
        if position > data.shape[0] + _ROOM:
            return OVERRUN
        changed = 0
        for j in range(group - 1, -1, -1):
            kind = 2 * j + changed
            number, buffer, held, position = _take(buffer, held, position, data, sums, seen, kind)
            if number < 0:
                return OUT_OF_RANGE
            if changed == 1:
                digit = usual + _unfolded(number)
            else:
                digit = number + _least(previous, j)
                if digit != previous[j]:
                    changed = 1
            if digit < 0 or digit >= radix:
                return OUT_OF_RANGE
            previous[j] = digit
            tuples[row, j] = digit
        if counts.shape[0] > 0:
            kind = 2 * group + magnitude(before, COUNT_KINDS)
            before, buffer, held, position = _take(buffer, held, position, data, sums, seen, kind)
            if before < 0 or before >= left:
                return BAD_COUNTS
            counts[row] = before + 1
            left -= before + 1
    if counts.shape[0] > 0 and left != 0:
        return BAD_COUNTS
    if buffer >> (held & ~7):  # what fills up the last byte
        return OUT_OF_RANGE
    return position - (held >> 3) + UNWRITTEN


@kernel
def _new_means(group: Any) -> Any:
    """Sum and number of the last numbers of every kind: of digits, after equal ones or not, and of counts."""
    kinds = 2 * group + COUNT_KINDS
    sums = np.full(kinds, _FIRST_SUM, np.int64)
    seen = np.ones(kinds, np.int64)
    return sums, seen


@kernel
def _before_the_first(group: Any) -> Any:
    """The tuple below all others."""
    previous = np.zeros(group, np.int64)
    previous[0] = -1
    return previous


@kernel
def _least(previous: Any, place: Any) -> Any:
    """The smallest digit after equal ones: no tuple equals the one before it."""
    return previous[place] + (1 if place == 0 else 0)


@kernel
def _folded(difference: Any) -> Any:
    """0, 1, -1, 2, -2 ... as 0, 1, 2, 3, 4 ..."""
    return 2 * difference - 1 if difference > 0 else -2 * difference


@kernel
def _unfolded(number: Any) -> Any:
    return (number + 1) >> 1 if number & 1 else -(number >> 1)


@kernel(_nrt=False)
def _parameter(sums: Any, seen: Any, kind: Any) -> Any:
    """k, so that 2^k is about the mean of a kind."""
    k = 0
    while (seen[kind] << k) < sums[kind]:
        k += 1
    return k


@kernel(_nrt=False)
def _remember(sums: Any, seen: Any, kind: Any, number: Any) -> None:
    sums[kind] += number
    seen[kind] += 1
    if seen[kind] == _MEMORY:
        sums[kind] >>= 1
        seen[kind] >>= 1


# In line, as the numbers of `tables` are, and for the same reason.
@kernel(_nrt=False, forceinline=True)
def _put(buffer: Any, held: Any, position: Any, out: Any, sums: Any, seen: Any, kind: Any, number: Any) -> Any:
    """Code one number; returns the new buffer, the bits that it holds (at most 7), and the position."""
    k = _parameter(sums, seen, kind)
    _remember(sums, seen, kind, number)
    ones = number >> k
    if ones < _MOST_ONES:
        code = (((1 << ones) - 1) << (k + 1)) | (number & ((1 << k) - 1))
        length = ones + 1 + k
    else:
        code = (((1 << _MOST_ONES) - 1) << _NUMBER_BITS) | number
        length = _LONGEST
    buffer = (buffer << length) | code
    held += length
    while held >= 8:
        held -= 8
        out[position] = np.uint8((buffer >> held) & 255)
        position += 1
    return buffer & ((1 << held) - 1), held, position


@kernel(_nrt=False, forceinline=True)
def _take(buffer: Any, held: Any, position: Any, data: Any, sums: Any, seen: Any, kind: Any) -> Any:
    """The next number, or -1 for a code that no encoder writes; and the new buffer, bits in it, and position."""
    while held < _LONGEST:
        buffer = (buffer << 8) | next_byte(data, position)
        held += 8
        position += 1
    k = _parameter(sums, seen, kind)
    ones = 0
    while ones < _MOST_ONES and (buffer >> (held - 1 - ones)) & 1:
        ones += 1
    if ones < _MOST_ONES:
        held -= ones + 1 + k
        number = (ones << k) | ((buffer >> held) & ((1 << k) - 1))
    else:
        held -= _LONGEST
        number = (buffer >> held) & ((1 << _NUMBER_BITS) - 1)
        if (number >> k) < _MOST_ONES:
            number = np.int64(-1)
    _remember(sums, seen, kind, max(number, 0))
    return number, buffer & ((1 << held) - 1), held, position
