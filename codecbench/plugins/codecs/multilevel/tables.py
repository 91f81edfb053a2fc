"""Coding of a level's table: the tuples (header mode) or the codes (search mode), and the counts.

Numbers are coded like Elias' gamma code: n + 1 has `length` bits after its leading one. `length` is coded in unary and
the bit after the leading one with adaptive probabilities; the other bits are coded as they are.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from codecbench.core.counting.kernel import kernel
from codecbench.plugins.codecs.multilevel.arithmetic import (
    LOOK_AHEAD,
    TOP,
    UNWRITTEN,
    decode_bit,
    decode_interval,
    encode_bit,
    encode_interval,
    finish_encoder,
    first_code,
    quotient_of,
)

_NUMBER = 128
"""Number of contexts per kind of number: 64 for its length, 64 for the bit after the leading one."""

COUNT_KINDS = 4
_GAP_KINDS = 4
_LONGEST = 62
_ROOM = 192
"""Upper bound of a number's size in bytes."""

_EVEN_CHANCE = 32768

OVERRUN = -1
OUT_OF_RANGE = -2
BAD_COUNTS = -3
REPEATED = -4


# Inline, because a call would pass the fields of two arrays, some twenty values, with every number.
@kernel(_nrt=False, forceinline=True)
def _encode_number(low: Any, width: Any, position: Any, out: Any, models: Any, kind: Any, number: Any) -> Any:
    """Code one number; returns the new low, width and position."""
    context = kind * _NUMBER
    shifted = number + 1
    length = 0
    while (shifted >> length) > 1:
        low, width, position = encode_bit(low, width, position, out, models, context + length, 1)
        length += 1
    low, width, position = encode_bit(low, width, position, out, models, context + length, 0)
    if length > 0:
        bit = (shifted >> (length - 1)) & 1
        low, width, position = encode_bit(low, width, position, out, models, context + 64 + length, bit)
    bits = length - 1
    while bits > 0:
        part = min(bits, 16)
        bits -= part
        digit = (shifted >> bits) & ((1 << part) - 1)
        low, width, position = encode_interval(low, width, position, out, digit, 1, width >> part)
    return low, width, position


@kernel(_nrt=False, forceinline=True)
def _decode_number(code: Any, width: Any, position: Any, data: Any, models: Any, kind: Any) -> Any:
    """Decode a number, or -1 if it has more than 62 bits; returns the new code, width and position too."""
    context = kind * _NUMBER
    bit, code, width, position = decode_bit(code, width, position, data, models, context)
    length = 0
    while bit == 1 and length < _LONGEST:
        length += 1
        bit, code, width, position = decode_bit(code, width, position, data, models, context + length)
    if bit == 1:
        return np.int64(-1), code, width, position
    number = np.int64(1)
    if length > 0:
        bit, code, width, position = decode_bit(code, width, position, data, models, context + 64 + length)
        number = np.int64(2 + bit)
    bits = length - 1
    while bits > 0:
        part = min(bits, 16)
        bits -= part
        unit = width >> part
        # A damaged stream may point beyond the last interval, into a sliver that no encoder uses.
        digit = min(quotient_of(code, unit), (1 << part) - 1)
        code, width, position = decode_interval(code, position, data, digit, 1, unit)
        number = (number << part) | digit
    return number - 1, code, width, position


@kernel
def magnitude(number: Any, kinds: Any) -> Any:
    """Classify a number by size: 0 for 0, then one more for every two bits, below `kinds`."""
    kind = 0
    while number > 0 and kind < kinds - 1:
        number >>= 2
        kind += 1
    return kind


@kernel
def encode_tuples(tuples: Any, counts: Any, out: Any) -> Any:
    """Code a table by its tuples, each digit as the difference from the row above.

    tuples: (U, g) int32, distinct rows in order of their codes; the last digit is the most significant under
    ascending keys, so it comes first. counts: (U,) int64, or (0,) if a level above follows. Returns the length
    of the output, or -1 if `out` is too short.
    """
    size, group = tuples.shape
    models = np.full((_tuple_contexts(group), 2), _EVEN_CHANCE, np.int32)
    low = np.int64(0)
    width = np.int64(TOP - 1)
    position = 0
    previous = np.zeros(group, np.int64)
    before = np.int64(0)
    for row in range(size):
        if position + (group + 2) * _ROOM > out.shape[0]:
            return -1
        changed = 0
        for j in range(group - 1, -1, -1):
            step = tuples[row, j] - previous[j]
            previous[j] = tuples[row, j]
            kind = 2 * j + changed
            low, width, position = _encode_number(low, width, position, out, models, kind, abs(step))
            if step != 0:
                sign = 1 if step < 0 else 0
                context = _sign_context(group, kind)
                low, width, position = encode_bit(low, width, position, out, models, context, sign)
                changed = 1
        if counts.shape[0] > 0:
            kind = 2 * group + magnitude(before, COUNT_KINDS)
            low, width, position = _encode_number(low, width, position, out, models, kind, counts[row] - 1)
            before = counts[row] - 1
    return finish_encoder(low, position, out)


