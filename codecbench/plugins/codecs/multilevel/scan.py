"""The order in which quantised coefficients enter the minimisation.

`block`: block after block, each in zigzag order. `coefficient`: the DC of all blocks, then the first AC of all
blocks, and so on. Blocks of all planes follow one another.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from codecbench.core.counting.kernel import kernel
from codecbench.core.counting.trace import Trace

Scan = Literal["block", "coefficient"]


def scanned(blocks: NDArray[np.int32], scan: Scan, trace: Trace) -> NDArray[np.int32]:
    """One sequence (64 b,) of blocks (b, 64) in zigzag order; for `block` a view of them."""
    if scan == "block":
        return blocks.reshape(-1)
    values = np.empty((64, blocks.shape[0]), np.int32)
    with trace.stage("scan") as run:
        run(_transpose, blocks, values)
    return values.reshape(-1)


def unscanned(values: NDArray[np.int32], scan: Scan, trace: Trace) -> NDArray[np.int32]:
    """Blocks (b, 64) in zigzag order from what `scanned` returned."""
    if scan == "block":
        return values.reshape(-1, 64)
    blocks = np.empty((values.size // 64, 64), np.int32)
    with trace.stage("scan") as run:
        run(_transpose, values.reshape(64, -1), blocks)
    return blocks


@kernel
def _transpose(source: Any, target: Any) -> None:
    """target[j, i] = source[i, j], in tiles that stay in the first-level cache."""
    rows, columns = source.shape
    for top in range(0, rows, 64):
        for left in range(0, columns, 64):
            for row in range(top, min(top + 64, rows)):
                for column in range(left, min(left + 64, columns)):
                    target[column, row] = source[row, column]
