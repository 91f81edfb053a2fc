"""Compiled kernels of map points: viewing directions, distances, descriptors, redundancy and depths."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from codecbench.core.kernels.compiled import compiled
from codecbench.slam import thresholds
from codecbench.slam.features.hamming import hamming
from codecbench.slam.map.observation_kernels import FEATURE, KEYFRAME, NEXT


@compiled
def refresh_points(
    points: Any, positions: Any, references: Any, heads: Any, links: Any,
    centers_world: Any, keyframe_octaves: Any, keyframe_descriptors: Any, scale_factors: Any,
    normals: Any, min_distances: Any, max_distances: Any, descriptors: Any, with_descriptors: bool,
) -> None:  # fmt: skip
    """Recompute mean viewing direction, range of distances and, if wanted, best descriptor (ORB-SLAM III-C)."""
    seen = np.empty((thresholds.DESCRIPTORS_COMPARED, 4), np.uint64)
    distances = np.zeros((thresholds.DESCRIPTORS_COMPARED, thresholds.DESCRIPTORS_COMPARED), np.int64)
    for p in points:
        nx, ny, nz = 0.0, 0.0, 0.0
        count = 0
        link = heads[p]
        if link < 0:
            continue
        reference_octave, reference = -1, references[p]
        while link >= 0:
            k, f = links[link, KEYFRAME], links[link, FEATURE]
            x = positions[p, 0] - centers_world[k, 0]
            y = positions[p, 1] - centers_world[k, 1]
            z = positions[p, 2] - centers_world[k, 2]
            norm = max(math.sqrt(x * x + y * y + z * z), 1e-12)
            nx, ny, nz = nx + x / norm, ny + y / norm, nz + z / norm
            if with_descriptors and count < thresholds.DESCRIPTORS_COMPARED:
                for w in range(4):
                    seen[count, w] = keyframe_descriptors[k, f, w]
                count += 1
            if k == reference:
                reference_octave = keyframe_octaves[k, f]
            elif (
                reference_octave < 0 and links[link, NEXT] < 0
            ):  # the reference no longer sees the point: take the oldest
                references[p] = reference = k
                reference_octave = keyframe_octaves[k, f]
            link = links[link, NEXT]
        norm = max(math.sqrt(nx * nx + ny * ny + nz * nz), 1e-12)
        normals[p, 0], normals[p, 1], normals[p, 2] = nx / norm, ny / norm, nz / norm
        x = positions[p, 0] - centers_world[reference, 0]
        y = positions[p, 1] - centers_world[reference, 1]
        z = positions[p, 2] - centers_world[reference, 2]
        max_distances[p] = math.sqrt(x * x + y * y + z * z) * scale_factors[reference_octave]
        min_distances[p] = max_distances[p] / scale_factors[-1]
        if with_descriptors:
            best = _most_central(seen[:count], distances)
            for w in range(4):
                descriptors[p, w] = seen[best, w]


@compiled
def _most_central(descriptors: Any, distances: Any) -> int:
    """Return the index of the descriptor (N, 4) with the least median distance to the others.

    Overwrites `distances`.
    """
    count = len(descriptors)
    if count <= 2:
        return 0
    for i in range(count):
        distances[i, i] = 0
        for j in range(i):
            distances[i, j] = distances[j, i] = hamming(descriptors, i, descriptors, j)
    best, best_median = 0, 1000
    for i in range(count):
        median = _lower_median(distances[i, :count])
        if median < best_median:
            best, best_median = i, median
    return best


@compiled
def _lower_median(values: Any) -> int:
    """Return the middle of a few values, the lower of two, by insertion; sorts the lower half in place."""
    half = (len(values) - 1) // 2
    for i in range(1, len(values)):
        value = values[i]
        if i > half and value >= values[half]:
            continue
        k = min(i, half)
        while k > 0 and values[k - 1] > value:
            values[k] = values[k - 1]
            k -= 1
        values[k] = value
    return int(values[half])


@compiled
def is_redundant(points: Any, keyframe: int, octaves: Any, heads: Any, links: Any) -> bool:
    """Return whether others see enough of a keyframe's points (F,), or it has none.

    More than REDUNDANT_SHARE of them must be seen by REDUNDANT_OBSERVATIONS others at the same, a finer or the next
    scale.
    """
    allowed = (1.0 - thresholds.REDUNDANT_SHARE) * np.count_nonzero(points >= 0)
    needed = 0
    for f in range(len(points)):
        others, link = 0, heads[points[f]] if points[f] >= 0 else -1
        while link >= 0 and others < thresholds.REDUNDANT_OBSERVATIONS:
            k = links[link, KEYFRAME]
            if k != keyframe and octaves[k, links[link, FEATURE]] <= octaves[keyframe, f] + 1:
                others += 1
            link = links[link, NEXT]
        if points[f] >= 0 and others < thresholds.REDUNDANT_OBSERVATIONS:
            needed += 1
            if needed >= allowed:
                return False
    return True


@compiled
def median_depth(points: Any, positions: Any, camera_from_world: Any) -> float:
    """Return the median depth of `points` before a camera, 1 if there are none; negative indices are skipped."""
    depths = np.empty(len(points))
    count = 0
    x, y, z, offset = camera_from_world[2]
    for p in points:
        if p >= 0:
            depths[count] = x * positions[p, 0] + y * positions[p, 1] + z * positions[p, 2] + offset
            count += 1
    if count == 0:
        return 1.0
    depths, middle = depths[:count], count // 2
    upper = _nth_smallest(depths, middle)
    return float(upper if count % 2 else (_nth_smallest(depths, middle - 1) + upper) / 2.0)


@compiled
def _nth_smallest(values: Any, n: int) -> float:
    """Return the value at place n of the sorted values; reorders them (Hoare 1961). numba's median compiles for 2 s."""
    low, high = 0, len(values) - 1
    while low < high:
        pivot, i, j = values[(low + high) // 2], low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i, j = i + 1, j - 1
        if n <= j:
            high = j
        elif n >= i:
            low = i
        else:
            break
    return float(values[n])
