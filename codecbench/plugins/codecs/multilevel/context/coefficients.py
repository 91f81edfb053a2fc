"""The indices of blocks as binary decisions: the inner 7x7 first, then the first row and the first column, then DC.

The number of nonzero indices of a part is coded before the part, so the number of those left is known at each index.
Contexts are the magnitudes around, those already coded in the block, and the number left. The first row, the first
column and DC are predicted linearly from the blocks above and to the left and from the coded part of the block.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from codecbench.core.counting.kernel import kernel
from codecbench.plugins.codecs.multilevel.context.binary import LIMIT, POSITION
from codecbench.plugins.codecs.multilevel.context.contexts import DC_RESIDUAL
from codecbench.plugins.codecs.multilevel.context.inner import code_inner
from codecbench.plugins.codecs.multilevel.context.outer import code_dc, code_edge

TRUNCATED = -1
BAD_INDEX = -2
MAX_BLOCK_BYTES = 4096
"""Upper bound of a block's size."""


@kernel(nogil=True)
def code_blocks(
    coder: Any,
    data: Any,
    model: Any,
    weights: Any,
    indices: Any,
    first: Any,
    count: Any,
    columns: Any,
    edge_weights: Any,
    dc_weights: Any,
) -> Any:
    """Code blocks in raster order, or decode them; returns 0, TRUNCATED beyond the coder's limit or BAD_INDEX.

    indices: (n + 1, 64) int32 in natural order, the last row zeros; coded, or filled if the coder decodes.
    first, count: the blocks; those before `first` are not used. columns: blocks in a row. edge_weights, dc_weights: of
    `outer.predictors`.
    """
    outside = indices.shape[0] - 1
    counts = np.empty((outside + 1, 4), np.int32)
    counts[outside, :] = 0
    counts[outside, DC_RESIDUAL] = 10
    for block in range(first, first + count):
        if coder[POSITION] > coder[LIMIT]:
            return TRUNCATED
        has_left = block % columns > 0
        has_top = block >= first + columns
        left = block - 1 if has_left else (block - columns if has_top else outside)
        top = block - columns if has_top else left
        corner = block - columns - 1 if has_left and has_top else top
        right = block - columns + 1 if has_top and block % columns < columns - 1 else top
        bad = code_inner(coder, data, model, weights, indices, counts, block, left, top, corner, right)
        for part in range(2):
            bad |= code_edge(
                coder, data, model, weights, indices, counts, block, left, top, corner, right, part, edge_weights
            )
        bad |= code_dc(coder, data, model, weights, indices, counts, block, left, top, corner, right, dc_weights)
        if bad:
            return BAD_INDEX
    return 0
