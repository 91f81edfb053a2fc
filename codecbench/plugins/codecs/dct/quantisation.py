"""The uniform quantiser of T.81 (A.3.4) and the zigzag scan of a block (A.3.6)."""

from __future__ import annotations

from typing import Any

import numpy as np

from codecbench.core.counting.kernel import kernel
from codecbench.plugins.codecs.dct.tables import ZIGZAG

_ALMOST_HALF = np.float32(0.49999997)
"""The largest float32 below 0.5: added before truncation, it rounds every float32 half away from zero, while 0.5
would also carry 0.49999997 to 1."""


@kernel(error_model="numpy")
def quantise(coefficients: Any, steps: Any, indices: Any) -> None:
    """Index q = round(C / step), halves away from zero.

    coefficients: (blocks, 64) float32. steps: (64,) float32, in the same order, with |C| / step below 2^31.
    indices: (blocks, 64) int32, filled.
    """
    # Steps are positive: checking each for zero, as Python's division would, takes four times as long.
    for block in range(coefficients.shape[0]):
        for place in range(64):
            # A true division: a product with 1 / step would move coefficients that lie half way.
            ratio = coefficients[block, place] / steps[place]
            margin = _ALMOST_HALF if ratio >= 0 else -_ALMOST_HALF
            indices[block, place] = np.int32(ratio + margin)


@kernel
def dequantise(indices: Any, steps: Any, coefficients: Any) -> None:
    """Coefficient C = q * step; shapes as in `quantise`, `coefficients` filled."""
    for block in range(indices.shape[0]):
        for place in range(64):
            coefficients[block, place] = np.float32(indices[block, place]) * steps[place]


@kernel
def zigzag(natural: Any, scanned: Any) -> None:
    """Zigzag order from natural order, block by block; both (blocks, 64), `scanned` filled."""
    for block in range(natural.shape[0]):
        for rank in range(64):
            scanned[block, rank] = natural[block, ZIGZAG[rank]]


@kernel
def inverse_zigzag(scanned: Any, natural: Any) -> None:
    """Natural order from zigzag order, block by block; both (blocks, 64), `natural` filled."""
    for block in range(scanned.shape[0]):
        for rank in range(64):
            natural[block, ZIGZAG[rank]] = scanned[block, rank]
