"""The inner loops of the map: which keyframe sees which point.

The observations of a point form a linked list: `heads[p]` is its first link; a row of `links` (L, 3) holds the next
link, -1 at the end, and the keyframe and the feature that show the point, side by side in memory.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from codecbench.core.kernels.compiled import compiled
from codecbench.slam import thresholds
from codecbench.slam.features.hamming import hamming
from codecbench.slam.features.sorting import stable_order

_NEXT, _KEYFRAME, _FEATURE = 0, 1, 2  # columns of the links


class Links(NamedTuple):
    """Who sees which point: `heads` and `counts` of the points' lists (P,); `links` (L, 3); `keyframe_points` (K, F),
    which says the same by keyframe; `alive` (P,)."""

    heads: Any
    counts: Any
    links: Any
    keyframe_points: Any
    alive: Any


class Replacements(NamedTuple):
    """What became of points: `replaced_by`, `found` and `visible` (P,); see PointTable."""

    replaced_by: Any
    found: Any
    visible: Any


@compiled
def add_links(points: Any, keyframes: Any, features: Any, first_link: int, heads: Any, counts: Any, links: Any) -> None:
    """Record that keyframes[i] sees points[i] at features[i], in links first_link + i."""
    for i in range(len(points)):
        link = first_link + i
        links[link, _NEXT], links[link, _KEYFRAME], links[link, _FEATURE] = heads[points[i]], keyframes[i], features[i]
        heads[points[i]] = link
        counts[points[i]] += 1


@compiled
def forget_observations(keyframes: Any, features: Any, lists: Links) -> None:
    """Forget what keyframes[i] sees at features[i]; a point that fewer than two keyframes see dies."""
    heads, counts, links, keyframe_points, _ = lists
    for i in range(len(keyframes)):
        point = keyframe_points[keyframes[i], features[i]]
        if point < 0:
            continue
        before, link = -1, heads[point]
        while links[link, _KEYFRAME] != keyframes[i]:
            before, link = link, links[link, _NEXT]
        if before < 0:
            heads[point] = links[link, _NEXT]
        else:
            links[before, _NEXT] = links[link, _NEXT]
        counts[point] -= 1
        keyframe_points[keyframes[i], features[i]] = -1
        if counts[point] < 2:
            _kill(point, lists)


@compiled
def kill_points(points: Any, lists: Links) -> None:
    """Let points die and forget who saw them."""
    for point in points:
        _kill(point, lists)


@compiled
def _kill(point: int, lists: Links) -> None:
    link = lists.heads[point]
    while link >= 0:
        lists.keyframe_points[lists.links[link, _KEYFRAME], lists.links[link, _FEATURE]] = -1
        link = lists.links[link, _NEXT]
    lists.heads[point] = -1
    lists.counts[point] = 0
    lists.alive[point] = False


@compiled
def replace(old: Any, new: Any, lists: Links, table: Replacements) -> None:
    """Let new[i] be seen wherever old[i] was, where it is not seen already; old[i] dies."""
    for i in range(len(old)):
        _hand_over(old[i], new[i], lists)
        table.replaced_by[old[i]] = new[i]
        table.found[new[i]] += table.found[old[i]]
        table.visible[new[i]] += table.visible[old[i]]


@compiled
def _hand_over(old: int, new: int, lists: Links) -> None:
    heads, counts, links, keyframe_points, _ = lists
    link = heads[old]
    heads[old] = -1
    while link >= 0:
        after, keyframe = links[link, _NEXT], links[link, _KEYFRAME]
        other = heads[new]
        while other >= 0 and links[other, _KEYFRAME] != keyframe:
            other = links[other, _NEXT]
        taken = other >= 0
        keyframe_points[keyframe, links[link, _FEATURE]] = -1 if taken else new
        if not taken:
            links[link, _NEXT] = heads[new]
            heads[new] = link
            counts[new] += 1
        link = after
    _kill(old, lists)


@compiled
def count_covisible(points: Any, keyframe_count: int, heads: Any, links: Any) -> Any:
    """How many of `points` each keyframe sees (K,); negative indices are skipped."""
    counts = np.zeros(keyframe_count, np.int64)
    for p in points:
        link = heads[p] if p >= 0 else -1
        while link >= 0:
            counts[links[link, _KEYFRAME]] += 1
            link = links[link, _NEXT]
    return counts


@compiled
def rank_covisible(points: Any, left_out: int, keyframe_count: int, heads: Any, links: Any) -> Any:
    """The keyframes that see any of `points` (K,), but for `left_out`, and how many they see (K,), most first and then
    the oldest; negative indices are skipped."""
    counts = count_covisible(points, keyframe_count, heads, links)
    if left_out >= 0:
        counts[left_out] = 0
    seeing, most = np.nonzero(counts)[0], 0
    for k in seeing:
        most = max(most, counts[k])
    shortfalls = np.empty(len(seeing), np.int64)
    for i in range(len(seeing)):
        shortfalls[i] = most - counts[seeing[i]]
    keyframes = seeing[stable_order(shortfalls, most + 1)]
    return keyframes, counts[keyframes]


@compiled
def resolve_points(points: Any, replaced_by: Any, alive: Any) -> Any:
    """`points` (N,) with replaced ones exchanged for their replacements and dead ones for -1."""
    resolved = np.full(len(points), -1, np.int64)
    for i in range(len(points)):
        point = points[i]
        while point >= 0 and replaced_by[point] >= 0:
            point = replaced_by[point]
        if point >= 0 and alive[point]:
            resolved[i] = point
    return resolved


@compiled
def list_observations(points: Any, wanted: Any, counts: Any, heads: Any, links: Any) -> Any:
    """Observations of `points` by keyframes `wanted` (K,) bool: index into `points`, keyframe, feature, (M,) each."""
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
            if wanted[links[link, _KEYFRAME]]:
                which[m], keyframes[m], features[m] = i, links[link, _KEYFRAME], links[link, _FEATURE]
                m += 1
            link = links[link, _NEXT]
    return which[:m], keyframes[:m], features[:m]


@compiled
def unite_points(keyframes: Any, keyframe_points: Any, point_count: int) -> Any:
    """The points that any of `keyframes` sees, ascending (P,)."""
    seen = np.zeros(point_count + 1, np.bool_)  # the last is for features without a point
    for k in keyframes:
        for f in range(keyframe_points.shape[1]):
            point = keyframe_points[k, f]
            seen[np.uint64(point if point >= 0 else point_count)] = True
    return np.nonzero(seen[:point_count])[0]


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
            k, f = links[link, _KEYFRAME], links[link, _FEATURE]
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
            elif reference_octave < 0 and links[link, _NEXT] < 0:  # the reference no longer sees it: take the oldest
                references[p] = reference = k
                reference_octave = keyframe_octaves[k, f]
            link = links[link, _NEXT]
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
    """The one of `descriptors` (N, 4) with the least median distance to the others; `distances` is overwritten."""
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
    """The middle of a few values, the lower one of two, by insertion; sorts the lower half in place."""
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
    """Whether more than REDUNDANT_SHARE of a keyframe's points (F,) are seen by REDUNDANT_OBSERVATIONS others at the
    same, a finer or the next scale; so it is without points."""
    allowed = (1.0 - thresholds.REDUNDANT_SHARE) * np.count_nonzero(points >= 0)
    needed = 0
    for f in range(len(points)):
        others, link = 0, heads[points[f]] if points[f] >= 0 else -1
        while link >= 0 and others < thresholds.REDUNDANT_OBSERVATIONS:
            k = links[link, _KEYFRAME]
            if k != keyframe and octaves[k, links[link, _FEATURE]] <= octaves[keyframe, f] + 1:
                others += 1
            link = links[link, _NEXT]
        if points[f] >= 0 and others < thresholds.REDUNDANT_OBSERVATIONS:
            needed += 1
            if needed >= allowed:
                return False
    return True


@compiled
def median_depth(points: Any, positions: Any, camera_from_world: Any) -> float:
    """Median depth of `points` before a camera, 1 where there are none; negative indices are skipped."""
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
    """The value at place n of the sorted values, which are reordered (Hoare 1961); numba's median compiles for 2 s."""
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
