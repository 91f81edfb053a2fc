"""The inner loops of the map: which keyframe sees which point.

The observations of a point form a linked list: `heads[p]` is its first link, `following[l]` the next, -1 the end;
`link_keyframes[l]` and `link_features[l]` say where the point is seen.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from codecbench.slam.hamming import hamming

_DESCRIPTORS_COMPARED = 24
"""Most descriptors compared for a point's representative one; the newest count, and the work stays bounded."""


@njit(cache=True)
def add_links(
    points: Any, keyframe: int, features: Any, first_link: int,
    heads: Any, counts: Any, following: Any, link_keyframes: Any, link_features: Any,
) -> None:  # fmt: skip
    """Record that `keyframe` sees points[i] at features[i], in links first_link + i."""
    for i in range(len(points)):
        link = first_link + i
        link_keyframes[link] = keyframe
        link_features[link] = features[i]
        following[link] = heads[points[i]]
        heads[points[i]] = link
        counts[points[i]] += 1


@njit(cache=True)
def remove_link(point: int, keyframe: int, heads: Any, counts: Any, following: Any, link_keyframes: Any) -> int:
    """Take the link from `point` to `keyframe` out of its list; returns it, or -1 where there is none."""
    before, link = -1, heads[point]
    while link >= 0 and link_keyframes[link] != keyframe:
        before, link = link, following[link]
    if link < 0:
        return -1
    if before < 0:
        heads[point] = following[link]
    else:
        following[before] = following[link]
    counts[point] -= 1
    return int(link)


@njit(cache=True)
def count_covisible(points: Any, keyframe_count: int, heads: Any, following: Any, link_keyframes: Any) -> Any:
    """How many of `points` each keyframe sees (K,); negative indices are skipped."""
    counts = np.zeros(keyframe_count, np.int64)
    for p in points:
        link = heads[p] if p >= 0 else -1
        while link >= 0:
            counts[link_keyframes[link]] += 1
            link = following[link]
    return counts


@njit(cache=True)
def list_observations(
    points: Any, counts: Any, heads: Any, following: Any, link_keyframes: Any, link_features: Any
) -> Any:
    """All observations of `points`: index into `points` (M,), keyframe (M,), feature (M,), point by point."""
    total = 0
    for p in points:
        total += counts[p]
    which = np.empty(total, np.int64)
    keyframes = np.empty(total, np.int64)
    features = np.empty(total, np.int64)
    m = 0
    for i in range(len(points)):
        link = heads[points[i]]
        while link >= 0:
            which[m], keyframes[m], features[m] = i, link_keyframes[link], link_features[link]
            m += 1
            link = following[link]
    return which, keyframes, features


@njit(cache=True)
def unite_points(keyframes: Any, keyframe_points: Any, point_count: int) -> Any:
    """The points that any of `keyframes` sees, ascending (P,)."""
    seen = np.zeros(point_count, np.bool_)
    for k in keyframes:
        for f in range(keyframe_points.shape[1]):
            if keyframe_points[k, f] >= 0:
                seen[keyframe_points[k, f]] = True
    return np.nonzero(seen)[0]


@njit(cache=True)
def refresh_points(
    points: Any, positions: Any, references: Any, heads: Any, following: Any, link_keyframes: Any, link_features: Any,
    centers_world: Any, keyframe_octaves: Any, keyframe_descriptors: Any, scale_factors: Any,
    normals: Any, min_distances: Any, max_distances: Any, descriptors: Any, with_descriptors: bool,
) -> None:  # fmt: skip
    """Recompute mean viewing direction, range of distances and, if wanted, best descriptor (ORB-SLAM III-C)."""
    links = np.empty(_DESCRIPTORS_COMPARED, np.int64)
    for p in points:
        nx, ny, nz = 0.0, 0.0, 0.0
        count = 0
        link = heads[p]
        if link < 0:
            continue
        reference_octave, reference = -1, references[p]
        while link >= 0:
            k = link_keyframes[link]
            x = positions[p, 0] - centers_world[k, 0]
            y = positions[p, 1] - centers_world[k, 1]
            z = positions[p, 2] - centers_world[k, 2]
            norm = max(math.sqrt(x * x + y * y + z * z), 1e-12)
            nx, ny, nz = nx + x / norm, ny + y / norm, nz + z / norm
            if count < _DESCRIPTORS_COMPARED:
                links[count] = link
                count += 1
            if k == reference:
                reference_octave = keyframe_octaves[k, link_features[link]]
            elif reference_octave < 0 and following[link] < 0:  # the reference no longer sees it: take the oldest
                references[p] = reference = k
                reference_octave = keyframe_octaves[k, link_features[link]]
            link = following[link]
        norm = max(math.sqrt(nx * nx + ny * ny + nz * nz), 1e-12)
        normals[p, 0], normals[p, 1], normals[p, 2] = nx / norm, ny / norm, nz / norm
        x = positions[p, 0] - centers_world[reference, 0]
        y = positions[p, 1] - centers_world[reference, 1]
        z = positions[p, 2] - centers_world[reference, 2]
        max_distances[p] = math.sqrt(x * x + y * y + z * z) * scale_factors[reference_octave]
        min_distances[p] = max_distances[p] / scale_factors[-1]
        if not with_descriptors:
            continue
        best = _most_central(links[:count], link_keyframes, link_features, keyframe_descriptors)
        for w in range(4):
            descriptors[p, w] = keyframe_descriptors[link_keyframes[best], link_features[best], w]


@njit(cache=True)
def _most_central(links: Any, link_keyframes: Any, link_features: Any, keyframe_descriptors: Any) -> int:
    """The link whose descriptor has the least median distance to the others."""
    count = len(links)
    if count <= 2:
        return int(links[0])
    distances = np.zeros((count, count), np.int64)
    for i in range(count):
        own = keyframe_descriptors[link_keyframes[links[i]]]
        for j in range(i):
            other = keyframe_descriptors[link_keyframes[links[j]]]
            distance = hamming(own, link_features[links[i]], other, link_features[links[j]])
            distances[i, j] = distance
            distances[j, i] = distance
    best, best_median = 0, 1000
    for i in range(count):
        row = np.sort(distances[i])
        if row[(count - 1) // 2] < best_median:
            best, best_median = i, row[(count - 1) // 2]
    return int(links[best])


@njit(cache=True)
def count_redundant(
    keyframe: int, needed: int, keyframe_points: Any, keyframe_octaves: Any,
    heads: Any, following: Any, link_keyframes: Any, link_features: Any,
) -> Any:  # fmt: skip
    """Points of `keyframe`, and how many of them `needed` others see at the same, a finer or the next scale."""
    total, redundant = 0, 0
    for f in range(keyframe_points.shape[1]):
        p = keyframe_points[keyframe, f]
        if p < 0:
            continue
        total += 1
        octave, others = keyframe_octaves[keyframe, f], 0
        link = heads[p]
        while link >= 0:
            k = link_keyframes[link]
            if k != keyframe and keyframe_octaves[k, link_features[link]] <= octave + 1:
                others += 1
            link = following[link]
        if others >= needed:
            redundant += 1
    return total, redundant
