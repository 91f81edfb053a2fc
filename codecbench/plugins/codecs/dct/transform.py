"""The orthonormal 8x8 discrete cosine transform of T.81 (A.3.3), forward and inverse, in single precision.

The one-dimensional transform is that of Arai, Agui and Nakajima (1988): 5 multiplications and 29 additions
for 8 points, and one more multiplication per coefficient to make it orthonormal. The order of evaluation is
fixed and nothing is contracted, so results are the same on every machine with IEEE 754 arithmetic.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from codecbench.core.counting.kernel import kernel

_C6 = np.float32(np.cos(3 * np.pi / 8))
_C4 = np.float32(np.sqrt(0.5))
_C2_MINUS_C6 = np.float32(np.cos(np.pi / 8) - np.cos(3 * np.pi / 8))
_C2_PLUS_C6 = np.float32(np.cos(np.pi / 8) + np.cos(3 * np.pi / 8))
_SQRT2 = np.float32(np.sqrt(2.0))
_TWO_C2 = np.float32(2 * np.cos(np.pi / 8))
_TWO_C2_MINUS_C6 = np.float32(2 * (np.cos(np.pi / 8) - np.cos(3 * np.pi / 8)))
_TWO_C2_PLUS_C6 = np.float32(2 * (np.cos(np.pi / 8) + np.cos(3 * np.pi / 8)))
_BLACK = np.float32(0)
_HALF = np.float32(0.5)
_WHITE = np.float32(255)


def _scales(power: int) -> NDArray[np.float32]:
    """Factors that complete the fast transform, one per coefficient in natural order."""
    scales = np.sqrt(2.0) * np.cos(np.arange(8) * np.pi / 16)
    scales[0] = 1.0
    return (np.outer(scales, scales) ** power / 8).astype(np.float32).reshape(64)


_FORWARD_SCALES = _scales(-1)
_INVERSE_SCALES = _scales(1)


@kernel
def _forward_8(a0: Any, a1: Any, a2: Any, a3: Any, a4: Any, a5: Any, a6: Any, a7: Any) -> Any:
    """Transform eight samples to eight scaled DCT coefficients."""
    t0 = a0 + a7
    t7 = a0 - a7
    t1 = a1 + a6
    t6 = a1 - a6
    t2 = a2 + a5
    t5 = a2 - a5
    t3 = a3 + a4
    t4 = a3 - a4
    e0 = t0 + t3
    e3 = t0 - t3
    e1 = t1 + t2
    e2 = t1 - t2
    e = (e2 + e3) * _C4
    o0 = t4 + t5
    o1 = t5 + t6
    o2 = t6 + t7
    o = (o0 - o2) * _C6
    z2 = _C2_MINUS_C6 * o0 + o
    z4 = _C2_PLUS_C6 * o2 + o
    z3 = o1 * _C4
    z5 = t7 + z3
    z6 = t7 - z3
    return e0 + e1, z5 + z4, e3 + e, z6 - z2, e0 - e1, z6 + z2, e3 - e, z5 - z4


@kernel
def _inverse_8(c0: Any, c1: Any, c2: Any, c3: Any, c4: Any, c5: Any, c6: Any, c7: Any) -> Any:
    """Transform eight scaled DCT coefficients back to eight samples."""
    e0 = c0 + c4
    e1 = c0 - c4
    e3 = c2 + c6
    e2 = (c2 - c6) * _SQRT2 - e3
    t0 = e0 + e3
    t3 = e0 - e3
    t1 = e1 + e2
    t2 = e1 - e2
    z3 = c5 + c3
    z0 = c5 - c3
    z1 = c1 + c7
    z2 = c1 - c7
    t7 = z1 + z3
    o1 = (z1 - z3) * _SQRT2
    z5 = (z0 + z2) * _TWO_C2
    o0 = z5 - z2 * _TWO_C2_MINUS_C6
    o2 = z5 - z0 * _TWO_C2_PLUS_C6
    t6 = o2 - t7
    t5 = o1 - t6
    t4 = o0 - t5
    return t0 + t7, t1 + t6, t2 + t5, t3 + t4, t3 - t4, t2 - t5, t1 - t6, t0 - t7


@kernel
def forward_dct(plane: Any, shift: Any, coefficients: Any) -> None:
    """Transform every 8x8 block of a plane.

    plane: (8m, 8n) uint8. shift: float32 subtracted from every sample (128 is T.81's level shift).
    coefficients: (m * n, 64) float32, filled; blocks in raster order, natural order within a block.
    """
    width = plane.shape[1]
    columns = width // 8
    source = np.empty((8, width), np.float32)
    target = np.empty((8, width), np.float32)
    for block_row in range(plane.shape[0] // 8):
        for y in range(8):
            for x in range(width):
                source[y, x] = np.float32(plane[block_row * 8 + y, x]) - shift
        _forward_down(source, target)
        transpose_blocks(target, source)
        _forward_down(source, target)
        for column in range(columns):
            block = block_row * columns + column
            for v in range(8):
                for u in range(8):
                    coefficients[block, v * 8 + u] = target[u, column * 8 + v] * _FORWARD_SCALES[v * 8 + u]


@kernel
def inverse_dct(coefficients: Any, shift: Any, plane: Any) -> None:
    """Transform every block back, add `shift`, clamp to 0..255 and round halves up.

    coefficients: (m * n, 64) float32 as `forward_dct` leaves them. plane: (8m, 8n) uint8, filled.
    """
    width = plane.shape[1]
    columns = width // 8
    source = np.empty((8, width), np.float32)
    target = np.empty((8, width), np.float32)
    for block_row in range(plane.shape[0] // 8):
        for column in range(columns):
            block = block_row * columns + column
            for v in range(8):
                for u in range(8):
                    source[u, column * 8 + v] = coefficients[block, v * 8 + u] * _INVERSE_SCALES[v * 8 + u]
        _inverse_down(source, target)
        transpose_blocks(target, source)
        _inverse_down(source, target)
        for y in range(8):
            for x in range(width):
                sample = target[y, x] + shift
                plane[block_row * 8 + y, x] = np.uint8(min(max(sample, _BLACK), _WHITE) + _HALF)


@kernel
def transpose_blocks(source: Any, target: Any) -> None:
    """Transpose every 8x8 block of an (8, 8n) strip."""
    for left in range(0, source.shape[1], 8):
        for y in range(8):
            for x in range(8):
                target[x, left + y] = source[y, left + x]


@kernel
def _forward_down(source: Any, target: Any) -> None:
    """Transform every column of an (8, W) strip."""
    for x in range(source.shape[1]):
        (
            target[0, x], target[1, x], target[2, x], target[3, x],
            target[4, x], target[5, x], target[6, x], target[7, x],
        ) = _forward_8(
            source[0, x], source[1, x], source[2, x], source[3, x],
            source[4, x], source[5, x], source[6, x], source[7, x],
        )  # fmt: skip


@kernel
def _inverse_down(source: Any, target: Any) -> None:
    """Transform every column of an (8, W) strip back."""
    for x in range(source.shape[1]):
        (
            target[0, x], target[1, x], target[2, x], target[3, x],
            target[4, x], target[5, x], target[6, x], target[7, x],
        ) = _inverse_8(
            source[0, x], source[1, x], source[2, x], source[3, x],
            source[4, x], source[5, x], source[6, x], source[7, x],
        )  # fmt: skip
