"""Descriptors coded four at a time, each in its own stream (*lane*), with the probabilities of `prediction`.

A descriptor is coded in blocks of bits that are predicted together. The arithmetic of a bit depends on that of the bit
before, so a processor interleaves the four lanes. Probabilities are trained and fixed, because adapting them would add
a dependency too. All arithmetic is on integers.

The coder is the range coder of `multilevel.arithmetic` with words of 24 bits instead of bytes. The bit that ends a word
is unpredictable for a processor, so fewer words are faster.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from codecbench.core.kernels.compiled import compiled
from codecbench.plugins.codecs.multilevel.context.binary import LOW, POSITION, WIDTH
from codecbench.plugins.codecs.orb_features.prediction import (
    BITS,
    BLOCK,
    CHANCES,
    CLASS_STARTS,
    LOWEST_CHANCE,
    STEP_SHIFT,
    STEPS,
)
from codecbench.slam.features.hamming import count_bits

LANES: Final = 4
END = 3
"""Index of the end of a lane's words, beside LOW, WIDTH and POSITION of a coder; positions count words."""
MOST_WORDS: Final = 124
"""Upper bound of a descriptor's size in words."""
_LOOK_AHEAD = 2
UNWRITTEN_WORDS: Final = 1
"""Number of zero words that the decoder reads beyond the encoder's last word."""

WORD_BITS: Final = 24
_TOP = 1 << (2 * WORD_BITS)
_BOTTOM = 1 << WORD_BITS
_BELOW_BOTTOM = _BOTTOM - 1
_MIDDLE = STEPS // 2
_FULL = np.uint64((1 << BLOCK) - 1)
_SURE = 65536 - LOWEST_CHANCE
_NIBBLES = BLOCK // 4


@compiled(_nrt=False)
def _carry(data: Any, position: int) -> None:
    """Add one to the number that ends before `position`."""
    position -= 1
    while data[position] == _BELOW_BOTTOM:
        data[position] = 0
        position -= 1
    data[position] += 1


@compiled(_nrt=False, forceinline=True)
def _encode(low: Any, width: Any, position: Any, data: Any, chance: Any, bit: Any) -> Any:
    """Code a bit; returns low, width and position. chance: of 1, in 1/2^16."""
    ones = (width >> 16) * chance
    zeros = width - ones
    mask = -bit  # no branch, because it would be unpredictable
    low += ones & ~mask
    width = zeros ^ ((zeros ^ ones) & mask)
    if width < _BOTTOM:
        if low >= _TOP:
            low -= _TOP
            _carry(data, position)
        data[np.uint64(position)] = low >> WORD_BITS
        position += 1
        low = (low & _BELOW_BOTTOM) << WORD_BITS
        width <<= WORD_BITS
    return low, width, position


@compiled(_nrt=False, forceinline=True)
def _decode(code: Any, width: Any, position: Any, data: Any, end: Any, chance: Any) -> Any:
    """Decode a bit; returns code, width, position, and -1 for a bit of 1, else 0."""
    ones = (width >> 16) * chance
    zeros = width - ones
    mask = (code - ones) >> 63
    code -= ones & ~mask
    width = zeros ^ ((zeros ^ ones) & mask)
    if width < _BOTTOM:
        code <<= WORD_BITS
        if position < end:
            code |= np.int64(data[np.uint64(position)])
        position += 1
        width <<= WORD_BITS
    return code, width, position, mask


@compiled
def finish_lanes(lanes: Any, data: Any) -> None:
    """Write each lane's last word, which selects a number inside its range if zeros follow."""
    for lane in range(LANES):
        low = lanes[lane, LOW] + _BELOW_BOTTOM
        if low >= _TOP:
            low -= _TOP
            _carry(data, lanes[lane, POSITION])
        data[lanes[lane, POSITION]] = low >> WORD_BITS
        lanes[lane, POSITION] += 1


@compiled
def start_lanes(lanes: Any, data: Any) -> None:
    """Read the first code of each lane, from POSITION on."""
    for lane in range(LANES):
        code: Any = 0
        for _ in range(_LOOK_AHEAD):
            position = lanes[lane, POSITION]
            code = (code << WORD_BITS) | (np.int64(data[position]) if position < lanes[lane, END] else 0)
            lanes[lane, POSITION] += 1
        lanes[lane, LOW] = code


