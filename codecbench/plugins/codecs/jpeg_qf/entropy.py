"""Entropy coder of a sequential scan: Huffman coding of quantized blocks (ITU-T T.81 annex F).

Blocks are rows of an (N, 64) array of coefficients in zigzag order. `order` (N,) lists the rows in coding order.
`pattern` (M,) is the component of each of the M blocks of an MCU. `selectors` (components, 2) are the DC and AC tables
of each component.
"""

from __future__ import annotations

import numpy as np

from codecbench.core.counting.kernel import kernel

OK, CUT_SHORT, BAD_CODE, BAD_RUN, BAD_SIZE, OUT_OF_RANGE, LEFT_OVER, BAD_RESTART = range(8)
REASONS = {
    CUT_SHORT: "the scan ends before its last block",
    BAD_CODE: "bits that are not a Huffman code",
    BAD_RUN: "a run of zeros exceeds its block",
    BAD_SIZE: "a coefficient has more bits than baseline allows",
    OUT_OF_RANGE: "a DC coefficient is out of range",
    LEFT_OVER: "bytes are left over after the last block",
    BAD_RESTART: "restart markers are missing, misplaced or out of order",
}
MAX_BLOCK_BYTES = 2 * (16 + 11 + 63 * (16 + 10)) // 8 + 2
"""Upper bound for one block: every code of the greatest length, every byte stuffed."""
PADDING_BYTES = 8
"""Zeros after unstuffed data, which the bit reader may peek at but not consume."""
_END_OF_BLOCK, _SIXTEEN_ZEROS = 0x00, 0xF0
_MAX_DC_SIZE, _MAX_AC_SIZE = 11, 10
_MAX_DC = 2047
_SIZES = np.array([magnitude.bit_length() for magnitude in range(2 * _MAX_DC + 2)], np.uint8)


@kernel
def bit_size(value):  # type: ignore[no-untyped-def]
    """Number of bits of a coefficient's magnitude: SSSS of T.81 tables F.1 and F.2."""
    return np.int64(_SIZES[abs(value)])


@kernel
def count_symbols(blocks, order, pattern, selectors, frequencies):  # type: ignore[no-untyped-def]
    """Add the number of occurrences of each symbol to `frequencies` (2 classes, 2 tables, 256)."""
    predictions = np.zeros(selectors.shape[0], np.int64)
    for i in range(order.shape[0]):
        block = order[i]
        component = pattern[i % pattern.shape[0]]
        dc, ac = selectors[component, 0], selectors[component, 1]
        value = np.int64(blocks[block, 0])
        frequencies[0, dc, bit_size(value - predictions[component])] += 1
        predictions[component] = value
        zeros = 0
        for k in range(1, 64):
            value = np.int64(blocks[block, k])
            if value == 0:
                zeros += 1
                continue
            while zeros > 15:
                frequencies[1, ac, _SIXTEEN_ZEROS] += 1
                zeros -= 16
            frequencies[1, ac, (zeros << 4) | bit_size(value)] += 1
            zeros = 0
        if zeros > 0:
            frequencies[1, ac, _END_OF_BLOCK] += 1


@kernel
def put_bits(output, pending, bits, written, value, count):  # type: ignore[no-untyped-def]
    """Append the low `count` bits of `value`; returns the new pending bits, their number and the bytes written.

    00 is stuffed after each byte FF (T.81 F.1.2.3).
    """
    pending = (pending << count) | value
    bits += count
    while bits >= 8:
        bits -= 8
        byte = (pending >> bits) & 0xFF
        output[written] = byte
        written += 1
        if byte == 0xFF:
            output[written] = 0
            written += 1
    return pending & ((1 << bits) - 1), bits, written


@kernel
def put_symbol(output, pending, bits, written, code, length, value, size):  # type: ignore[no-untyped-def]
    """Append a Huffman code and the `size` low bits of a coefficient, minus one if negative (T.81 F.1.2.1)."""
    low = value if value >= 0 else value - 1
    code = (np.int64(code) << size) | (low & ((1 << size) - 1))
    return put_bits(output, pending, bits, written, code, np.int64(length) + size)


@kernel
def encode_scan(blocks, order, pattern, selectors, codes, lengths, output):  # type: ignore[no-untyped-def]
    """Write the entropy-coded segment into `output`, large enough for the worst case; returns its size in bytes."""
    predictions = np.zeros(selectors.shape[0], np.int64)
    pending, bits, written = np.int64(0), np.int64(0), np.int64(0)
    for i in range(order.shape[0]):
        block = order[i]
        component = pattern[i % pattern.shape[0]]
        dc, ac = selectors[component, 0], selectors[component, 1]
        value = np.int64(blocks[block, 0])
        difference = value - predictions[component]
        predictions[component] = value
        size = bit_size(difference)
        code, length = codes[0, dc, size], lengths[0, dc, size]
        pending, bits, written = put_symbol(output, pending, bits, written, code, length, difference, size)
        zeros = 0
        for k in range(1, 64):
            value = np.int64(blocks[block, k])
            if value == 0:
                zeros += 1
                continue
            while zeros > 15:
                code, length = codes[1, ac, _SIXTEEN_ZEROS], lengths[1, ac, _SIXTEEN_ZEROS]
                pending, bits, written = put_symbol(output, pending, bits, written, code, length, np.int64(0), 0)
                zeros -= 16
            size = bit_size(value)
            symbol = (zeros << 4) | size
            code, length = codes[1, ac, symbol], lengths[1, ac, symbol]
            pending, bits, written = put_symbol(output, pending, bits, written, code, length, value, size)
            zeros = 0
        if zeros > 0:
            code, length = codes[1, ac, _END_OF_BLOCK], lengths[1, ac, _END_OF_BLOCK]
            pending, bits, written = put_symbol(output, pending, bits, written, code, length, np.int64(0), 0)
    if bits > 0:  # pad the last byte with ones
        pending, bits, written = put_bits(output, pending, bits, written, np.int64(0x7F) >> (bits - 1), 8 - bits)
    return written


