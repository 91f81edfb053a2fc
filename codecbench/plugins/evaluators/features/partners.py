"""Which keypoints and descriptors of two images are each other's nearest, compiled."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from codecbench.core.kernels.compiled import compiled
from codecbench.slam.features.hamming import hamming


@compiled
def matches(descriptors: Any, descriptors_now: Any, match_bits: int) -> NDArray[np.int64]:
    """For each descriptor its nearest in the other frame, or -1 where that is not mutual or beyond `match_bits`.

    The lowest index wins among equals, in both directions.
    """
    count, count_now = len(descriptors), len(descriptors_now)
    nearest, distances = np.full(count, -1, np.int64), np.full(count, 257, np.int64)
    nearest_back, distances_back = np.full(count_now, -1, np.int64), np.full(count_now, 257, np.int64)
    for i in range(count):
        for j in range(count_now):
            bits = hamming(descriptors, i, descriptors_now, j)
            if bits < distances[i]:
                nearest[i], distances[i] = j, bits
            if bits < distances_back[j]:
                nearest_back[j], distances_back[j] = i, bits
    for i in range(count):
        if distances[i] > match_bits or nearest_back[nearest[i]] != i:
            nearest[i] = -1
    return nearest


@compiled
def nearest_places(
    places: NDArray[np.float64], others: NDArray[np.float64], tolerance_px: float, scale_factor: float
) -> NDArray[np.int64]:
    """For each place (x, y, level) its nearest among the others, or -1 where that is not mutual or too far.

    Near enough is within `tolerance_px` at the pyramid level of the place and at most one level away. A level counts
    as much as a pixel, which tells places at the same pixel apart.
    """
    nearest, costs = np.full(len(places), -1, np.int64), np.full(len(places), np.inf)
    nearest_back, costs_back = np.full(len(others), -1, np.int64), np.full(len(others), np.inf)
    for i in range(len(places)):
        limit = tolerance_px * scale_factor ** places[i, 2]
        for j in range(len(others)):
            across = abs(places[i, 0] - others[j, 0])
            down = abs(places[i, 1] - others[j, 1])
            levels = abs(places[i, 2] - others[j, 2])
            if across > limit or down > limit or levels > 1.0 or across * across + down * down > limit * limit:
                continue
            cost = across * across + down * down + levels
            if cost < costs[i]:
                nearest[i], costs[i] = j, cost
            if cost < costs_back[j]:
                nearest_back[j], costs_back[j] = i, cost
    for i in range(len(places)):
        if nearest[i] >= 0 and nearest_back[nearest[i]] != i:
            nearest[i] = -1
    return nearest
