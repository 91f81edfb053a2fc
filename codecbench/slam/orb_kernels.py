"""The inner loops of feature extraction."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from codecbench.slam.orb_pattern import ORB_PATTERN
from codecbench.slam.sorting import stable_order
from codecbench.slam.thresholds import PATCH_RADIUS_PX

_RADIUS = PATCH_RADIUS_PX
_PATTERN_X = np.ascontiguousarray(ORB_PATTERN.reshape(512, 2)[:, 0]).astype(np.float64)
_PATTERN_Y = np.ascontiguousarray(ORB_PATTERN.reshape(512, 2)[:, 1]).astype(np.float64)
_HALF_WIDTHS = np.array([int(math.sqrt(_RADIUS * _RADIUS - v * v) + 0.5) for v in range(_RADIUS + 1)])


@njit(cache=True)
def select_evenly(corners: Any, scores: Any, quota: int, height: int, width: int, border: int) -> Any:
    """Indices of at most `quota` corners (N, 2) with `scores` (N,) uint8, spread over the level, in reading order.

    The level is divided into about `quota` square cells. Corners are taken by their rank within their cell, the
    strongest of every cell first; the rank that does not fit whole is taken by score. Ties go to reading order.
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
        if 0 <= x < inner_width and 0 <= y < inner_height:
            inside[count], weakness[count] = i, 255 - np.int64(scores[i])
            cells[count] = int(y / side) * columns + int(x / side)
            count += 1
    if count <= quota:
        return inside[:count]
    order = stable_order(weakness[:count], 256)
    filled = np.zeros((int(inner_height / side) + 1) * columns, np.int64)
    ranks = np.empty(count, np.int64)
    for i in range(count):
        cell = cells[order[i]]
        ranks[i] = filled[cell]
        filled[cell] += 1
    by_rank = order[stable_order(ranks, ranks.max() + 1)]
    return inside[np.sort(by_rank[:quota])]


@njit(cache=True)
def orient_patches(level: Any, corners: Any) -> Any:
    """Direction (N,), radians in -pi..pi, from each corner to the intensity centroid of its disc (ORB, equation 3)."""
    angles = np.empty(len(corners))
    for i in range(len(corners)):
        x, y = corners[i, 0], corners[i, 1]
        m10, m01 = np.int32(0), np.int32(0)
        for v in range(-_RADIUS, _RADIUS + 1):
            width = _HALF_WIDTHS[abs(v)]
            row = level[y + v, x - width : x + width + 1]
            total, moment = np.int32(0), np.int32(0)
            for k in range(np.uint64(len(row))):  # unsigned, and 32 bits: vector code
                total += np.int32(row[k])
                moment += np.int32(k) * np.int32(row[k])
            m10 += moment - np.int32(width) * total
            m01 += np.int32(v) * total
        angles[i] = math.atan2(float(m01), float(m10))
    return angles


@njit(cache=True)
def describe_patches(blurred: Any, corners: Any, angles: Any) -> Any:
    """Descriptors (N, 32) uint8: bit i is set where the first pixel of turned pair i is the darker (ORB section 4)."""
    descriptors = np.empty((len(corners), 32), np.uint8)
    stride = np.int32(blurred.shape[1])
    flat = blurred.reshape(-1)
    offsets = np.empty(512, np.int32)
    for i in range(len(corners)):
        corner = np.int32((corners[i, 1] - 64) * stride + corners[i, 0] - 64)
        c, s = math.cos(angles[i]), math.sin(angles[i])
        for k in range(512):  # floor by truncation: 64 keeps the argument above zero; 32 bits: vector code
            row = np.int32(_PATTERN_X[k] * s + _PATTERN_Y[k] * c + 64.5)
            column = np.int32(_PATTERN_X[k] * c - _PATTERN_Y[k] * s + 64.5)
            offsets[k] = np.int32(corner + np.int32(np.int32(row * stride) + column))
        for byte in range(32):
            value = 0
            for bit in range(8):
                k = 2 * (8 * byte + bit)
                darker = flat[np.uint64(offsets[k])] < flat[np.uint64(offsets[k + 1])]
                value |= np.int64(darker) << bit  # type: ignore[assignment]
            descriptors[i, byte] = value
    return descriptors


@njit(cache=True)
def index_cells(pixels: Any, grid: Any, cell_px: float) -> Any:
    """Starts (cells + 1,) and members (N,) of the cells of `grid`; features outside go to the nearest cell."""
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
