"""The 8x8 discrete cosine transform on integers, and the lapped transform around it.

The lapped transform filters the 8 samples around each border between blocks before the DCT; the decoder inverts the
filter after it. Products have 12 fractional bits, samples and coefficients 4. All sums fit 32 bits, so the result is
the same everywhere.

Source: Tran, Liang & Tu, "Lapped transform via time-domain pre- and post-filtering" (2003): the filter of 8 points
whose scaling factor is 1.6.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from codecbench.core.counting.kernel import kernel
from codecbench.plugins.codecs.dct.transform import transpose_blocks

FRACTION_BITS = 4
"""Number of fractional bits of coefficients."""
MAX_COEFFICIENT = 49151
"""Limit of the inverse transform's input, in 1/16: three times the largest coefficient of 8-bit samples."""

_BITS = 12
_HALF = 1 << (_BITS - 1)
_C1, _C2, _C3, _C4, _C5, _C6, _C7 = (2009, 1892, 1703, 1448, 1138, 784, 400)
"""cos(k pi / 16) / 2 in 1/4096."""

PRE = np.array(
    [[3476, 2774, 1311, 1351], [-2172, 3347, 2449, 1185], [668, -1337, 4245, 1750], [-164, 366, -298, 4803]],
    dtype=np.int32,
)
POST = np.array(
    [[3201, -2448, 393, -439], [1989, 2562, -2122, -419], [137, 1275, 3071, -1472], [-34, -199, 366, 3418]],
    dtype=np.int32,
)
"""Filter of the differences across a border and its inverse (PRE and POST), in 1/4096."""


