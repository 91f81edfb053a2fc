"""Quantized blocks of a plane and back, shared by JPEG and the multi-level codec.

The quantizer is the uniform one of T.81 (A.3.4), the zigzag scan that of A.3.6. Each step is a stage of the trace and
a kernel, so that operations are counted step by step. Planes are processed in stripes that fit the cache, which also
bounds the memory for large planes.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from codecbench.core.counting.kernel import kernel
from codecbench.core.counting.trace import NULL_TRACE, Trace
from codecbench.plugins.codecs.dct.planes import Plane
from codecbench.plugins.codecs.dct.tables import ZIGZAG
from codecbench.plugins.codecs.dct.transform import forward_dct, inverse_dct

Blocks = NDArray[np.int32]

_STRIPE_BLOCKS = 2400
"""Half a 640x480 plane: 0.6 MB of coefficients and as much of indices. The C library may return larger buffers to the
system when they are freed; mapping their pages anew each time takes longer than all the transforms."""


def blocks_from_plane(
    plane: Plane,
    steps: NDArray[np.float32],
    shift: float = 0.0,
    *,
    out: Blocks | None = None,
    trace: Trace = NULL_TRACE,
) -> Blocks:
    """Transform and quantize a plane.

    plane: (8m, 8n) uint8. steps: (64,) float32, natural order. shift: subtracted from every sample.
    Returns (m * n, 64) int32, in `out` if given: blocks in raster order, zigzag order within a block.
    """
    blocks = np.empty((plane.size // 64, 64), np.int32) if out is None else out
    coefficients, natural = _stripe_buffers(plane.shape)
    for rows, part in _stripes(plane.shape):
        count = part.stop - part.start
        with trace.stage("dct") as run:
            run(forward_dct, plane[rows], np.float32(shift), coefficients[:count])
        with trace.stage("quantization") as run:
            run(quantise, coefficients[:count], steps, natural[:count])
        with trace.stage("zigzag") as run:
            run(zigzag, natural[:count], blocks[part])
    return blocks


def plane_from_blocks(
    blocks: Blocks,
    shape: tuple[int, int],
    steps: NDArray[np.float32],
    shift: float = 0.0,
    *,
    trace: Trace = NULL_TRACE,
) -> Plane:
    """Reconstruct the plane of shape (8m, 8n) from quantized blocks; the inverse of `blocks_from_plane`."""
    plane = np.empty(shape, np.uint8)
    coefficients, natural = _stripe_buffers(shape)
    for rows, part in _stripes(shape):
        count = part.stop - part.start
        with trace.stage("zigzag") as run:
            run(inverse_zigzag, blocks[part], natural[:count])
        with trace.stage("dequantization") as run:
            run(dequantise, natural[:count], steps, coefficients[:count])
        with trace.stage("idct") as run:
            run(inverse_dct, coefficients[:count], np.float32(shift), plane[rows])
    return plane


def _stripe_rows(shape: tuple[int, ...]) -> int:
    """Number of block rows in a stripe."""
    return min(max(_STRIPE_BLOCKS // (shape[1] // 8), 1), shape[0] // 8)


def _stripe_buffers(shape: tuple[int, ...]) -> tuple[NDArray[np.float32], Blocks]:
    size = (_stripe_rows(shape) * (shape[1] // 8), 64)
    return np.empty(size, np.float32), np.empty(size, np.int32)


def _stripes(shape: tuple[int, ...]) -> Iterator[tuple[slice, slice]]:
    """Yield the sample rows and the blocks of each stripe."""
    columns = shape[1] // 8
    block_rows = shape[0] // 8
    step = _stripe_rows(shape)
    for top in range(0, block_rows, step):
        bottom = min(top + step, block_rows)
        yield slice(top * 8, bottom * 8), slice(top * columns, bottom * columns)


_ALMOST_HALF = np.float32(0.49999997)
"""The largest float32 below 0.5: added before truncation, it rounds every float32 half away from zero, while 0.5
would also carry 0.49999997 to 1."""


@kernel(error_model="numpy")
def quantise(coefficients: Any, steps: Any, indices: Any) -> None:
    """Compute q = round(C / step), halves away from zero.

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
    """Compute C = q * step; shapes as in `quantise`, `coefficients` filled."""
    for block in range(indices.shape[0]):
        for place in range(64):
            coefficients[block, place] = np.float32(indices[block, place]) * steps[place]


@kernel
def zigzag(natural: Any, scanned: Any) -> None:
    """Reorder each block from natural to zigzag order; both (blocks, 64), `scanned` filled."""
    for block in range(natural.shape[0]):
        for rank in range(64):
            scanned[block, rank] = natural[block, ZIGZAG[rank]]


@kernel
def inverse_zigzag(scanned: Any, natural: Any) -> None:
    """Reorder each block from zigzag to natural order; both (blocks, 64), `natural` filled."""
    for block in range(scanned.shape[0]):
        for rank in range(64):
            natural[block, ZIGZAG[rank]] = scanned[block, rank]
