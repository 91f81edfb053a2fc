"""The inner 7x7 indices of a block: the number of nonzero ones, then each in zigzag order."""

from __future__ import annotations

from typing import Any

import numpy as np

from codecbench.core.counting.kernel import kernel
from codecbench.plugins.codecs.multilevel.context.binary import MIXING, code_adaptive, code_bit, code_mixed, code_number
from codecbench.plugins.codecs.multilevel.context.contexts import (
    FLAG_SET,
    INNER,
    INNER_FLAGS,
    INNER_SIZES,
    LENGTH,
    LENGTH_BITS,
    LENGTH_SET,
    MAX_INDEX,
    SHARES,
    SIZE_SET,
    ZONES,
    class_of,
    magnitudes_around,
)


@kernel(_nrt=False, forceinline=True)
def _count_nonzero(indices: Any, block: Any) -> Any:
    count = 0
    for rank in range(49):
        if indices[block, INNER[rank]] != 0:
            count += 1
    return count


@kernel(_nrt=False)
def _code_inner_count(
    coder: Any, data: Any, model: Any, weights: Any, counts: Any, left: Any, top: Any, count: Any
) -> Any:
    """Code the number of nonzero inner indices: its length in bits, then its bits below the first."""
    class_left = class_of(counts[left, 0])
    class_top = class_of(counts[top, 0])
    class_mean = class_of((counts[left, 0] + counts[top, 0] + 1) >> 1)
    edges_left = min(2, counts[left, 1] + counts[left, 2])
    edges_top = min(2, counts[top, 1] + counts[top, 2])
    first = LENGTH + (class_left * 10 + class_top) * 8
    second = LENGTH + 800 + (class_mean * 3 + edges_left) * 8
    third = LENGTH + 1040 + (class_mean * 3 + edges_top) * 8
    length = 0
    while length < 6:
        more = 1 if count >> length > 0 else 0
        if not code_mixed(
            coder, data, model, weights, LENGTH_SET + length, first + length, second + length, third + length, more
        ):
            break
        length += 1
    if length < 2:
        return length
    value = 1
    for place in range(length - 2, -1, -1):
        value = (value << 1) | code_adaptive(coder, data, model, LENGTH_BITS + value, (count >> place) & 1)
    return value


@kernel(_nrt=False)
def _magnitudes_before(indices: Any, block: Any, place: Any) -> Any:
    """Sum the inner magnitudes near a place at lower frequencies, which are coded before it."""
    row = place >> 3
    column = place & 7
    total = 0
    if row > 1:
        total += 2 * abs(indices[block, place - 8])
    if column > 1:
        total += 2 * abs(indices[block, place - 1])
    if row > 1 and column > 1:
        total += abs(indices[block, place - 9])
    if column > 2:
        total += abs(indices[block, place - 2])
    if row > 2:
        total += abs(indices[block, place - 16])
    return total


@kernel(_nrt=False)
def code_inner(
    coder: Any,
    data: Any,
    model: Any,
    weights: Any,
    indices: Any,
    counts: Any,
    block: Any,
    left: Any,
    top: Any,
    corner: Any,
    right: Any,
) -> Any:
    """Code the inner part of a block in zigzag order; returns whether an index is too large."""
    count = _code_inner_count(coder, data, model, weights, counts, left, top, _count_nonzero(indices, block))
    counts[block, 0] = count
    if count > 49:
        return True
    mixing = coder[MIXING]
    missing = count
    excess = 0
    for rank in range(49):
        if missing == 0:
            break
        place = np.int64(INNER[rank])
        around = magnitudes_around(indices, left, top, corner, right, place)
        before = _magnitudes_before(indices, block, place) if mixing else 0
        class_around = class_of(around)
        class_before = class_of(before)
        class_missing = class_of(missing)
        index = np.int64(indices[block, place])
        if missing < 49 - rank:
            share = np.int64(SHARES[missing, rank])
            nonzero = code_mixed(
                coder, data, model, weights, FLAG_SET + rank,
                INNER_FLAGS + rank * 12 + share,
                INNER_FLAGS + 588 + (rank * 10 + class_around) * 10 + class_missing,
                INNER_FLAGS + 5488 + (class_around * 10 + class_before) * 6 + min(share, 5),
                1 if index != 0 else 0,
            )  # fmt: skip
            if not nonzero:
                continue
        missing -= 1
        if not mixing:
            before = _magnitudes_before(indices, block, place)
            class_before = class_of(before)
        negative = code_bit(coder, data, 32768, 1 if index < 0 else 0)
        zone = np.int64(ZONES[rank])
        together = min(class_of(around + before) * 4 + zone, 169)
        size = code_number(
            coder, data, model, weights, SIZE_SET + 14 * zone,
            INNER_SIZES + ((zone * 10 + class_around) * 10 + class_missing) * 15,
            INNER_SIZES + (400 + class_before * 10 + class_of(missing + excess)) * 15,
            INNER_SIZES + (500 + together) * 15,
            abs(index) - 1,
        )  # fmt: skip
        if size < 0 or size >= MAX_INDEX:
            return True
        excess += size
        indices[block, place] = -1 - size if negative else 1 + size
    return False