@kernel
def _tuple_contexts(group: Any) -> Any:
    return (2 * group + COUNT_KINDS) * _NUMBER + 2 * group


@kernel
def _sign_context(group: Any, kind: Any) -> Any:
    return (2 * group + COUNT_KINDS) * _NUMBER + kind


@kernel
def decode_tuples(data: Any, radix: Any, total: Any, tuples: Any, counts: Any) -> Any:
    """Decode what `encode_tuples` wrote into tuples (U, g) int32 and counts (U,) or (0,) int64.

    Returns bytes read, or OVERRUN, OUT_OF_RANGE (a digit not in 0..radix-1), REPEATED (a row equal to the one
    above) or BAD_COUNTS (counts that do not sum to `total`).
    """
    size, group = tuples.shape
    models = np.full((_tuple_contexts(group), 2), _EVEN_CHANCE, np.int32)
    code = first_code(data)
    width = np.int64(TOP - 1)
    position = LOOK_AHEAD
    previous = np.zeros(group, np.int64)
    before = np.int64(0)
    left = total
    for row in range(size):
        if position > data.shape[0] + UNWRITTEN:
            return OVERRUN
        changed = 0
        for j in range(group - 1, -1, -1):
            kind = 2 * j + changed
            step, code, width, position = _decode_number(code, width, position, data, models, kind)
            if step < 0 or step >= radix:
                return OUT_OF_RANGE
            if step != 0:
                context = _sign_context(group, kind)
                sign, code, width, position = decode_bit(code, width, position, data, models, context)
                if sign == 1:
                    step = -step
                changed = 1
            digit = previous[j] + step
            if digit < 0 or digit >= radix:
                return OUT_OF_RANGE
            previous[j] = digit
            tuples[row, j] = digit
        if row > 0 and changed == 0:
            return REPEATED
        if counts.shape[0] > 0:
            kind = 2 * group + magnitude(before, COUNT_KINDS)
            before, code, width, position = _decode_number(code, width, position, data, models, kind)
            if before < 0 or before >= left:
                return BAD_COUNTS
            counts[row] = before + 1
            left -= before + 1
    if counts.shape[0] > 0 and left != 0:
        return BAD_COUNTS
    return position


@kernel
def encode_codes(codes: Any, counts: Any, out: Any) -> Any:
    """Code a table by its codes (U,) int64, increasing, each as the gap to the one before.

    counts and the return value are as for `encode_tuples`.
    """
    models = np.full(((_GAP_KINDS + COUNT_KINDS) * _NUMBER, 2), _EVEN_CHANCE, np.int32)
    low = np.int64(0)
    width = np.int64(TOP - 1)
    position = 0
    previous = np.int64(-1)
    gap = np.int64(0)
    before = np.int64(0)
    for row in range(codes.shape[0]):
        if position + 3 * _ROOM > out.shape[0]:
            return -1
        kind = magnitude(gap, _GAP_KINDS)
        gap = codes[row] - previous - 1
        previous = codes[row]
        low, width, position = _encode_number(low, width, position, out, models, kind, gap)
        if counts.shape[0] > 0:
            kind = _GAP_KINDS + magnitude(before, COUNT_KINDS)
            low, width, position = _encode_number(low, width, position, out, models, kind, counts[row] - 1)
            before = counts[row] - 1
    return finish_encoder(low, position, out)


@kernel
def decode_codes(data: Any, largest: Any, total: Any, codes: Any, counts: Any) -> Any:
    """Decode what `encode_codes` wrote. Returns as `decode_tuples`; OUT_OF_RANGE means a code above `largest`.

    Codes increase by construction: a gap is never negative.
    """
    models = np.full(((_GAP_KINDS + COUNT_KINDS) * _NUMBER, 2), _EVEN_CHANCE, np.int32)
    code = first_code(data)
    width = np.int64(TOP - 1)
    position = LOOK_AHEAD
    previous = np.int64(-1)
    gap = np.int64(0)
    before = np.int64(0)
    left = total
    for row in range(codes.shape[0]):
        if position > data.shape[0] + UNWRITTEN:
            return OVERRUN
        kind = magnitude(gap, _GAP_KINDS)
        gap, code, width, position = _decode_number(code, width, position, data, models, kind)
        if gap < 0 or gap > largest - previous - 1:
            return OUT_OF_RANGE
        previous += gap + 1
        codes[row] = previous
        if counts.shape[0] > 0:
            kind = _GAP_KINDS + magnitude(before, COUNT_KINDS)
            before, code, width, position = _decode_number(code, width, position, data, models, kind)
            if before < 0 or before >= left:
                return BAD_COUNTS
            counts[row] = before + 1
            left -= before + 1
    if counts.shape[0] > 0 and left != 0:
        return BAD_COUNTS
    return position
