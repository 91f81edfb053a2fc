"""Compiled kernels of observations: which keyframe sees which point.

The observations of a point form a linked list: `heads[p]` is its first link. A row of `links` (L, 3) holds the next
link, -1 at the end, and the keyframe and the feature that show the point, side by side in memory.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from codecbench.core.kernels.compiled import compiled
from codecbench.slam.features.sorting import stable_order

NEXT, KEYFRAME, FEATURE = 0, 1, 2  # columns of the links


class Links(NamedTuple):
    """Observations, as a linked list for each point."""

    heads: Any
    """First link of each point (P,)."""
    counts: Any
    """Number of observations of each point (P,)."""
    links: Any
    """Next link, keyframe and feature (L, 3)."""
    keyframe_points: Any
    """The same by keyframe: the point of each feature (K, F)."""
    alive: Any
    """Which points are alive (P,)."""


class Replacements(NamedTuple):
    """Columns (P,) that change if points are replaced; see PointTable."""

    replaced_by: Any
    found_counts: Any
    visible_counts: Any


@compiled
def add_links(points: Any, keyframes: Any, features: Any, first_link: int, heads: Any, counts: Any, links: Any) -> None:
    """Record that keyframes[i] sees points[i] at features[i], in links first_link + i."""
    for i in range(len(points)):
        link = first_link + i
        links[link, NEXT], links[link, KEYFRAME], links[link, FEATURE] = heads[points[i]], keyframes[i], features[i]
        heads[points[i]] = link
        counts[points[i]] += 1


@compiled
def remove_observations(keyframes: Any, features: Any, lists: Links) -> None:
    """Remove what keyframes[i] sees at features[i]; a point that fewer than two keyframes see dies."""
    heads, counts, links, keyframe_points, _ = lists
    for i in range(len(keyframes)):
        point = keyframe_points[keyframes[i], features[i]]
        if point < 0:
            continue
        before, link = -1, heads[point]
        while links[link, KEYFRAME] != keyframes[i]:
            before, link = link, links[link, NEXT]
        if before < 0:
            heads[point] = links[link, NEXT]
        else:
            links[before, NEXT] = links[link, NEXT]
        counts[point] -= 1
        keyframe_points[keyframes[i], features[i]] = -1
        if counts[point] < 2:
            _remove_point(point, lists)


@compiled
def remove_points(points: Any, lists: Links) -> None:
    """Remove points and their observations."""
    for point in points:
        _remove_point(point, lists)


@compiled
def _remove_point(point: int, lists: Links) -> None:
    link = lists.heads[point]
    while link >= 0:
        lists.keyframe_points[lists.links[link, KEYFRAME], lists.links[link, FEATURE]] = -1
        link = lists.links[link, NEXT]
    lists.heads[point] = -1
    lists.counts[point] = 0
    lists.alive[point] = False


@compiled
def replace_points(old: Any, new: Any, lists: Links, table: Replacements) -> None:
    """Let new[i] be seen wherever old[i] was, unless it is seen there already; old[i] dies."""
    for i in range(len(old)):
        _transfer_observations(old[i], new[i], lists)
        table.replaced_by[old[i]] = new[i]
        table.found_counts[new[i]] += table.found_counts[old[i]]
        table.visible_counts[new[i]] += table.visible_counts[old[i]]


@compiled
def _transfer_observations(old: int, new: int, lists: Links) -> None:
    heads, counts, links, keyframe_points, _ = lists
    link = heads[old]
    heads[old] = -1
    while link >= 0:
        after, keyframe = links[link, NEXT], links[link, KEYFRAME]
        other = heads[new]
        while other >= 0 and links[other, KEYFRAME] != keyframe:
            other = links[other, NEXT]
        is_observed = other >= 0
        keyframe_points[keyframe, links[link, FEATURE]] = -1 if is_observed else new
        if not is_observed:
            links[link, NEXT] = heads[new]
            heads[new] = link
            counts[new] += 1
        link = after
    _remove_point(old, lists)


@compiled
def count_covisible(points: Any, keyframe_count: int, heads: Any, links: Any) -> Any:
    """Return how many of `points` each keyframe sees (K,); negative indices are skipped."""
    counts = np.zeros(keyframe_count, np.int64)
    for p in points:
        link = heads[p] if p >= 0 else -1
        while link >= 0:
            counts[links[link, KEYFRAME]] += 1
            link = links[link, NEXT]
    return counts


@compiled
def rank_covisible(points: Any, excluded: int, keyframe_count: int, heads: Any, links: Any) -> Any:
    """Return the keyframes but `excluded` that see any of `points` (K,), and how many they see (K,).

    Those that see most come first, then the oldest; negative indices are skipped.
    """
    counts = count_covisible(points, keyframe_count, heads, links)
    if excluded >= 0:
        counts[excluded] = 0
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
    """Return `points` (N,) with replaced ones exchanged for their replacements and dead ones for -1."""
    resolved = np.full(len(points), -1, np.int64)
    for i in range(len(points)):
        point = points[i]
        while point >= 0 and replaced_by[point] >= 0:
            point = replaced_by[point]
        if point >= 0 and alive[point]:
            resolved[i] = point
    return resolved


@compiled
def list_observations(points: Any, included: Any, counts: Any, heads: Any, links: Any) -> Any:
    """Return index into `points`, keyframe, feature, (M,) each, of observations by keyframes `included` (K,), bool."""
    total = 0
    for p in points:
        total += counts[p]
    point_rows = np.empty(total, np.int64)
    keyframes = np.empty(total, np.int64)
    features = np.empty(total, np.int64)
    m = 0
    for i in range(len(points)):
        link = heads[points[i]]
        while link >= 0:
            if included[links[link, KEYFRAME]]:
                point_rows[m], keyframes[m], features[m] = i, links[link, KEYFRAME], links[link, FEATURE]
                m += 1
            link = links[link, NEXT]
    return point_rows[:m], keyframes[:m], features[:m]


@compiled
def union_of_points(keyframes: Any, keyframe_points: Any, point_count: int) -> Any:
    """Return the points that any of `keyframes` sees, ascending (P,)."""
    seen = np.zeros(point_count + 1, np.bool_)  # the last one is for features without a point
    for k in keyframes:
        for f in range(keyframe_points.shape[1]):
            point = keyframe_points[k, f]
            seen[np.uint64(point if point >= 0 else point_count)] = True
    return np.nonzero(seen[:point_count])[0]
