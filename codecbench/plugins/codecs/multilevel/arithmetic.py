"""A range coder: arithmetic coding by counts, 48 bits wide, with carry propagation.

The encoder's state is three integers: `low` and `width` of the range, and the `position` of the next byte. Those of
the decoder are `code`, the stream's value in the range, `width` and `position`. Symbols are coded by their interval
among the counts, scaled to a power of two so that the range divides by shifting. The tables' values are coded by
adaptive bits.

Source: G. N. N. Martin, "Range encoding: an algorithm for removing redundancy from a digitised message" (1979).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from codecbench.core.counting.kernel import kernel

TOP = 1 << 48
_BOTTOM = 1 << 40
_BELOW_BOTTOM = _BOTTOM - 1
_BELOW_LAST_BYTES = (1 << 32) - 1
LOOK_AHEAD = 6
"""Number of bytes that the decoder reads before the first symbol: 48 bits."""

UNWRITTEN = 4
"""Number of zero bytes that the decoder reads beyond the encoder's last byte."""

_SPARE_BITS = 6
_LOOKUP_BITS = 15
"""Size of the look-up table, 128 kB: a larger one exceeds the cache, a smaller one leaves more symbols to try."""


@kernel(_nrt=False)
def encode_interval(low: Any, width: Any, position: Any, out: Any, start: Any, count: Any, unit: Any) -> Any:
    """Narrow the range to `count` units from `start`; returns the new low, width and position."""
    low += start * unit
    width = count * unit
    if low >= TOP:
        low -= TOP
        _carry(out, position)
    while width < _BOTTOM:
        width <<= 8
        out[position] = np.uint8(low >> 40)
        position += 1
        low = (low & _BELOW_BOTTOM) << 8
    return low, width, position


@kernel(_nrt=False)
def _carry(out: Any, position: Any) -> None:
    """Add one to the number that ends before `position`."""
    position -= 1
    while out[position] == 255:
        out[position] = 0
        position -= 1
    out[position] += 1


@kernel(_nrt=False)
def finish_encoder(low: Any, position: Any, out: Any) -> Any:
    """Write two more bytes, which select a number inside any range; returns the length of the output."""
    low = (low + _BELOW_LAST_BYTES) & ~_BELOW_LAST_BYTES
    if low >= TOP:
        low -= TOP
        _carry(out, position)
    out[position] = np.uint8(low >> 40)
    out[position + 1] = np.uint8((low >> 32) & 255)
    return position + 2


@kernel(_nrt=False)
def next_byte(data: Any, position: Any) -> Any:
    """Return the byte at a position, zero after the end of the data."""
    if position < data.shape[0]:
        return np.int64(data[position])
    return np.int64(0)


@kernel(_nrt=False)
def first_code(data: Any) -> Any:
    """Read LOOK_AHEAD bytes from the beginning of `data` as the decoder's code."""
    code = np.int64(0)
    for position in range(LOOK_AHEAD):
        code = (code << 8) | next_byte(data, position)
    return code


@kernel(_nrt=False)
def decode_interval(code: Any, position: Any, data: Any, start: Any, count: Any, unit: Any) -> Any:
    """Remove the interval of a decoded symbol from the range; returns the new code, width and position."""
    code -= start * unit
    width = count * unit
    while width < _BOTTOM:
        width <<= 8
        code = (code << 8) | next_byte(data, position)
        position += 1
    return code, width, position


@kernel
def quotient_of(code: Any, unit: Any) -> Any:
    """Return floor(code / unit) for 0 <= code, 0 < unit, both below 2^48; rounding adds at most 1."""
    quotient = np.int64(code / unit)
    if quotient * unit > code:
        quotient -= 1
    return quotient


@kernel(_nrt=False)
def encode_bit(low: Any, width: Any, position: Any, out: Any, models: Any, context: Any, bit: Any) -> Any:
    """Code one bit with an adaptive probability; returns the new low, width and position.

    models: (contexts, 2) int32, a fast and a slow estimate of P(bit = 1) in 1/65536, updated.
    """
    split = (width >> 16) * ((models[context, 0] + models[context, 1]) >> 1)
    _adapt(models, context, bit)
    # Selections, not branches: a processor cannot predict the bit.
    start = 0 if bit else split
    size = split if bit else width - split
    return encode_interval(low + start, width, position, out, 0, 1, size)


