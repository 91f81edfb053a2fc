"""Compiled kernels of feature extraction: corners, orientation, smoothing, descriptors, cell index."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from codecbench.core.kernels.compiled import compiled
from codecbench.slam.features.corner_kernels import list_corners, refine_corner, score_corners, spans
from codecbench.slam.features.sorting import stable_order
from codecbench.slam.thresholds import (
    BLUR_SIGMA_PX,
    BORDER_PX,
    FAST_CANDIDATES_PER_FEATURE,
    FAST_THRESHOLD,
    FAST_THRESHOLD_LOW,
    PATCH_RADIUS_PX,
)

_RADIUS = PATCH_RADIUS_PX
_COLUMNS = 2 * (_RADIUS + 1)  # even, for whole vectors: the last column is in no disc
_HALF_WIDTHS = np.array([int(math.sqrt(_RADIUS * _RADIUS - v * v) + 0.5) for v in range(_RADIUS + 1)])
_DISC = (np.abs(np.arange(_COLUMNS) - _RADIUS) <= _HALF_WIDTHS[:, None]).astype(np.int16)  # rows 0.._RADIUS
_GAUSSIAN = np.exp(-0.5 * (np.arange(-3, 4) / BLUR_SIGMA_PX) ** 2)
_SIDE = tuple(np.uint16(w) for w in np.rint(256.0 * _GAUSSIAN[:3] / _GAUSSIAN.sum()))  # 256ths, the outermost first
_CENTER = np.uint16(256 - 2 * sum(int(w) for w in _SIDE))


@compiled
def find_corners(level: Any, quota: int, scores: Any) -> Any:
    """Return at most `quota` corners of a level: pixels x, y (N, 2), and offsets from the pixels' centers (N, 2).

    If the high threshold leaves too few to choose from, the low one is used. `scores` is an image of the level's size
    that is overwritten.
    """
    score_corners(level, scores)
    threshold = FAST_THRESHOLD
    corners, corner_scores = list_corners(scores, threshold)
    if len(corners) < FAST_CANDIDATES_PER_FEATURE * quota:
        threshold = FAST_THRESHOLD_LOW
        corners, corner_scores = list_corners(scores, threshold)
    height, width = level.shape
    chosen = select_evenly(corners, corner_scores, threshold, quota, height, width, BORDER_PX)
    pixels, offsets = np.empty((len(chosen), 2), np.int64), np.empty((len(chosen), 2))
    for i in range(len(chosen)):
        x, y = corners[chosen[i], 0], corners[chosen[i], 1]
        pixels[i, 0], pixels[i, 1] = x, y
        refine_corner(scores, x, y, offsets[i])
    return pixels, offsets


@compiled
def describe_corners(
    level: Any, corners: Any, offsets: Any, ratio: Any, blurred: Any, pixels: Any, angles: Any, descriptors: Any
) -> None:
    """Fill `pixels` (N, 2) in the image, `angles` (N,) and `descriptors` (N, 32) of the corners (N, 2) of a level.

    `offsets` (N, 2) are the corners' distances from their pixels' centers; angles and descriptors are of these centers.
    `ratio` (2,) is the image's size over the level's; `blurred` is an image of the level's size that is overwritten.
    The pyramid maps pixel areas, not pixel centers: a center moves by half a pixel of each level.
    """
    if len(corners) == 0:
        return  # the level may be smaller than the smoothing is wide
    for i in range(len(corners)):
        for k in range(2):
            pixels[i, k] = (corners[i, k] + offsets[i, k] + 0.5) * ratio[k] - 0.5
    orient_patches(level, corners, angles)
    blur_level(level, blurred)
    describe_patches(blurred, corners, angles, descriptors)


@compiled
def select_evenly(corners: Any, scores: Any, threshold: int, quota: int, height: int, width: int, border: int) -> Any:
    """Return the indices of at most `quota` corners (N, 2), spread over the level, in reading order.

    Only corners whose `scores` (N,), uint8, exceed `threshold` are taken. The level is divided into about `quota`
    square cells. Corners are taken by their rank within their cell, the strongest of every cell first. The rank that
    does not fit whole is taken by score. Ties go to reading order.
    """
    inner_width, inner_height = width - 2 * border, height - 2 * border
    if inner_width < 1 or inner_height < 1 or quota < 1:
        return np.empty(0, np.int64)
    side = max(math.sqrt(inner_width * inner_height / quota), 1.0)
    columns = int(inner_width / side) + 1
    inside = np.empty(len(corners), np.int64)
    cells = np.empty(len(corners), np.int64)
    weakness = np.empty(len(corners), np.int64)
    count = 0
    for i in range(len(corners)):
        x, y = corners[i, 0] - border, corners[i, 1] - border
        if scores[i] > threshold and 0 <= x < inner_width and 0 <= y < inner_height:
            inside[count], weakness[count] = i, 255 - np.int64(scores[i])
            cells[count] = int(y / side) * columns + int(x / side)
            count += 1
    if count <= quota:
        return inside[:count]
    order = stable_order(weakness[:count], 256)
    filled = np.zeros((int(inner_height / side) + 1) * columns, np.int64)
    ranks, most = np.empty(count, np.int64), 0
    for i in range(count):
        cell = cells[order[i]]
        ranks[i] = filled[cell]
        most = max(most, ranks[i])
        filled[cell] += 1
    by_rank, is_selected = stable_order(ranks, most + 1), np.zeros(count, np.bool_)
    for i in range(quota):
        is_selected[order[by_rank[i]]] = True
    selection, selected = np.empty(quota, np.int64), 0
    for i in range(count):
        if is_selected[i]:
            selection[selected] = inside[i]
            selected += 1
    return selection


@compiled
def orient_patches(level: Any, corners: Any, angles: Any) -> None:
    """Fill `angles` (N,), radians in -pi..pi, with the directions from corners to their intensity centroids.

    Source: ORB, equation 3. Rows of the disc go in pairs, above and below the corner; 16 bits hold the sums over rows.
    """
    sums, moments = np.empty(_COLUMNS, np.int16), np.empty(_COLUMNS, np.int16)
    for i in range(len(corners)):
        x, y = corners[i, 0], corners[i, 1]
        row, disc = level[y, x - _RADIUS : x - _RADIUS + _COLUMNS], _DISC[0]
        for k in range(np.uint64(_COLUMNS)):  # unsigned, and 16 bits: vector code
            sums[k] = np.int16(row[k]) * disc[k]
            moments[k] = 0
        for v in range(1, _RADIUS + 1):
            above = level[y - v, x - _RADIUS : x - _RADIUS + _COLUMNS]
            below, disc = level[y + v, x - _RADIUS : x - _RADIUS + _COLUMNS], _DISC[v]
            for k in range(np.uint64(_COLUMNS)):
                a, b = np.int16(above[k]), np.int16(below[k])
                sums[k] = np.int16(sums[k] + np.int16(np.int16(a + b) * disc[k]))
                moments[k] = np.int16(moments[k] + np.int16(np.int16(np.int16(b - a) * disc[k]) * np.int16(v)))
        m10, m01 = 0, 0
        for k in range(_COLUMNS):
            m10 += (k - _RADIUS) * sums[k]
            m01 += moments[k]
        angles[i] = math.atan2(float(m01), float(m10))


@compiled
def blur_level(level: Any, blurred: Any) -> None:
    """Fill `blurred` with the level (height, width), uint8, smoothed by a 7 x 7 Gaussian, mirrored at the border.

    Both passes round to 8 bits: their sums fit into 16, and vectors hold twice as many of them.
    """
    height, width = level.shape
    line = np.empty(width + 6, np.uint8)  # a row smoothed from above and below, with three pixels more at each end
    r0, r1, r2, r3, r4, r5, r6 = line, line[1:], line[2:], line[3:], line[4:], line[5:], line[6:]
    last, both = height - 1, spans(0, width)
    for y in range(height):
        d1, d2, d3 = last - abs(last - y - 1), last - abs(last - y - 2), last - abs(last - y - 3)
        u1, u2, u3 = abs(y - 1), abs(y - 2), abs(y - 3)
        a, b, c, d, e, f, g = level[u3], level[u2], level[u1], level[y], level[d1], level[d2], level[d3]
        for start, end in both:
            _weigh(a, b, c, d, e, f, g, line[3:], start, end)
        for k in range(3):
            line[k], line[width + 5 - k] = line[6 - k], line[width - 1 + k]
        for start, end in both:
            _weigh(r0, r1, r2, r3, r4, r5, r6, blurred[y], start, end)


@compiled(inline="always")  # a call costs as much as half a row
def _weigh(a: Any, b: Any, c: Any, d: Any, e: Any, f: Any, g: Any, out: Any, start: int, end: int) -> None:
    """Fill `out` from `start` to `end` with the weighted mean of seven rows."""
    far, middle, near = _SIDE
    for x in range(np.uint64(start), np.uint64(end)):
        outer = np.uint16(far * np.uint16(np.uint16(a[x]) + np.uint16(g[x])))
        outer = np.uint16(outer + np.uint16(middle * np.uint16(np.uint16(b[x]) + np.uint16(f[x]))))
        inner = np.uint16(near * np.uint16(np.uint16(c[x]) + np.uint16(e[x])))
        inner = np.uint16(inner + np.uint16(_CENTER * np.uint16(d[x]) + 128))
        out[x] = np.uint8(np.uint16(outer + inner) >> np.uint16(8))


@compiled
def describe_patches(blurred: Any, corners: Any, angles: Any, descriptors: Any) -> None:
    """Fill `descriptors` (N, 32), uint8, with the binary tests of rotated pixel pairs (ORB section 4).

    Bit i is set if the first pixel of pair i is the darker.
    """
    stride = np.int32(blurred.shape[1])
    flat = blurred.reshape(-1)
    offsets = np.empty(512, np.int32)
    half = np.float32(64.5)
    for i in range(len(corners)):
        corner = np.int32((corners[i, 1] - 64) * stride + corners[i, 0] - 64)
        c, s = np.float32(math.cos(angles[i])), np.float32(math.sin(angles[i]))
        for k in range(512):  # floor by truncation: 64 keeps the argument above zero; 32 bits: vector code
            row = np.int32(_PATTERN_X[k] * s + _PATTERN_Y[k] * c + half)
            column = np.int32(_PATTERN_X[k] * c - _PATTERN_Y[k] * s + half)
            offsets[k] = np.int32(corner + np.int32(np.int32(row * stride) + column))
        for byte in range(32):
            value = 0
            for bit in range(8):
                k = 2 * (8 * byte + bit)
                darker = flat[np.uint64(offsets[k])] < flat[np.uint64(offsets[k + 1])]
                value |= np.int64(darker) << bit  # type: ignore[assignment]
            descriptors[i, byte] = value


@compiled
def index_cells(pixels: Any, grid: Any, cell_px: float) -> Any:
    """Return starts (cells + 1,) and members (N,) of the cells of `grid`; features outside join the nearest cell."""
    columns, rows = int(grid[2]), int(grid[3])
    starts = np.zeros(columns * rows + 1, np.int64)
    cells = np.empty(len(pixels), np.int64)
    for i in range(len(pixels)):
        column = min(max(int((pixels[i, 0] - grid[0]) / cell_px), 0), columns - 1)
        row = min(max(int((pixels[i, 1] - grid[1]) / cell_px), 0), rows - 1)
        cells[i] = row * columns + column
        starts[cells[i] + 1] += 1
    for k in range(columns * rows):
        starts[k + 1] += starts[k]
    return starts, stable_order(cells, columns * rows)


# The learned test pattern ---------------------------------------------------------------------------------------

_TABLE = """
    8 -3 9 5  4 2 7 -12  -11 9 -8 2  7 -12 12 -13  2 -13 2 12  1 -7 1 6  -2 -10 -2 -4
    -13 -13 -11 -8  -13 -3 -12 -9  10 4 11 9  -13 -8 -8 -9  -11 7 -9 12  7 7 12 6  -4 -5 -3 0
    -13 2 -12 -3  -9 0 -7 5  12 -6 12 -1  -3 6 -2 12  -6 -13 -4 -8  11 -13 12 -8  4 7 5 1
    5 -3 10 -3  3 -7 6 12  -8 -7 -6 -2  -2 11 -1 -10  -13 12 -8 10  -7 3 -5 -3  -4 2 -3 7
    -10 -12 -6 11  5 -12 6 -7  5 -6 7 -1  1 0 4 -5  9 11 11 -13  4 7 4 12  2 -1 4 4
    -4 -12 -2 7  -8 -5 -7 -10  4 11 9 12  0 -8 1 -13  -13 -2 -8 2  -3 -2 -2 3  -6 9 -4 -9
    8 12 10 7  0 9 1 3  7 -5 11 -10  -13 -6 -11 0  10 7 12 1  -6 -3 -6 12  10 -9 12 -4
    -13 8 -8 -12  -13 0 -8 -4  3 3 7 8  5 7 10 -7  -1 7 1 -12  3 -10 5 6  2 -4 3 -10
    -13 0 -13 5  -13 -7 -12 12  -13 3 -11 8  -7 12 -4 7  6 -10 12 8  -9 -1 -7 -6  -2 -5 0 12
    -12 5 -7 5  3 -10 8 -13  -7 -7 -4 5  -3 -2 -1 -7  2 9 5 -11  -11 -13 -5 -13  -1 6 0 -1
    5 -3 5 2  -4 -13 -4 12  -9 -6 -9 6  -12 -10 -8 -4  10 2 12 -3  7 12 12 12  -7 -13 -6 5
    -4 9 -3 4  7 -1 12 2  -7 6 -5 1  -13 11 -12 5  -3 7 -2 -6  7 -8 12 -7  -13 -7 -11 -12
    1 -3 12 12  2 -6 3 0  -4 3 -2 -13  -1 -13 1 9  7 1 8 -6  1 -1 3 12  9 1 12 6
    -1 -9 -1 3  -13 -13 -10 5  7 7 10 12  12 -5 12 9  6 3 7 11  5 -13 6 10  2 -12 2 3
    3 8 4 -6  2 6 12 -13  9 -12 10 3  -8 4 -7 9  -11 12 -4 -6  1 12 2 -8  6 -9 7 -4
    2 3 3 -2  6 3 11 0  3 -3 8 -8  7 8 9 3  -11 -5 -6 -4  -10 11 -5 10  -5 -8 -3 12
    -10 5 -9 0  8 -1 12 -6  4 -6 6 -11  -10 12 -8 7  4 -2 6 7  -2 0 -2 12  -5 -8 -5 2
    7 -6 10 12  -9 -13 -8 -8  -5 -13 -5 -2  8 -8 9 -13  -9 -11 -9 0  1 -8 1 -2  7 -4 9 1
    -2 1 -1 -4  11 -6 12 -11  -12 -9 -6 4  3 7 7 12  5 5 10 8  0 -4 2 8  -9 12 -5 -13
    0 7 2 12  -1 2 1 7  5 11 7 -9  3 5 6 -8  -13 -4 -8 9  -5 9 -3 -3  -4 -7 -3 -12
    6 5 8 0  -7 6 -6 12  -13 6 -5 -2  1 -10 3 10  4 1 8 -4  -2 -2 2 -13  2 -12 12 12
    -2 -13 0 -6  4 1 9 3  -6 -10 -3 -5  -3 -13 -1 1  7 5 12 -11  4 -2 5 -7  -13 9 -9 -5
    7 1 8 6  7 -8 7 6  -7 -4 -7 1  -8 11 -7 -8  -13 6 -12 -8  2 4 3 9  10 -5 12 3
    -6 -5 -6 7  8 -3 9 -8  2 -12 2 8  -11 -2 -10 3  -12 -13 -7 -9  -11 0 -10 -5  5 -3 11 8
    -2 -13 -1 12  -1 -8 0 9  -13 -11 -12 -5  -10 -2 -10 11  -3 9 -2 -13  2 -3 3 2  -9 -13 -4 0
    -4 6 -3 -10  -4 12 -2 -7  -6 -11 -4 9  6 -3 6 11  -13 11 -5 5  11 11 12 6  7 -5 12 -2
    -1 12 0 7  -4 -8 -3 -2  -7 1 -6 7  -13 -12 -8 -13  -7 -2 -6 -8  -8 5 -6 -9  -5 -1 -4 5
    -13 7 -8 10  1 5 5 -13  1 0 10 -13  9 12 10 -1  5 -8 10 -9  -1 11 1 -13  -9 -3 -6 2
    -1 -10 1 12  -13 1 -8 -10  8 -11 10 -6  2 -13 3 -6  7 -13 12 -9  -10 -10 -5 -7  -10 -8 -8 -13
    4 -6 8 5  3 12 8 -13  -4 2 -3 -3  5 -13 10 -12  4 -13 5 -1  -9 9 -4 3  0 3 3 -9
    -12 1 -6 1  3 2 4 -8  -10 -10 -10 9  8 -13 12 12  -8 -12 -6 -5  2 2 3 7  10 6 11 -8
    6 8 8 -12  -7 10 -6 5  -3 -9 -3 9  -1 -13 -1 5  -3 -7 -3 4  -8 -2 -8 3  4 2 12 12
    2 -5 3 11  6 -9 11 -13  3 -1 7 12  11 -1 12 4  -3 0 -3 6  4 -11 4 12  2 -4 2 1
    -10 -6 -8 1  -13 7 -11 1  -13 12 -11 -13  6 0 11 -13  0 -1 1 4  -13 3 -9 -2  -9 8 -6 -3
    -13 -6 -8 -2  5 -9 8 10  2 7 3 -9  -1 -6 -1 -1  9 5 11 -2  11 -3 12 -8  3 0 3 5
    -1 4 0 10  3 -6 4 5  -13 0 -10 5  5 8 12 11  8 9 9 -6  7 -4 8 -12  -10 4 -10 9
    7 3 12 4  9 -7 10 -2  7 0 12 -2  -1 -6 0 -11
"""

ORB_PATTERN = np.array(_TABLE.split(), dtype=np.int64).reshape(256, 4)
"""The 256 learned pixel pairs of the ORB descriptor (256, 4): x1, y1, x2, y2 from the center of a 31x31 patch.

Bit i of a descriptor is set if the first pixel of pair i is darker than the second. Source: Rublee, Rabaud, Konolige,
Bradski, "ORB: an efficient alternative to SIFT or SURF", ICCV 2011; the table was published with it under the BSD
license.
"""
_PATTERN_X = np.ascontiguousarray(ORB_PATTERN.reshape(512, 2)[:, 0]).astype(np.float32)
_PATTERN_Y = np.ascontiguousarray(ORB_PATTERN.reshape(512, 2)[:, 1]).astype(np.float32)
