"""The inner loops of the map: which keyframe sees which point.

The observations of a point form a linked list: `heads[p]` is its first link, `following[l]` the next, -1 the end;
`link_keyframes[l]` and `link_features[l]` say where the point is seen.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from codecbench.slam import thresholds
from codecbench.slam.hamming import hamming

_DESCRIPTORS_COMPARED = 24
"""Most descriptors compared for a point's representative one; the newest count, and the work stays bounded."""


class Links(NamedTuple):
    """Who sees which point: `heads` and `counts` of the points' lists (P,); `following`, `keyframes` and `features`
    of their links (L,); `keyframe_points` (K, F), which says the same by keyframe; `alive` (P,)."""

    heads: Any
    counts: Any
    following: Any
    keyframes: Any
    features: Any
    keyframe_points: Any
    alive: Any


class Replacements(NamedTuple):
    """What became of points: `replaced_by`, `found` and `visible` (P,); see PointTable."""

    replaced_by: Any
    found: Any
    visible: Any


class Views(NamedTuple):
    """The keyframes, one a row: `poses` (K, 4, 4) camera_from_world, `centers` (K, 3) in the world; by feature `pixels`
    (K, F, 2), `octaves` (K, F), `descriptors` (K, F, 4) and map `points` (K, F), -1 for none; `counts` (K,) of
    features."""

    poses: Any
    centers: Any
    pixels: Any
    octaves: Any
    descriptors: Any
    points: Any
    counts: Any


@njit(cache=True)
def add_links(
    points: Any, keyframes: Any, features: Any, first_link: int,
    heads: Any, counts: Any, following: Any, link_keyframes: Any, link_features: Any,
) -> None:  # fmt: skip
    """Record that keyframes[i] sees points[i] at features[i], in links first_link + i."""
    for i in range(len(points)):
        link = first_link + i
        link_keyframes[link] = keyframes[i]
        link_features[link] = features[i]
        following[link] = heads[points[i]]
        heads[points[i]] = link
        counts[points[i]] += 1


@njit(cache=True)
def forget_observations(keyframes: Any, features: Any, links: Links) -> None:
    """Forget what keyframes[i] sees at features[i]; a point that fewer than two keyframes see dies."""
    for i in range(len(keyframes)):
        point = links.keyframe_points[keyframes[i], features[i]]
        if point < 0:
            continue
        before, link = -1, links.heads[point]
        while links.keyframes[link] != keyframes[i]:
            before, link = link, links.following[link]
        if before < 0:
            links.heads[point] = links.following[link]
        else:
            links.following[before] = links.following[link]
        links.counts[point] -= 1
        links.keyframe_points[keyframes[i], features[i]] = -1
        if links.counts[point] < 2:
            _kill(point, links)


@njit(cache=True)
def kill_points(points: Any, links: Links) -> None:
    """Let points die and forget who saw them."""
    for point in points:
        _kill(point, links)


@njit(cache=True)
def _kill(point: int, links: Links) -> None:
    link = links.heads[point]
    while link >= 0:
        links.keyframe_points[links.keyframes[link], links.features[link]] = -1
        link = links.following[link]
    links.heads[point] = -1
    links.counts[point] = 0
    links.alive[point] = False


@njit(cache=True)
def replace(old: Any, new: Any, links: Links, table: Replacements) -> None:
    """Let new[i] be seen wherever old[i] was, where it is not seen already; old[i] dies."""
    for i in range(len(old)):
        _hand_over(old[i], new[i], links)
        table.replaced_by[old[i]] = new[i]
        table.found[new[i]] += table.found[old[i]]
        table.visible[new[i]] += table.visible[old[i]]


@njit(cache=True)
def _hand_over(old: int, new: int, links: Links) -> None:
    link = links.heads[old]
    links.heads[old] = -1
    while link >= 0:
        after, keyframe = links.following[link], links.keyframes[link]
        taken = sees(keyframe, new, links)
        links.keyframe_points[keyframe, links.features[link]] = -1 if taken else new
        if not taken:
            links.following[link] = links.heads[new]
            links.heads[new] = link
            links.counts[new] += 1
        link = after
    _kill(old, links)


@njit(cache=True)
def sees(keyframe: int, point: int, links: Links) -> bool:
    """Whether a keyframe sees a point."""
    link = links.heads[point]
    while link >= 0 and links.keyframes[link] != keyframe:
        link = links.following[link]
    return bool(link >= 0)


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
    points: Any, wanted: Any, counts: Any, heads: Any, following: Any, link_keyframes: Any, link_features: Any
) -> Any:
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
            if wanted[link_keyframes[link]]:
                which[m], keyframes[m], features[m] = i, link_keyframes[link], link_features[link]
                m += 1
            link = following[link]
    return which[:m], keyframes[:m], features[:m]


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
    distances = np.zeros((_DESCRIPTORS_COMPARED, _DESCRIPTORS_COMPARED), np.int64)
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
        best = _most_central(links[:count], link_keyframes, link_features, keyframe_descriptors, distances)
        for w in range(4):
            descriptors[p, w] = keyframe_descriptors[link_keyframes[best], link_features[best], w]


@njit(cache=True)
def _most_central(
    links: Any, link_keyframes: Any, link_features: Any, keyframe_descriptors: Any, distances: Any
) -> int:
    """The link whose descriptor has the least median distance to the others; `distances` is overwritten."""
    count = len(links)
    if count <= 2:
        return int(links[0])
    for i in range(count):
        distances[i, i] = 0
        own = keyframe_descriptors[link_keyframes[links[i]]]
        for j in range(i):
            other = keyframe_descriptors[link_keyframes[links[j]]]
            distance = hamming(own, link_features[links[i]], other, link_features[links[j]])
            distances[i, j] = distance
            distances[j, i] = distance
    best, best_median = 0, 1000
    for i in range(count):
        median = _lower_median(distances[i, :count])
        if median < best_median:
            best, best_median = i, median
    return int(links[best])


@njit(cache=True)
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


@njit(cache=True)
def is_redundant(
    points: Any, keyframe: int, octaves: Any, heads: Any, following: Any, link_keyframes: Any, link_features: Any
) -> bool:
    """Whether more than REDUNDANT_SHARE of a keyframe's points (F,) are seen by REDUNDANT_OBSERVATIONS others at the
    same, a finer or the next scale; so it is without points."""
    allowed = (1.0 - thresholds.REDUNDANT_SHARE) * np.count_nonzero(points >= 0)
    needed = 0
    for f in range(len(points)):
        others, link = 0, heads[points[f]] if points[f] >= 0 else -1
        while link >= 0 and others < thresholds.REDUNDANT_OBSERVATIONS:
            k = link_keyframes[link]
            if k != keyframe and octaves[k, link_features[link]] <= octaves[keyframe, f] + 1:
                others += 1
            link = following[link]
        if points[f] >= 0 and others < thresholds.REDUNDANT_OBSERVATIONS:
            needed += 1
            if needed >= allowed:
                return False
    return True


@njit(cache=True)
def median_depth(points: Any, positions: Any, camera_from_world: Any) -> float:
    """Median depth of `points` before a camera, 1 where there are none; negative indices are skipped."""
    depths = np.empty(len(points))
    count = 0
    x, y, z, offset = camera_from_world[2]
    for p in points:
        if p >= 0:
            depths[count] = x * positions[p, 0] + y * positions[p, 1] + z * positions[p, 2] + offset
            count += 1
    return float(np.median(depths[:count])) if count else 1.0