@compiled
def new_lanes() -> Any:
    """Return the initial lanes (LANES, 4)."""
    lanes = np.zeros((LANES, 4), np.int64)
    lanes[:, WIDTH] = _TOP - 1
    return lanes


@compiled(_nrt=False, forceinline=True)
def _predict_block(odds: Any, lane: Any, start: Any, first: Any, known: Any, chances: Any) -> None:
    """Fill the lane's `chances` (LANES, BLOCK) of a block whose class starts at `first` in CHANCES."""
    for k in range(np.uint64(BLOCK)):
        expected = np.int64((known >> k) & np.uint64(1))
        step = first + expected * STEPS + (np.int64(odds[lane, start + k]) >> STEP_SHIFT)
        chances[lane, k] = CHANCES[np.uint64(step)]


@compiled(_nrt=False, forceinline=True)
def _update_odds(odds: Any, lane: Any, nibbles: Any, start: Any, block: Any, bits: Any) -> None:
    """Add the weights of a block's bits to the lane's odds (LANES, BITS), from bit `start` on."""
    row = np.uint64(16 * _NIBBLES) * block
    a = row + (bits & np.uint64(15))
    b = row + np.uint64(16) + ((bits >> np.uint64(4)) & np.uint64(15))
    c = row + np.uint64(32) + ((bits >> np.uint64(8)) & np.uint64(15))
    d = row + np.uint64(48) + (bits >> np.uint64(12))
    for word in range(start >> np.uint64(6), np.uint64(BITS // 64)):  # whole words: faster, weights before are 0
        for place in range(np.uint64(64)):
            k = (word << np.uint64(6)) + place
            first = np.int16(np.int16(nibbles[a, k]) + np.int16(nibbles[b, k]))
            second = np.int16(np.int16(nibbles[c, k]) + np.int16(nibbles[d, k]))
            odds[lane, k] = np.int16(odds[lane, k] + np.int16(first + second))


@compiled(_nrt=False)
def _code_four(
    encoding: Any, lanes: Any, data: Any, nibbles: Any, biases: Any, descriptors: Any, rows: Any, references: Any,
    odds: Any, chances: Any, blocks: Any, known: Any, wrong: Any,
) -> None:  # fmt: skip
    """Code one row of `descriptors` in each lane; the last row, of all ones, means none.

    The other arrays are scratch: odds (LANES, BITS) int16, chances (LANES, BLOCK) uint16, the rest (LANES,).
    """
    none = descriptors.shape[0] - 1
    low_0, low_1, low_2, low_3 = lanes[0, LOW], lanes[1, LOW], lanes[2, LOW], lanes[3, LOW]
    width_0, width_1, width_2, width_3 = lanes[0, WIDTH], lanes[1, WIDTH], lanes[2, WIDTH], lanes[3, WIDTH]
    at_0, at_1, at_2, at_3 = lanes[0, POSITION], lanes[1, POSITION], lanes[2, POSITION], lanes[3, POSITION]
    end_0, end_1, end_2, end_3 = lanes[0, END], lanes[1, END], lanes[2, END], lanes[3, END]
    for lane in range(np.uint64(LANES)):
        wrong[lane] = 0
        for k in range(np.uint64(BITS)):
            odds[lane, k] = biases[k]
    for block in range(np.uint64(BITS // BLOCK)):
        start = np.uint64(BLOCK) * block
        word, shift = start >> np.uint64(6), start & np.uint64(63)
        for lane in range(np.uint64(LANES)):
            row, reference = rows[lane], references[lane]
            blocks[lane] = np.int64((descriptors[np.uint64(row), word] >> shift) & _FULL) if encoding else 0
            if row == none:
                known[lane] = _FULL
                for k in range(np.uint64(BLOCK)):
                    chances[lane, k] = _SURE
            else:
                first, expected = np.int64(_MIDDLE), np.uint64(0)
                if reference >= 0:
                    expected = (descriptors[np.uint64(reference), word] >> shift) & _FULL
                    first = CLASS_STARTS[block, np.uint64(wrong[lane])] + _MIDDLE
                known[lane] = expected
                _predict_block(odds, lane, start, first, expected, chances)
        bits_0, bits_1, bits_2, bits_3 = blocks[0], blocks[1], blocks[2], blocks[3]
        if encoding:
            for k in range(np.uint64(BLOCK)):
                low_0, width_0, at_0 = _encode(low_0, width_0, at_0, data, np.int64(chances[0, k]), bits_0 & 1)
                low_1, width_1, at_1 = _encode(low_1, width_1, at_1, data, np.int64(chances[1, k]), bits_1 & 1)
                low_2, width_2, at_2 = _encode(low_2, width_2, at_2, data, np.int64(chances[2, k]), bits_2 & 1)
                low_3, width_3, at_3 = _encode(low_3, width_3, at_3, data, np.int64(chances[3, k]), bits_3 & 1)
                bits_0, bits_1, bits_2, bits_3 = bits_0 >> 1, bits_1 >> 1, bits_2 >> 1, bits_3 >> 1
        else:
            for k in range(np.uint64(BLOCK)):
                low_0, width_0, at_0, mask = _decode(low_0, width_0, at_0, data, end_0, np.int64(chances[0, k]))
                bits_0 -= mask << np.int64(k)
                low_1, width_1, at_1, mask = _decode(low_1, width_1, at_1, data, end_1, np.int64(chances[1, k]))
                bits_1 -= mask << np.int64(k)
                low_2, width_2, at_2, mask = _decode(low_2, width_2, at_2, data, end_2, np.int64(chances[2, k]))
                bits_2 -= mask << np.int64(k)
                low_3, width_3, at_3, mask = _decode(low_3, width_3, at_3, data, end_3, np.int64(chances[3, k]))
                bits_3 -= mask << np.int64(k)
            blocks[0], blocks[1], blocks[2], blocks[3] = bits_0, bits_1, bits_2, bits_3
            for lane in range(np.uint64(LANES)):
                if rows[lane] != none:
                    descriptors[np.uint64(rows[lane]), word] |= np.uint64(blocks[lane]) << shift
        for lane in range(np.uint64(LANES)):
            if encoding:
                row = np.uint64(rows[lane])
                blocks[lane] = np.int64((descriptors[row, word] >> shift) & _FULL)
            bits = np.uint64(blocks[lane])
            wrong[lane] += np.int64(count_bits(bits ^ known[lane]))
            _update_odds(odds, lane, nibbles, start + np.uint64(BLOCK), block, bits)
    lanes[0, LOW], lanes[1, LOW], lanes[2, LOW], lanes[3, LOW] = low_0, low_1, low_2, low_3
    lanes[0, WIDTH], lanes[1, WIDTH], lanes[2, WIDTH], lanes[3, WIDTH] = width_0, width_1, width_2, width_3
    lanes[0, POSITION], lanes[1, POSITION], lanes[2, POSITION], lanes[3, POSITION] = at_0, at_1, at_2, at_3


@compiled
def code_descriptors(
    encoding: bool, lanes: Any, data: Any, nibbles: Any, biases: Any, descriptors: Any, first: int, sources: Any,
    copied: Any,
) -> None:  # fmt: skip
    """Code the rows of `descriptors` from `first` on except the last, or decode them; a decoder needs zeros there.

    descriptors: (first + N + 1, 4) uint64: possible references, then those to code, then all ones. sources: (N,) int64,
    the row of each one's reference, an earlier one, or -1. copied: (N,) bool: those equal to their reference; none of
    them is a reference itself. nibbles, biases: of `prediction`. data: uint32, the words.
    """
    none = descriptors.shape[0] - 1
    rows, references = np.empty(LANES, np.int64), np.empty(LANES, np.int64)
    odds, chances = np.empty((LANES, BITS), np.int16), np.empty((LANES, BLOCK), np.uint16)
    blocks, known, wrong = np.empty(LANES, np.int64), np.empty(LANES, np.uint64), np.empty(LANES, np.int64)
    count = sources.shape[0]
    i = 0
    while i < count:
        start, filled = first + i, 0
        rows[:] = none
        references[:] = -1
        while i < count and filled < LANES and (copied[i] or sources[i] < start):
            if not copied[i]:
                rows[filled], references[filled] = first + i, sources[i]
                filled += 1
            i += 1
        if filled > 0:
            _code_four(
                encoding, lanes, data, nibbles, biases, descriptors, rows, references, odds, chances, blocks, known,
                wrong,
            )  # fmt: skip
    if not encoding:
        for i in range(count):
            if copied[i]:
                descriptors[first + i] = descriptors[sources[i]]
