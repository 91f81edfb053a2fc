"""DC of a block, as what differs from its prediction."""

from __future__ import annotations

from typing import Any

import numpy as np

from codecbench.core.counting.kernel import kernel
from codecbench.plugins.codecs.multilevel.context.binary import code_adaptive, code_mixed, code_number
from codecbench.plugins.codecs.multilevel.context.contexts import (
    DC_FLAGS,
    DC_RESIDUAL,
    DC_SET,
    DC_SIGNS,
    DC_SIZES,
    MAX_INDEX,
    class_of,
)
from codecbench.plugins.codecs.multilevel.context.predictors import PREDICTION_BITS


@kernel(_nrt=False, forceinline=True)
def dc_prediction(indices: Any, block: Any, left: Any, top: Any, corner: Any, right: Any, weights: Any) -> Any:
    """DC as the blocks around and the rest of the block let expect it, in 1/2^12. weights: (31,) int64."""
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
    """DC of a block, as what differs from its prediction; returns whether it is too large."""
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