@kernel(_nrt=False)
def decode_bit(code: Any, width: Any, position: Any, data: Any, models: Any, context: Any) -> Any:
    """Decode the next bit of `encode_bit`; returns it and the new code, width and position."""
    split = (width >> 16) * ((models[context, 0] + models[context, 1]) >> 1)
    bit = 0
    if code < split:
        bit = 1
        width = split
    else:
        code -= split
        width -= split
    _adapt(models, context, bit)
    code, width, position = decode_interval(code, position, data, 0, 1, width)
    return bit, code, width, position


@kernel(_nrt=False)
def _adapt(models: Any, context: Any, bit: Any) -> None:
    """Move both estimates toward the bit, by a 16th and by a 128th; neither ever reaches 0 or 65536."""
    fast = models[context, 0]
    slow = models[context, 1]
    models[context, 0] = fast + ((65535 - fast) >> 4) if bit else fast - (fast >> 4)
    models[context, 1] = slow + ((65535 - slow) >> 7) if bit else slow - (slow >> 7)


@kernel
def distribute_units(counts: Any, starts: Any) -> Any:
    """Distribute 2^bits units among symbols in proportion to their counts; returns `bits`.

    counts: (U,) int64, each at least 1. starts: (U + 1,) int64, filled: the first unit of each symbol. A count of
    one gets 64 to 127 units, so that rounding costs less than 1e-4 of the payload.
    """
    total = np.int64(0)
    for symbol in range(counts.shape[0]):
        total += counts[symbol]
    bits = _SPARE_BITS
    while (1 << (bits - _SPARE_BITS)) < total:
        bits += 1
    scale = (1 << bits) / total
    before = np.int64(0)
    for symbol in range(counts.shape[0]):
        starts[symbol] = np.int64(before * scale)
        before += counts[symbol]
    starts[counts.shape[0]] = 1 << bits
    return bits


@kernel
def encode_symbols(symbols: Any, counts: Any, starts: Any, out: Any) -> Any:
    """Code every symbol in proportion to its count; returns the length of the output.

    symbols: (n,) int32 in 0..U-1. counts: (U,) int64, occurrences of each. starts: (U + 1,) int64, filled.
    out: at least 4 n + 16 bytes.
    """
    bits = distribute_units(counts, starts)
    low = np.int64(0)
    width = np.int64(TOP - 1)
    position = 0
    for i in range(symbols.shape[0]):
        start = starts[symbols[i]]
        count = starts[symbols[i] + 1] - start
        low, width, position = encode_interval(low, width, position, out, start, count, width >> bits)
    return finish_encoder(low, position, out)


@kernel
def decode_symbols(data: Any, counts: Any, starts: Any, symbols: Any) -> Any:
    """Decode `symbols` (n,) int32 from `data`; returns the bytes read, or a negative number for damaged data.

    counts: (U,) int64, each at least 1, with sum n. starts: (U + 1,) int64, filled. Returns -1 if the histogram of the
    symbols is not the counts, -2 if a code lies outside all intervals.
    """
    bits = distribute_units(counts, starts)
    shift = max(bits - _LOOKUP_BITS, 0)
    lookup = np.empty(1 << (bits - shift), np.int32)
    _fill_lookup(starts, shift, lookup)
    left = np.empty(counts.shape[0], np.int64)
    for place in range(counts.shape[0]):
        left[place] = counts[place]
    favourite = _most_frequent(counts)
    favourite_start, favourite_end = starts[favourite], starts[favourite + 1]
    code = first_code(data)
    width = np.int64(TOP - 1)
    position = LOOK_AHEAD
    for i in range(symbols.shape[0]):
        unit = width >> bits
        # Trying the most frequent symbol first saves a division on most symbols.
        symbol, start, end = favourite, favourite_start, favourite_end
        if code < start * unit or code >= end * unit:
            target = quotient_of(code, unit)
            if (target >> bits) > 0:
                return -2
            symbol = np.int64(lookup[target >> shift])
            while starts[symbol + 1] <= target:
                symbol += 1
            start, end = starts[symbol], starts[symbol + 1]
        symbols[i] = symbol
        left[symbol] -= 1
        if left[symbol] < 0:
            return -1
        code, width, position = decode_interval(code, position, data, start, end - start, unit)
    return position


@kernel
def _most_frequent(counts: Any) -> Any:
    """Return the first symbol of the largest count."""
    favourite = np.int64(0)
    for symbol in range(counts.shape[0]):
        if counts[symbol] > counts[favourite]:
            favourite = np.int64(symbol)
    return favourite


@kernel
def _fill_lookup(starts: Any, shift: Any, lookup: Any) -> None:
    """Set lookup[k] to the symbol whose interval contains k << shift."""
    symbol = 0
    for k in range(lookup.shape[0]):
        while starts[symbol + 1] <= k << shift:
            symbol += 1
        lookup[k] = symbol
