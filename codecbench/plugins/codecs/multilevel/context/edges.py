"""The first row and the first column of a block, predicted from the blocks around."""

from __future__ import annotations

from typing import Any

import numpy as np

from codecbench.core.counting.kernel import kernel
from codecbench.plugins.codecs.multilevel.context.binary import MIXING, code_adaptive, code_mixed, code_number
from codecbench.plugins.codecs.multilevel.context.contexts import (
    EDGE_COUNT_SET,
    EDGE_COUNTS,
    EDGE_FLAG_SET,
    EDGE_FLAGS,
    EDGE_SIGNS,
    EDGE_SIZE_SET,
    EDGE_SIZES,
    MAX_INDEX,
    class_of,
    hint_of,
    magnitudes_around,
)


@kernel(_nrt=False)
def edge_prediction(
    indices: Any, block: Any, left: Any, top: Any, corner: Any, right: Any, part: Any, rank: Any, weights: Any
) -> Any:
    """An index of the first row (part 0) or column (part 1) as the blocks around let expect it, in 1/2^12.

    weights: (14, 32) int64, of: the line across in this block (7), the line across of the block beside
    the part (8), the block alongside (7), what is coded of the part (up to 7), three differences of DC.
    """
    along = 1 + 7 * part
    across = 8 - 7 * part
    place = rank * along
    chosen = part * 7 + rank - 1
    other = left if part else top
    same = top if part else left
    total = np.int64(0)
    for step in range(1, 8):
        total += weights[chosen, step - 1] * indices[block, place + step * across]
        total += weights[chosen, step + 14] * indices[same, step * along]
    for step in range(8):
        total += weights[chosen, step + 7] * indices[other, place + step * across]
    for step in range(1, rank):
        total += weights[chosen, step + 21] * indices[block, step * along]
    base = indices[left, 0]
    total += weights[chosen, 29] * (indices[top, 0] - base)
    total += weights[chosen, 30] * (indices[corner, 0] - base)
    return total + weights[chosen, 31] * (indices[right, 0] - indices[top, 0])


@kernel(_nrt=False)
def _before_on_edge(indices: Any, block: Any, place: Any, rank: Any, along: Any, across: Any) -> Any:
    """Magnitudes near a place of the first row or column that are coded before."""
    total = abs(indices[block, place + across])
    if rank > 1:
        total += 2 * abs(indices[block, place - along]) + abs(indices[block, place + across - along])
    if rank > 2:
        total += abs(indices[block, place - 2 * along])
    return total


@kernel(_nrt=False)
def code_edge(
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
    part: Any,
    edge_weights: Any,
) -> Any:
    """The first row (part 0) or column (part 1) of a block without DC; returns whether an index is too large."""
    along = 1 + 7 * part
    across = 8 - 7 * part
    count = 0
    for rank in range(1, 8):
        if indices[block, rank * along] != 0:
            count += 1
    beside = counts[left, 1 + part] + counts[top, 1 + part]
    row_count = counts[block, 1] if part else 0
    inside = class_of(counts[block, 0])
    nearer = counts[top if part == 0 else left, 1 + part]
    number = 0
    while number < 7:
        more = 1 if number < count else 0
        if not code_mixed(
            coder, data, model, weights, EDGE_COUNT_SET + part * 7 + number,
            EDGE_COUNTS + ((part * 10 + inside) * 15 + beside) * 8 + number,
            EDGE_COUNTS + 2400 + ((part * 8 + row_count) * 15 + beside) * 8 + number,
            EDGE_COUNTS + 4320 + ((part * 10 + inside) * 8 + nearer) * 8 + number,
            more,
        ):  # fmt: skip
            break
        number += 1
    counts[block, 1 + part] = number
    mixing = coder[MIXING]
    missing = number
    for rank in range(1, 8):
        if missing == 0:
            break
        place = rank * along
        expected = np.int64(0)
        if mixing:
            expected = edge_prediction(indices, block, left, top, corner, right, part, rank, edge_weights)
        hint = hint_of(expected)
        around = class_of(magnitudes_around(indices, left, top, corner, right, place))
        class_before = 0
        if mixing:
            class_before = class_of(_before_on_edge(indices, block, place, rank, along, across))
        index = np.int64(indices[block, place])
        which = part * 8 + rank
        if missing < 8 - rank:
            nonzero = code_mixed(
                coder, data, model, weights, EDGE_FLAG_SET + part * 7 + rank - 1,
                EDGE_FLAGS + (which * 10 + hint) * 8 + missing,
                EDGE_FLAGS + 1280 + (which * 10 + around) * 8 + missing,
                EDGE_FLAGS + 2560 + (class_before * 10 + hint) * 8 + missing,
                1 if index != 0 else 0,
            )  # fmt: skip
            if not nonzero:
                continue
        missing -= 1
        if not mixing:  # only the sign's context needs it
            expected = edge_prediction(indices, block, left, top, corner, right, part, rank, edge_weights)
            hint = hint_of(expected)
        sign = 1 if expected < 0 else 0
        against = code_adaptive(coder, data, model, EDGE_SIGNS + which * 10 + hint, (1 if index < 0 else 0) ^ sign)
        agrees = 1 - against
        size = code_number(
            coder, data, model, weights, EDGE_SIZE_SET + 14 * agrees,
            EDGE_SIZES + ((agrees * 10 + hint) * 8 + rank) * 15,
            EDGE_SIZES + (160 + around * 8 + rank) * 15,
            EDGE_SIZES + (240 + class_before * 10 + hint) * 15,
            abs(index) - 1,
        )  # fmt: skip
        if size < 0 or size >= MAX_INDEX:
            return True
        indices[block, place] = -1 - size if against ^ sign else 1 + size
    return False
