"""A set of keypoints coded by adaptive binary decisions: places, references, angles, descriptors.

One source codes and decodes, as in `multilevel.context.binary`, whose coder this is. All arithmetic is on integers.
A keypoint's descriptor is predicted bit by bit from its own bits before (`prediction`), and together with a *reference*
where there is one: a keypoint near its place, of the set before or of a finer level of this one, that looks like it.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from codecbench.core.kernels.compiled import compiled
from codecbench.plugins.codecs.multilevel.arithmetic import decode_interval, encode_interval, quotient_of
from codecbench.plugins.codecs.multilevel.context.binary import (
    ENCODING,
    LOW,
    MAX_SEEN,
    POSITION,
    RATES,
    WIDTH,
    code_adaptive,
    probabilities_from_odds,
)
from codecbench.plugins.codecs.orb_features.prediction import BITS
from codecbench.plugins.codecs.orb_features.references import MAX_CANDIDATES, PLACE_UNIT, find_candidates
from codecbench.slam.features.hamming import hamming

NO_REFERENCE, LAST, HERE = 0, 1, 2
"""Kinds of reference: none, of the set before, of this set."""

RAW, CODED = 0, 1
"""How descriptors are coded."""

OUTSIDE, NO_CANDIDATE = -1, -2
"""What `code_set` returns for damaged data: a place outside its level, a reference that is not there."""

MAX_LEVELS: Final = 16
MOST_BYTES: Final = 480
"""That one keypoint takes at the very worst."""

_LAST_RADIUS: Final = 24 * PLACE_UNIT
_HERE_RADIUS: Final = 6 * PLACE_UNIT
_LIKE: Final = 84
"""Bits that differ: beyond, a reference says no more than the bits before."""

# Contexts, by what they are of.
_GAPS = 0  # level, then a tree of 32 leaves
_KINDS = _GAPS + 32 * MAX_LEVELS  # kind of the keypoint before, then two decisions
_RANKS = _KINDS + 9  # kind, then a tree of 16 leaves
_TURNS = _RANKS + 48  # kind, then a tree of 32 leaves
_COPIED = _TURNS + 96  # kind
_PREDICTED = _COPIED + 3  # class of the reference, 0 for none; then what is predicted
_STEPS = 64
_CLASSES = 9
_CONTEXTS = _PREDICTED + _CLASSES * _STEPS

_CLASS_LIMITS = np.array([6, 12, 20, 30, 44, 60, 80])
_CLASS_ODDS = np.array([0, 62, 52, 44, 38, 30, 24, 16, 8])  # of agreeing with the reference, in 1/16
_BLOCK = 16
"""Bits whose class of reference is the same."""
_MASK = np.uint64((1 << _BLOCK) - 1)
_STEP_SHIFT = 8
_SEEN_BEFORE = 12  # bits for which a first guess stands


def new_model() -> NDArray[np.int32]:
    """Contexts that have seen nothing; see `binary`."""
    model = np.full(_CONTEXTS, 1 << 29, np.int32)
    predicted = np.arange(_STEPS) * 2 + 1 - _STEPS
    for number, odds in enumerate(_CLASS_ODDS):
        guess = predicted * 2 if number == 0 else -(odds + predicted)
        start = _PREDICTED + number * _STEPS
        model[start : start + _STEPS] = (probabilities_from_odds(np.clip(guess, -80, 80)) << 8) | _SEEN_BEFORE
    return model


@compiled
def _code_plainly(coder: Any, data: Any, value: Any, bits: int) -> Any:
    """Code or decode a number of so many bits, all equally likely."""
    if bits <= 16:
        return _code_plainly_short(coder, data, value, bits)
    upper = _code_plainly_short(coder, data, value >> 16, bits - 16)
    return (upper << 16) | _code_plainly_short(coder, data, value & 0xFFFF, 16)


@compiled
def _code_plainly_short(coder: Any, data: Any, value: Any, bits: int) -> Any:
    unit = coder[WIDTH] >> bits
    if coder[ENCODING]:
        coder[LOW], coder[WIDTH], coder[POSITION] = encode_interval(
            coder[LOW], coder[WIDTH], coder[POSITION], data, value, 1, unit
        )
        return value
    value = min(quotient_of(coder[LOW], unit), (1 << bits) - 1)
    coder[LOW], coder[WIDTH], coder[POSITION] = decode_interval(coder[LOW], coder[POSITION], data, value, 1, unit)
    return value


@compiled
def _code_tree(coder: Any, data: Any, model: Any, first: int, value: int, bits: int) -> int:
    """Code or decode a number of so many bits, each in a context of those above it."""
    node = 1
    for place in range(bits - 1, -1, -1):
        node = (node << 1) | code_adaptive(coder, data, model, first + node, (value >> place) & 1)
    return node - (1 << bits)


@compiled
def _code_length(coder: Any, data: Any, model: Any, first: int, number: int) -> Any:
    """Code or decode a number below 2^31: how many bits it has adaptively, the others plainly."""
    length = 0
    while number >> length > 0:
        length += 1
    length = _code_tree(coder, data, model, first, length, 5)
    if length < 2:
        return length
    top = 1 << (length - 1)
    return top | _code_plainly(coder, data, number & (top - 1), length - 1)


@compiled
def _class_of(differing: int, seen: int) -> int:
    """The class of a reference by how many of the bits seen differ from it."""
    rate = (256 * differing + 256) // (seen + 14)
    number = 1
    for k in range(_CLASS_LIMITS.shape[0]):
        if rate >= _CLASS_LIMITS[k]:
            number += 1
    return number


@compiled(_nrt=False)
def _code_descriptor(
    coder: Any, data: Any, model: Any, weights: Any, odds: Any,
    descriptors: Any, i: int, references: Any, reference: int,
) -> None:  # fmt: skip
    """Code or decode row i of `descriptors` (N, 4) beside row `reference` of `references`, -1 for none.

    odds: (256,) int16, what is known beforehand, overwritten. As `binary.code_adaptive`, with the coder's state in
    registers: this is where the time goes.
    """
    encoding, low, width, position = coder[ENCODING], coder[LOW], coder[WIDTH], coder[POSITION]
    differing: Any = 0
    start, aimed = _PREDICTED, reference >= 0
    flip: Any = 0
    for block in range(BITS // _BLOCK):
        first = block * _BLOCK
        word, shift = first >> 6, np.uint64(first & 63)
        known = np.int64((references[reference, word] >> shift) & _MASK) if aimed else np.int64(0)
        bits = np.int64((descriptors[i, word] >> shift) & _MASK)
        if aimed:
            start = _PREDICTED + _class_of(differing, first) * _STEPS
        coded = np.int64(0)
        for place in range(_BLOCK):
            k = np.uint64(first + place)
            expected = (known >> place) & 1
            said = np.int64(odds[k]) >> _STEP_SHIFT
            step: Any = (said if expected | (not aimed) else -said) + (_STEPS >> 1)
            context = start + min(max(step, 0), _STEPS - 1)
            state = np.int64(model[context])
            split = (width >> 16) * min(max(state >> 14, 24), 65512)
            if encoding:
                flip = ((bits >> place) & 1) ^ expected
                begin = 0 if flip else split
                low, width, position = encode_interval(
                    low, width, position, data, begin, split if flip else width - split, 1
                )
            else:
                flip = np.int64(low < split)
                begin = 0 if flip else split
                low, width, position = decode_interval(low, position, data, begin, split if flip else width - split, 1)
            seen = state & 255
            chance = state >> 8
            chance += (((flip << 22) - chance) * RATES[seen]) >> 16
            model[context] = (chance << 8) | min(seen + 1, MAX_SEEN)
            differing += flip
            bit = flip ^ expected
            coded |= bit << place
            if bit:
                for later in range(np.uint64(BITS)):  # also those before, whose weights are 0: whole vectors are faster
                    odds[later] = np.int16(odds[later] + weights[k, later])
        descriptors[i, word] = (descriptors[i, word] & ~(_MASK << shift)) | (np.uint64(coded) << shift)
    coder[LOW], coder[WIDTH], coder[POSITION] = low, width, position


@compiled
def _nearest(descriptors: Any, i: int, others: Any, candidates: Any, count: int) -> Any:
    """The rank of the candidate most like row i, and how many bits differ."""
    best, rank = 512, 0
    for k in range(count):
        distance = hamming(descriptors, i, others, candidates[k])
        if distance < best:
            best, rank = distance, k
    return best, rank


@compiled
def code_set(
    coder: Any, data: Any, model: Any, weights: Any, biases: Any, level_units: Any, octave_starts: Any,
    cells: Any, places: Any, angles: Any, descriptors: Any, angle_bits: int, mode: int, like: int,
    last_starts: Any, last_places: Any, last_angles: Any, last_descriptors: Any,
) -> int:  # fmt: skip
    """Code a set, or decode it into the arrays given; returns 0, or what is wrong with the data.

    level_units: (levels, 4) int64: columns and rows of a level's cells, and the size of one in the image in 1/16 of the
    unit of places. octave_starts: (levels + 1,) where each begins. cells: (N,) int64 row * columns + column, ascending
    within a level. places: (N, 2) int64, filled. angles: (N,) int64 of `angle_bits`. descriptors: (N, 4) uint64; those
    that differ from their reference in at most `like` bits become it. last_*: the same of the set before.
    """
    found_last, found_here = np.empty(MAX_CANDIDATES, np.int64), np.empty(MAX_CANDIDATES, np.int64)
    odds = np.empty(BITS, np.int16)
    encoding = coder[ENCODING]
    mask = (1 << angle_bits) - 1
    half = 1 << (angle_bits - 1)
    before, moved_x, moved_y = 0, 0, 0
    for octave in range(octave_starts.shape[0] - 1):
        columns, rows = level_units[octave, 0], level_units[octave, 1]
        cell = 0
        for i in range(octave_starts[octave], octave_starts[octave + 1]):
            cell += _code_length(coder, data, model, _GAPS + 32 * octave, cells[i] - cell)
            if cell >= columns * rows:
                return OUTSIDE
            cells[i] = cell
            x = ((2 * (cell % columns) + 1) * level_units[octave, 2]) >> 5
            y = ((2 * (cell // columns) + 1) * level_units[octave, 3]) >> 5
            places[i, 0], places[i, 1] = x, y

            kind, rank, near, count_last, count_here = NO_REFERENCE, 0, 512, 0, 0
            if encoding and mode != RAW:
                count_last = find_candidates(
                    last_places, last_starts, octave - 1, octave + 1, x - moved_x, y - moved_y, _LAST_RADIUS, found_last
                )
                near, rank = _nearest(descriptors, i, last_descriptors, found_last, count_last)
                kind = LAST
                count_here = find_candidates(
                    places, octave_starts, octave - 2, octave - 1, x, y, _HERE_RADIUS, found_here
                )
                distance, other = _nearest(descriptors, i, descriptors, found_here, count_here)
                if distance < near:
                    near, rank, kind = distance, other, HERE
                if near > _LIKE:
                    kind = NO_REFERENCE
            reference = -1
            if mode != RAW:
                kind = _code_kind(coder, data, model, before, kind)
                before = kind
                if kind != NO_REFERENCE:
                    rank = _code_tree(coder, data, model, _RANKS + 16 * kind, rank, 4)
                    if kind == LAST:
                        if not encoding:
                            count_last = find_candidates(
                                last_places, last_starts, octave - 1, octave + 1,
                                x - moved_x, y - moved_y, _LAST_RADIUS, found_last,
                            )  # fmt: skip
                        if rank >= count_last:
                            return NO_CANDIDATE
                        reference = found_last[rank]
                        moved_x += (x - last_places[reference, 0] - moved_x) >> 2
                        moved_y += (y - last_places[reference, 1] - moved_y) >> 2
                    else:
                        if not encoding:
                            count_here = find_candidates(
                                places, octave_starts, octave - 2, octave - 1, x, y, _HERE_RADIUS, found_here
                            )
                        if rank >= count_here:
                            return NO_CANDIDATE
                        reference = found_here[rank]
            if kind == NO_REFERENCE:
                angles[i] = _code_plainly(coder, data, angles[i], angle_bits)
            else:
                angle = last_angles[reference] if kind == LAST else angles[reference]
                turn = ((angles[i] - angle + half) & mask) - half
                folded = 2 * turn if turn >= 0 else -2 * turn - 1
                folded = _code_length(coder, data, model, _TURNS + 32 * kind, folded)
                turn = -((folded + 1) >> 1) if folded & 1 else folded >> 1
                angles[i] = (angle + turn) & mask
            if mode == RAW:
                for word in range(4):
                    _code_word(coder, data, descriptors, i, word)
                continue
            if like > 0 and kind != NO_REFERENCE:
                copied = code_adaptive(coder, data, model, _COPIED + kind, 1 if near <= like else 0)
                if copied:
                    for word in range(4):
                        descriptors[i, word] = (
                            last_descriptors[reference, word] if kind == LAST else descriptors[reference, word]
                        )
                    continue
            references = last_descriptors if kind == LAST else descriptors
            for k in range(BITS):
                odds[k] = biases[k]
            _code_descriptor(coder, data, model, weights, odds, descriptors, i, references, reference)
    return 0


@compiled
def _code_kind(coder: Any, data: Any, model: Any, before: int, kind: int) -> int:
    first = _KINDS + 3 * before
    if not code_adaptive(coder, data, model, first, 1 if kind != NO_REFERENCE else 0):
        return NO_REFERENCE
    return HERE if code_adaptive(coder, data, model, first + 1, 1 if kind == HERE else 0) else LAST


@compiled
def _code_word(coder: Any, data: Any, descriptors: Any, i: int, word: int) -> None:
    value, coded = descriptors[i, word], np.uint64(0)
    for place in range(0, 64, 16):
        part = np.int64((value >> np.uint64(place)) & np.uint64(0xFFFF))
        coded |= np.uint64(_code_plainly_short(coder, data, part, 16)) << np.uint64(place)
    descriptors[i, word] = coded
