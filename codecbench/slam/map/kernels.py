"""The inner loops of the map: which keyframe sees which point.

The observations of a point form a linked list: `heads[p]` is its first link; a row of `links` (L, 3) holds the next
link, -1 at the end, and the keyframe and the feature that show the point, side by side in memory.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from codecbench.core.kernels.compiled import compiled
from codecbench.slam.features.sorting import stable_order

NEXT, KEYFRAME, FEATURE = 0, 1, 2  # columns of the links


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
        links[link, NEXT], links[link, KEYFRAME], links[link, FEATURE] = heads[points[i]], keyframes[i], features[i]
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
        while links[link, KEYFRAME] != keyframes[i]:
            before, link = link, links[link, NEXT]
        if before < 0:
            heads[point] = links[link, NEXT]
        else:
            links[before, NEXT] = links[link, NEXT]
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
        lists.keyframe_points[lists.links[link, KEYFRAME], lists.links[link, FEATURE]] = -1
        link = lists.links[link, NEXT]
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
        after, keyframe = links[link, NEXT], links[link, KEYFRAME]
        other = heads[new]
        while other >= 0 and links[other, KEYFRAME] != keyframe:
            other = links[other, NEXT]
        taken = other >= 0
        keyframe_points[keyframe, links[link, FEATURE]] = -1 if taken else new
        if not taken:
            links[link, NEXT] = heads[new]
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
            counts[links[link, KEYFRAME]] += 1
            link = links[link, NEXT]
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
            if wanted[links[link, KEYFRAME]]:
                which[m], keyframes[m], features[m] = i, links[link, KEYFRAME], links[link, FEATURE]
                m += 1
            link = links[link, NEXT]
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