@kernel
def forward_transform(plane: Any, lapped: Any, coefficients: Any) -> None:
    """Transform every 8x8 block of a plane.

    plane: (8m, 8n) uint8. lapped: whether borders between blocks are filtered before.
    coefficients: (m * n, 64) int32, filled: in 1/16, blocks in raster order, natural order within a block.
    """
    height, width = plane.shape
    columns = width // 8
    samples = np.empty((height, width), np.int32)
    strip = np.empty((8, width), np.int32)
    turned = np.empty((8, width), np.int32)
    straddling = np.zeros((8, width), np.int32)
    for y in range(height):
        for x in range(width):
            samples[y, x] = (np.int32(plane[y, x]) - 128) << FRACTION_BITS
    if lapped:
        for border in range(8, height, 8):
            _filter_down(samples, border - 4, PRE, strip)
    for block_row in range(height // 8):
        _forward_down(samples, 8 * block_row, strip)
        transpose_blocks(strip, turned)
        if lapped:
            _filter_across(turned, PRE, straddling, strip)
        _forward_down(turned, 0, strip)
        for column in range(columns):
            block = block_row * columns + column
            for v in range(8):
                for u in range(8):
                    coefficients[block, v * 8 + u] = strip[u, column * 8 + v]


@kernel
def inverse_transform(coefficients: Any, lapped: Any, plane: Any) -> None:
    """Transform every block back, round halves up and clamp to 0..255.

    coefficients: (m * n, 64) int32 as `forward_transform` leaves them, up to MAX_COEFFICIENT. plane: (8m, 8n) uint8,
    filled.
    """
    height, width = plane.shape
    columns = width // 8
    samples = np.empty((height, width), np.int32)
    strip = np.empty((8, width), np.int32)
    turned = np.empty((8, width), np.int32)
    straddling = np.zeros((8, width), np.int32)
    for block_row in range(height // 8):
        for column in range(columns):
            block = block_row * columns + column
            for v in range(8):
                for u in range(8):
                    strip[u, column * 8 + v] = coefficients[block, v * 8 + u]
        _inverse_down(strip, turned, 0)
        if lapped:
            _filter_across(turned, POST, straddling, strip)
        transpose_blocks(turned, strip)
        _inverse_down(strip, samples, 8 * block_row)
    if lapped:
        for border in range(8, height, 8):
            _filter_down(samples, border - 4, POST, strip)
    for y in range(height):
        for x in range(width):
            sample = 128 + ((samples[y, x] + 8) >> FRACTION_BITS)
            plane[y, x] = np.uint8(min(max(sample, 0), 255))


@kernel
def _times(factor: Any, value: Any) -> Any:
    """Multiply in 32 bits; compilers would use 64, which vector units multiply slowly."""
    return np.int32(factor * np.int32(value))


@kernel
def _round_product(total: Any) -> Any:
    """Round a sum of products to no fractional bits of its 12, halves up."""
    return np.int32(np.int32(total + _HALF) >> _BITS)


@kernel
def _filter_down(samples: Any, top: Any, matrix: Any, strip: Any) -> None:
    """Filter across the border in the middle of rows top..top+7, in place; strip: (8, W), overwritten.

    Sums across the border stay, differences are multiplied by `matrix` (4, 4), nearest samples first.
    """
    m00, m01, m02, m03 = matrix[0, 0], matrix[0, 1], matrix[0, 2], matrix[0, 3]
    m10, m11, m12, m13 = matrix[1, 0], matrix[1, 1], matrix[1, 2], matrix[1, 3]
    m20, m21, m22, m23 = matrix[2, 0], matrix[2, 1], matrix[2, 2], matrix[2, 3]
    m30, m31, m32, m33 = matrix[3, 0], matrix[3, 1], matrix[3, 2], matrix[3, 3]
    for x in range(strip.shape[1]):
        a0 = samples[top + 3, x]
        a1 = samples[top + 2, x]
        a2 = samples[top + 1, x]
        a3 = samples[top, x]
        b0 = samples[top + 4, x]
        b1 = samples[top + 5, x]
        b2 = samples[top + 6, x]
        b3 = samples[top + 7, x]
        d0 = np.int32(a0 - b0)
        d1 = np.int32(a1 - b1)
        d2 = np.int32(a2 - b2)
        d3 = np.int32(a3 - b3)
        e0 = _round_product(_times(m00, d0) + _times(m01, d1) + _times(m02, d2) + _times(m03, d3))
        e1 = _round_product(_times(m10, d0) + _times(m11, d1) + _times(m12, d2) + _times(m13, d3))
        e2 = _round_product(_times(m20, d0) + _times(m21, d1) + _times(m22, d2) + _times(m23, d3))
        e3 = _round_product(_times(m30, d0) + _times(m31, d1) + _times(m32, d2) + _times(m33, d3))
        strip[3, x] = np.int32(a0 + b0 + e0) >> 1
        strip[2, x] = np.int32(a1 + b1 + e1) >> 1
        strip[1, x] = np.int32(a2 + b2 + e2) >> 1
        strip[0, x] = np.int32(a3 + b3 + e3) >> 1
        strip[4, x] = np.int32(a0 + b0 - e0) >> 1
        strip[5, x] = np.int32(a1 + b1 - e1) >> 1
        strip[6, x] = np.int32(a2 + b2 - e2) >> 1
        strip[7, x] = np.int32(a3 + b3 - e3) >> 1
    # Written to `samples` afterwards: compilers vectorize columns only if the input is not written.
    for y in range(8):
        for x in range(strip.shape[1]):
            samples[top + y, x] = strip[y, x]


@kernel
def _filter_across(turned: Any, matrix: Any, samples: Any, strip: Any) -> None:
    """Filter across the borders of the transposed blocks of an (8, W) strip; `samples`, `strip` overwritten."""
    count = turned.shape[1] - 8
    for y in range(4):
        for x in range(count):
            samples[y, x] = turned[y + 4, x]
        for x in range(count):
            samples[y + 4, x] = turned[y, x + 8]
    _filter_down(samples, 0, matrix, strip)
    for y in range(4):
        for x in range(count):
            turned[y + 4, x] = samples[y, x]
        for x in range(count):
            turned[y, x + 8] = samples[y + 4, x]


@kernel
def _forward_down(samples: Any, top: Any, strip: Any) -> None:
    """Transform down every column of rows top..top+7; strip: (8, W), filled."""
    for x in range(strip.shape[1]):
        s0 = np.int32(samples[top, x] + samples[top + 7, x])
        s1 = np.int32(samples[top + 1, x] + samples[top + 6, x])
        s2 = np.int32(samples[top + 2, x] + samples[top + 5, x])
        s3 = np.int32(samples[top + 3, x] + samples[top + 4, x])
        d0 = np.int32(samples[top, x] - samples[top + 7, x])
        d1 = np.int32(samples[top + 1, x] - samples[top + 6, x])
        d2 = np.int32(samples[top + 2, x] - samples[top + 5, x])
        d3 = np.int32(samples[top + 3, x] - samples[top + 4, x])
        strip[0, x] = _round_product(_times(_C4, s0 + s1 + s2 + s3))
        strip[4, x] = _round_product(_times(_C4, s0 - s1 - s2 + s3))
        strip[2, x] = _round_product(_times(_C2, s0 - s3) + _times(_C6, s1 - s2))
        strip[6, x] = _round_product(_times(_C6, s0 - s3) - _times(_C2, s1 - s2))
        strip[1, x] = _round_product(_times(_C1, d0) + _times(_C3, d1) + _times(_C5, d2) + _times(_C7, d3))
        strip[3, x] = _round_product(_times(_C3, d0) - _times(_C7, d1) - _times(_C1, d2) - _times(_C5, d3))
        strip[5, x] = _round_product(_times(_C5, d0) - _times(_C1, d1) + _times(_C7, d2) + _times(_C3, d3))
        strip[7, x] = _round_product(_times(_C7, d0) - _times(_C5, d1) + _times(_C3, d2) - _times(_C1, d3))


@kernel
def _inverse_down(strip: Any, samples: Any, top: Any) -> None:
    """Transform every column of an (8, W) strip back into rows top..top+7."""
    for x in range(strip.shape[1]):
        c0 = strip[0, x]
        c1 = strip[1, x]
        c2 = strip[2, x]
        c3 = strip[3, x]
        c4 = strip[4, x]
        c5 = strip[5, x]
        c6 = strip[6, x]
        c7 = strip[7, x]
        outer = _times(_C4, c0 + c4)
        inner = _times(_C4, c0 - c4)
        steep = np.int32(_times(_C2, c2) + _times(_C6, c6))
        flat = np.int32(_times(_C6, c2) - _times(_C2, c6))
        o0 = np.int32(_times(_C1, c1) + _times(_C3, c3) + _times(_C5, c5) + _times(_C7, c7))
        o1 = np.int32(_times(_C3, c1) - _times(_C7, c3) - _times(_C1, c5) - _times(_C5, c7))
        o2 = np.int32(_times(_C5, c1) - _times(_C1, c3) + _times(_C7, c5) + _times(_C3, c7))
        o3 = np.int32(_times(_C7, c1) - _times(_C5, c3) + _times(_C3, c5) - _times(_C1, c7))
        samples[top, x] = _round_product(outer + steep + o0)
        samples[top + 7, x] = _round_product(outer + steep - o0)
        samples[top + 1, x] = _round_product(inner + flat + o1)
        samples[top + 6, x] = _round_product(inner + flat - o1)
        samples[top + 2, x] = _round_product(inner - flat + o2)
        samples[top + 5, x] = _round_product(inner - flat - o2)
        samples[top + 3, x] = _round_product(outer - steep + o3)
        samples[top + 4, x] = _round_product(outer - steep - o3)
