"""Quantised blocks from a plane and back: the part that JPEG and the multi-level codec have in common.

Each step is a stage of the trace and a kernel of its own, so that operations can be counted step by step.
Planes go through in stripes that fit the cache, which also bounds the memory that large planes take.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from codecbench.core.counting.trace import NULL_TRACE, Trace
from codecbench.plugins.codecs.dct.planes import Plane
from codecbench.plugins.codecs.dct.quantisation import dequantise, inverse_zigzag, quantise, zigzag
from codecbench.plugins.codecs.dct.transform import forward_dct, inverse_dct

Blocks = NDArray[np.int32]

_STRIPE_BLOCKS = 2400
"""Half a 640x480 plane: 0.6 MB of coefficients and as much of indices. Buffers of a whole one together may be more than
the C library keeps when they are freed; fetching their pages anew each time takes longer than all the transforms."""


def blocks_from_plane(
    plane: Plane,
    steps: NDArray[np.float32],
    shift: float = 0.0,
    *,
    out: Blocks | None = None,
    trace: Trace = NULL_TRACE,
) -> Blocks:
    """Quantised DCT coefficients of a plane.

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
    """The plane of shape (8m, 8n) that quantised blocks stand for; the inverse of `blocks_from_plane`."""
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
    """Block rows in a stripe."""
    return min(max(_STRIPE_BLOCKS // (shape[1] // 8), 1), shape[0] // 8)


def _stripe_buffers(shape: tuple[int, ...]) -> tuple[NDArray[np.float32], Blocks]:
    size = (_stripe_rows(shape) * (shape[1] // 8), 64)
    return np.empty(size, np.float32), np.empty(size, np.int32)


def _stripes(shape: tuple[int, ...]) -> Iterator[tuple[slice, slice]]:
    """Sample rows and blocks of each stripe."""
    columns = shape[1] // 8
    block_rows = shape[0] // 8
    step = _stripe_rows(shape)
    for top in range(0, block_rows, step):
        bottom = min(top + step, block_rows)
        yield slice(top * 8, bottom * 8), slice(top * columns, bottom * columns)
