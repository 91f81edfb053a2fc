"""The first row, the first column and DC of a block, predicted linearly from the blocks around and the coded part.

The weights are in 1/2^12. Those in `predictors.npz` are for equal steps; for other tables they are scaled by the ratio
of the steps. `docs/context_training.py` fits them by least squares over other images.
"""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from codecbench.core.counting.kernel import kernel
from codecbench.plugins.codecs.dct.tables import Table
from codecbench.plugins.codecs.multilevel.context.binary import MIXING, code_adaptive, code_mixed, code_number
from codecbench.plugins.codecs.multilevel.context.contexts import (
    DC_FLAGS,
    DC_RESIDUAL,
    DC_SET,
    DC_SIGNS,
    DC_SIZES,
    EDGE_COUNT_SET,
    EDGE_COUNTS,
    EDGE_FLAG_SET,
    EDGE_FLAGS,
    EDGE_SIGNS,
    EDGE_SIZE_SET,
    EDGE_SIZES,
    MAX_INDEX,
    class_of,
    classes,
    magnitudes_around,
)

PREDICTION_BITS = 12
_MAX_WEIGHT = 1 << 24

PREDICTORS_FILE = Path(__file__).with_name("predictors.npz")
"""For unfiltered and filtered block borders: edges (2, 14, 32) and dc (2, 31) int16."""

DC_PLACES = np.concatenate([[0, 0, 0], *2 * [np.arange(1, 8), 8 * np.arange(1, 8)]]).astype(np.int64)

_LAST_PREDICTION = 319
_PREDICTIONS = classes((3, 6, 10, 16, 24, 40, 70, 140, 280), 1 + _LAST_PREDICTION)
"""Class of an expected index in twentieths."""


def predictors(table: Table, lapped: bool) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the weights of the first row and column (14, 32) and of DC (31,) for a quantization table."""
    edges, dc = (weights[int(lapped)] for weights in _load_weights())
    steps = table.reshape(64).astype(np.int64)
    scaled = np.stack([_scale_weights(edges[row], steps, *edge_places(row)) for row in range(14)])
    return scaled, _scale_weights(dc, steps, DC_PLACES, 0)


@functools.cache
def _load_weights() -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    with np.load(PREDICTORS_FILE) as file:
        return file["edges"].astype(np.int64), file["dc"].astype(np.int64)


def _scale_weights(
    weights: NDArray[np.int64], steps: NDArray[np.int64], places: NDArray[np.int64], place: int
) -> NDArray[np.int64]:
    """Scale weights of indices at `places` for the index at `place`, halves up."""
    ratios = 2 * weights * steps[places] + steps[place]
    return np.asarray(np.clip(ratios // (2 * steps[place]), -_MAX_WEIGHT, _MAX_WEIGHT), np.int64)


def edge_places(row: int) -> tuple[NDArray[np.int64], int]:
    """Return the places of the predicting indices of a row of weights, and the place of the predicted one."""
    part, rank = divmod(row, 7)
    along, across = (8, 1) if part else (1, 8)
    place = (rank + 1) * along
    steps = np.arange(1, 8)
    lines = (place + steps * across, place + np.arange(8) * across, steps * along, steps * along, np.zeros(3, np.int64))
    return np.concatenate(lines), place


@kernel(_nrt=False, forceinline=True)
def hint_of(expected: Any) -> Any:
    """Return the class of an expected index in 1/2^12."""
    return np.int64(_PREDICTIONS[min((abs(expected) * 20) >> PREDICTION_BITS, _LAST_PREDICTION)])


@kernel(_nrt=False)
def edge_prediction(
    indices: Any, block: Any, left: Any, top: Any, corner: Any, right: Any, part: Any, rank: Any, weights: Any
) -> Any:
    """Predict an index of the first row (part 0) or column (part 1), in 1/2^12.

    weights: (14, 32) int64, of: the line across in this block (7), the line across of the block beside the part (8),
    the block alongside (7), the coded indices of the part (up to 7), three differences of DC.
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
def _magnitudes_before(indices: Any, block: Any, place: Any, rank: Any, along: Any, across: Any) -> Any:
    """Sum the magnitudes near a place of the first row or column that are coded before it."""
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
    """Code the first row (part 0) or column (part 1) of a block without DC; returns whether an index is too large."""
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
            class_before = class_of(_magnitudes_before(indices, block, place, rank, along, across))
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


@kernel(_nrt=False, forceinline=True)
def dc_prediction(indices: Any, block: Any, left: Any, top: Any, corner: Any, right: Any, weights: Any) -> Any:
    """Predict DC from the blocks around and the rest of the block, in 1/2^12. weights: (31,) int64."""
    base = np.int64(indices[left, 0])
    total = base << PREDICTION_BITS
    total += weights[0] * (indices[top, 0] - base) + weights[1] * (indices[corner, 0] - base)
    total += weights[2] * (indices[right, 0] - indices[top, 0])
    for step in range(1, 8):
        total += weights[step + 2] * indices[left, step] + weights[step + 9] * indices[top, 8 * step]
        total += weights[step + 16] * indices[block, step] + weights[step + 23] * indices[block, 8 * step]
    return total


@kernel(_nrt=False)
def code_dc(
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
    dc_weights: Any,
) -> Any:
    """Code DC of a block as the difference from its prediction; returns whether it is too large."""
    expected = dc_prediction(indices, block, left, top, corner, right, dc_weights)
    nearest = (expected + (1 << (PREDICTION_BITS - 1))) >> PREDICTION_BITS
    nearest = min(max(nearest, -MAX_INDEX), MAX_INDEX)
    fifth = min(max(((expected - (nearest << PREDICTION_BITS) + 2048) * 5) >> PREDICTION_BITS, 0), 4)
    residual = indices[block, 0] - nearest
    active = 0
    for step in range(1, 4):
        active += abs(indices[block, step]) + abs(indices[block, 8 * step])
    steep = abs(indices[left, 0] - indices[top, 0]) + abs(indices[top, 0] - indices[corner, 0])
    unsure = class_of(counts[left, DC_RESIDUAL] + counts[top, DC_RESIDUAL])
    class_active = class_of(active)
    class_steep = class_of(steep)
    differs = code_mixed(
        coder, data, model, weights, DC_SET,
        DC_FLAGS + unsure * 10 + class_active,
        DC_FLAGS + 100 + class_steep * 10 + class_active,
        DC_FLAGS + 200 + unsure * 5 + fifth,
        1 if residual != 0 else 0,
    )  # fmt: skip
    counts[block, DC_RESIDUAL] = 0
    if not differs:
        indices[block, 0] = nearest
        return False
    negative = code_adaptive(coder, data, model, DC_SIGNS + fifth, 1 if residual < 0 else 0)
    toward = 1 if negative == (1 if fifth < 2 else 0) else 0
    size = code_number(
        coder, data, model, weights, DC_SET + 1,
        DC_SIZES + (unsure * 10 + class_active) * 15,
        DC_SIZES + (100 + class_steep * 10 + class_active) * 15,
        DC_SIZES + (200 + unsure * 2 + toward) * 15,
        abs(residual) - 1,
    )  # fmt: skip
    residual = -1 - size if negative else 1 + size
    index = nearest + residual
    if size < 0 or abs(index) > MAX_INDEX:
        return True
    counts[block, DC_RESIDUAL] = 1 + size
    indices[block, 0] = index
    return False