@kernel
def unstuff(data, output, ends):  # type: ignore[no-untyped-def]
    """Remove stuffed zeros and restart markers from `data`.

    `ends` receives the end of each interval in `output`; the last is the end of the data. Returns the number of
    intervals, or -BAD_RESTART if there are more markers than `ends` has room for, or they are out of order.
    """
    written, intervals, i = 0, 0, 0
    while i < data.shape[0]:
        byte = data[i]
        i += 1
        if byte == 0xFF and i < data.shape[0]:
            following = data[i]
            i += 1
            if following != 0:
                if intervals + 1 >= ends.shape[0] or following != 0xD0 + (intervals & 7):
                    return -BAD_RESTART
                ends[intervals] = written
                intervals += 1
                continue
        output[written] = byte
        written += 1
    ends[intervals] = written
    return intervals + 1


@kernel
def peek(data, bit):  # type: ignore[no-untyped-def]
    """Return the 16 bits that start at bit `bit` of `data`."""
    i = bit >> 3
    three = (np.int64(data[i]) << 16) | (np.int64(data[i + 1]) << 8) | np.int64(data[i + 2])
    return (three >> (8 - (bit & 7))) & 0xFFFF


@kernel
def next_symbol(window, lookahead, max_codes, offsets, symbols):  # type: ignore[no-untyped-def]
    """Return length << 8 | symbol of the code that 16 bits start with, or -1 for none (T.81 F.2.2.3)."""
    length_and_symbol = np.int64(lookahead[window >> 8])
    if length_and_symbol != 0:
        return length_and_symbol
    for length in range(9, 17):
        code = window >> (16 - length)
        if code <= max_codes[length]:
            return (length << 8) | np.int64(symbols[code + offsets[length]])
    return np.int64(-1)


@kernel
def extend(window, size):  # type: ignore[no-untyped-def]
    """Return the coefficient of the first `size` bits of a window of 16 (T.81 F.2.2.1, EXTEND)."""
    if size == 0:
        return np.int64(0)
    value = window >> (16 - size)
    if value < (1 << (size - 1)):
        value -= (1 << size) - 1
    return value


@kernel
def decode_block(data, bit, limit, tables, dc, ac, block):  # type: ignore[no-untyped-def]
    """Decode the block at `bit`: its DC difference into block[0] and its AC; returns the next bit or minus an error.

    `block` (64,) must be zero. No bit at or after `limit` is consumed.
    """
    lookahead, max_codes, offsets, symbols = tables
    code = next_symbol(peek(data, bit), lookahead[0, dc, :], max_codes[0, dc, :], offsets[0, dc, :], symbols[0, dc, :])
    size = code & 0xFF
    if code < 0:
        return -BAD_CODE
    if size > _MAX_DC_SIZE:
        return -BAD_SIZE
    bit += code >> 8
    if bit + size > limit:
        return -CUT_SHORT
    block[0] = extend(peek(data, bit), size)
    bit += size
    k = 1
    while k < 64:
        code = next_symbol(
            peek(data, bit), lookahead[1, ac, :], max_codes[1, ac, :], offsets[1, ac, :], symbols[1, ac, :]
        )
        if code < 0:
            return -BAD_CODE
        zeros, size = (code >> 4) & 15, code & 15
        bit += code >> 8
        if bit + size > limit:
            return -CUT_SHORT
        if size == 0:
            if zeros != 15:
                break
            k += 16
            continue
        k += zeros
        if k > 63:
            return -BAD_RUN
        if size > _MAX_AC_SIZE:
            return -BAD_SIZE
        block[k] = extend(peek(data, bit), size)
        bit += size
        k += 1
    if k > 64:
        return -BAD_RUN
    return bit


@kernel
def decode_scan(data, ends, interval_blocks, order, pattern, selectors, tables, blocks):  # type: ignore[no-untyped-def]
    """Decode unstuffed `data` into `blocks`, which must be zero; returns OK or an error code.

    Every `interval_blocks` blocks predictions are reset and bits start at a byte. `ends` (intervals,) are the ends of
    the intervals in `data`, which has PADDING_BYTES more behind the last end.
    """
    predictions = np.zeros(selectors.shape[0], np.int64)
    interval, bit = 0, np.int64(0)
    limit = ends[0] * 8
    for i in range(order.shape[0]):
        if i > 0 and i % interval_blocks == 0:
            if limit - bit >= 8:
                return LEFT_OVER
            bit = limit
            interval += 1
            limit = ends[interval] * 8
            for component in range(predictions.shape[0]):
                predictions[component] = 0
        component = pattern[i % pattern.shape[0]]
        block = blocks[order[i], :]
        bit = decode_block(data, bit, limit, tables, selectors[component, 0], selectors[component, 1], block)
        if bit < 0:
            return -bit
        predictions[component] += block[0]
        if abs(predictions[component]) > _MAX_DC:
            return OUT_OF_RANGE
        block[0] = predictions[component]
    if limit - bit >= 8:
        return LEFT_OVER
    return OK
