"""A set of keypoints without descriptors coded by adaptive binary decisions: places, references, angles.

The coder is that of `multilevel.context.binary`; the same functions encode and decode, on integers. A *reference* is a
similar keypoint near another's place, of the last set or of a finer level of this one. It predicts the angle and the
descriptor.
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
    POSITION,
    WIDTH,
    code_adaptive,
)
from codecbench.plugins.codecs.orb_features.keypoints import (
    MAX_CANDIDATES,
    PLACE_UNIT,
    candidate_of,
    find_candidates,
    rank_of,
)
from codecbench.slam.features.hamming import hamming

NO_REFERENCE, LAST, HERE = 0, 1, 2
"""Kinds of reference: none, in the last set, in this set."""

RAW, CODED = 0, 1
"""Modes of descriptors."""

OUTSIDE, NO_CANDIDATE = -1, -2
"""Results of `code_set` for damaged data: a place outside its level, a reference that does not exist."""

MAX_LEVELS: Final = 16
MOST_BYTES: Final = 48
"""Upper bound of a keypoint's or a length's size in bytes."""
MOST_DIFFERING: Final = 84
"""Largest distance of a useful reference in bits: beyond it the earlier bits predict as well."""

_LAST_RADIUS: Final = 24 * PLACE_UNIT
_HERE_RADIUS: Final = 6 * PLACE_UNIT

# First context of each kind.
_GAPS = 0  # level, then a tree of 32 leaves
_KINDS = _GAPS + 32 * MAX_LEVELS  # kind of the keypoint before, then two decisions
_RANKS = _KINDS + 9  # kind, then 31 decisions
_TURNS = _RANKS + 96  # kind, then a tree of 32 leaves
_COPIED = _TURNS + 96  # kind
_LENGTHS = _COPIED + 3  # a tree of 32 leaves
_PARTS = _LENGTHS + 32  # a tree of 16 leaves
_CONTEXTS = _PARTS + 16


def new_model() -> NDArray[np.int32]:
    """Return an untrained context model; see `binary`."""
    return np.full(_CONTEXTS, 1 << 29, np.int32)


@compiled
def _code_uniform(coder: Any, data: Any, value: Any, bits: int) -> Any:
    """Code or decode a number of `bits` bits, all equally likely."""
    if bits <= 24:
        return _code_uniform_short(coder, data, value, bits)
    upper = _code_uniform_short(coder, data, value >> 24, bits - 24)
    return (upper << 24) | _code_uniform_short(coder, data, value & 0xFFFFFF, 24)


@compiled
def _code_uniform_short(coder: Any, data: Any, value: Any, bits: int) -> Any:
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
    """Code or decode a number of `bits` bits, each in a context of the higher bits."""
    node = 1
    for place in range(bits - 1, -1, -1):
        node = (node << 1) | code_adaptive(coder, data, model, first + node, (value >> place) & 1)
    return node - (1 << bits)


@compiled
def _code_length(coder: Any, data: Any, model: Any, first: int, number: int) -> Any:
    """Code or decode a number below 2^31: its length adaptively, its bits as equally likely."""
    length = 0
    while number >> length > 0:
        length += 1
    return _code_below(coder, data, number, _code_tree(coder, data, model, first, length, 5))


@compiled
def _code_short_length(coder: Any, data: Any, model: Any, first: int, number: int) -> Any:
    """As `_code_length`, for numbers that mostly are 0 or 1: the length is coded in unary."""
    length = 0
    while length < 31 and code_adaptive(coder, data, model, first + length, 1 if number >> length > 0 else 0):
        length += 1
    return _code_below(coder, data, number, length)


@compiled
def _code_below(coder: Any, data: Any, number: int, length: int) -> Any:
    """Code or decode the bits below the highest one of a number of `length` bits."""
    if length < 2:
        return length
    top = 1 << (length - 1)
    return top | _code_uniform(coder, data, number & (top - 1), length - 1)


@compiled
def _nearest(descriptors: Any, i: int, first: int, candidates: Any, count: int) -> Any:
    """Return the distance in bits from row i to the nearest candidate, rows from `first` on, and its index."""
    best, chosen = 512, -1
    for k in range(count):
        distance = hamming(descriptors, i, descriptors, first + candidates[k])
        if distance < best:
            best, chosen = distance, k
    return best, chosen


@compiled
def code_set(
    coder: Any, data: Any, model: Any, level_units: Any, octave_starts: Any, cells: Any, places: Any, angles: Any,
    descriptors: Any, sources: Any, copied: Any, angle_bits: int, mode: int, like: int,
    last_starts: Any, last_places: Any, last_angles: Any,
) -> int:  # fmt: skip
    """Code a set without its descriptors, or decode it into the given arrays; returns 0 or the kind of damage.

    level_units: (levels, 4) int64: columns and rows of a level's cells, and a cell's size in the image in 1/16 of
    the unit of places. octave_starts: (levels + 1,) first index of each. cells: (N,) int64 row * columns + column,
    ascending within a level. places: (N, 2) int64, filled. angles: (N,) int64 of `angle_bits`. descriptors: (M + N
    + 1, 4) uint64 as in `descriptors.code_descriptors`, M of the last set; an encoder reads them and overwrites the
    copied ones. sources, copied: (N,) filled, as there; copied are those that differ from their reference in at
    most `like` bits. last_*: of the last set.
    """
    candidates_last, keys_last = np.empty(MAX_CANDIDATES + 1, np.int64), np.empty(MAX_CANDIDATES + 1, np.int64)
    candidates_here, keys_here = np.empty(MAX_CANDIDATES + 1, np.int64), np.empty(MAX_CANDIDATES + 1, np.int64)
    firsts_last, firsts_here = last_starts.copy(), octave_starts.copy()
    encoding = coder[ENCODING]
    mask = (1 << angle_bits) - 1
    half = 1 << (angle_bits - 1)
    before, moved_x, moved_y = 0, 0, 0
    lasts = last_places.shape[0]
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
            sources[i], copied[i] = -1, False
            if mode == RAW:
                angles[i] = _code_uniform(coder, data, angles[i], angle_bits)
                continue

            kind, rank, chosen, near, count_last, count_here = NO_REFERENCE, 0, -1, 512, 0, 0
            if encoding:
                count_last = find_candidates(
                    last_places, last_starts, firsts_last, octave - 1, octave + 1, x - moved_x, y - moved_y,
                    _LAST_RADIUS, candidates_last, keys_last,
                )  # fmt: skip
                near, chosen = _nearest(descriptors, lasts + i, 0, candidates_last, count_last)
                kind = LAST
                count_here = find_candidates(
                    places,
                    octave_starts,
                    firsts_here,
                    octave - 2,
                    octave - 1,
                    x,
                    y,
                    _HERE_RADIUS,
                    candidates_here,
                    keys_here,
                )
                distance, other = _nearest(descriptors, lasts + i, lasts, candidates_here, count_here)
                if distance < near:
                    near, chosen, kind = distance, other, HERE
                if near > MOST_DIFFERING:
                    kind = NO_REFERENCE
            kind = _code_kind(coder, data, model, before, kind)
            before = kind
            if kind == NO_REFERENCE:
                angles[i] = _code_uniform(coder, data, angles[i], angle_bits)
                continue
            if encoding:
                rank = rank_of(
                    chosen, keys_last if kind == LAST else keys_here, count_last if kind == LAST else count_here
                )
            rank = _code_short_length(coder, data, model, _RANKS + 32 * kind, rank)
            if kind == LAST:
                if not encoding:
                    count_last = find_candidates(
                        last_places, last_starts, firsts_last, octave - 1, octave + 1, x - moved_x, y - moved_y,
                        _LAST_RADIUS, candidates_last, keys_last,
                    )  # fmt: skip
                    chosen = candidate_of(rank, keys_last, count_last)
                if chosen < 0:
                    return NO_CANDIDATE
                reference = candidates_last[chosen]
                moved_x += (x - last_places[reference, 0] - moved_x) >> 2
                moved_y += (y - last_places[reference, 1] - moved_y) >> 2
                angle = last_angles[reference]
                sources[i] = reference
            else:
                if not encoding:
                    count_here = find_candidates(
                        places, octave_starts, firsts_here, octave - 2, octave - 1, x, y, _HERE_RADIUS, candidates_here,
                        keys_here,
                    )  # fmt: skip
                    chosen = candidate_of(rank, keys_here, count_here)
                if chosen < 0:
                    return NO_CANDIDATE
                reference = candidates_here[chosen]
                angle = angles[reference]
                sources[i] = sources[reference] if copied[reference] else lasts + reference
            turn = ((angles[i] - angle + half) & mask) - half
            folded = 2 * turn if turn >= 0 else -2 * turn - 1
            folded = _code_length(coder, data, model, _TURNS + 32 * kind, folded)
            turn = -((folded + 1) >> 1) if folded & 1 else folded >> 1
            angles[i] = (angle + turn) & mask
            if like > 0:
                copied[i] = code_adaptive(coder, data, model, _COPIED + kind, 1 if near <= like else 0) == 1
                if encoding and copied[i]:
                    descriptors[lasts + i] = descriptors[sources[i]]
    return 0


@compiled
def code_parts(coder: Any, data: Any, model: Any, parts: Any) -> None:
    """Code or decode the part of its cell, of 16, in which each keypoint lies (N,)."""
    for i in range(parts.shape[0]):
        parts[i] = _code_tree(coder, data, model, _PARTS, parts[i], 4)


@compiled
def code_lengths(coder: Any, data: Any, model: Any, lengths: Any) -> None:
    """Code or decode numbers below 2^31."""
    for k in range(lengths.shape[0]):
        lengths[k] = _code_length(coder, data, model, _LENGTHS, lengths[k])


@compiled
def _code_kind(coder: Any, data: Any, model: Any, before: int, kind: int) -> int:
    first = _KINDS + 3 * before
    if not code_adaptive(coder, data, model, first, 1 if kind != NO_REFERENCE else 0):
        return NO_REFERENCE
    return HERE if code_adaptive(coder, data, model, first + 1, 1 if kind == HERE else 0) else LAST
