"""Matching features in predicted windows and by appearance; triangulation.py matches on epipolar lines.

Each search returns, for each query, the index of its feature or -1. A feature goes to the query nearest in Hamming
distance, the first of equals, so that no feature is used twice.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from codecbench.core.kernels.compiled import compiled
from codecbench.slam.features.extractor import CELL_PX, Features, View
from codecbench.slam.features.hamming import hamming
from codecbench.slam.features.sorting import stable_order
from codecbench.slam.thresholds import ROTATION_BINS, ROTATION_PEAKS

Indices = NDArray[np.int64]
_FAR = 512  # above any distance of 256 bits


def match_in_windows(
    pixels: NDArray[np.float64],
    radii: NDArray[np.float64],
    octaves_low: NDArray[np.int64],
    octaves_high: NDArray[np.int64],
    descriptors: NDArray[np.uint64],
    features: Features,
    free: NDArray[np.bool_],
    max_distance: int,
    ratio: float = 1.0,
) -> Indices:
    """Match queries with the features near their predicted positions.

    Queries: `pixels` (Q, 2) predicted, `radii` (Q,) pixels, levels `octaves_low`..`octaves_high` (Q,), `descriptors`
    (Q, 4). `free` (N,) marks the features that may be matched. A best match is rejected if it is beyond `max_distance`
    bits, or not nearer than `ratio` times the second best on the same level. Returns feature indices (Q,), -1 for none.
    """
    queries = Queries(pixels, radii, octaves_low, octaves_high, np.arange(len(pixels)), descriptors)
    return np.asarray(search_windows(queries, features.view, free, max_distance, ratio))


class Queries(NamedTuple):
    """Queries of a search in windows; see match_in_windows."""

    pixels: Any
    radii: Any
    octaves_low: Any
    octaves_high: Any
    rows: Any
    """Row of each query's descriptor in `descriptors` (Q,)."""
    descriptors: Any


@compiled
def search_windows(queries: Queries, view: View, free: Any, max_distance: int, ratio: float) -> Any:
    """Match as match_in_windows does, for compiled code."""
    pixels, radii, octaves_low, octaves_high, rows, descriptors = queries
    feature_pixels, feature_octaves, feature_descriptors, starts, members, grid = view
    columns, lines = int(grid[2]), int(grid[3])
    matches = np.full(len(pixels), -1, np.int64)
    owners = np.full(len(feature_pixels), -1, np.int64)
    distances = np.full(len(feature_pixels), _FAR, np.int64)
    near = np.empty(len(feature_pixels) + 1, np.int64)
    for q in range(len(pixels)):
        x, y, radius, low, high = pixels[q, 0], pixels[q, 1], radii[q], octaves_low[q], octaves_high[q]
        first_column = max(int((x - radius - grid[0]) / CELL_PX), 0)
        last_column = min(int((x + radius - grid[0]) / CELL_PX), columns - 1)
        first_line = max(int((y - radius - grid[1]) / CELL_PX), 0)
        last_line = min(int((y + radius - grid[1]) / CELL_PX), lines - 1)
        if first_column > last_column:
            continue
        count = 0
        for line in range(first_line, last_line + 1):
            for m in range(starts[line * columns + first_column], starts[line * columns + last_column + 1]):
                f = members[m]
                octave, dx, dy = feature_octaves[f], abs(feature_pixels[f, 0] - x), abs(feature_pixels[f, 1] - y)
                near[count] = f  # no branch, which would be unpredictable
                count += free[f] & (octave >= low) & (octave <= high) & (dx <= radius) & (dy <= radius)
        best, second, best_feature, best_octave, second_octave = _FAR, _FAR, -1, -1, -1
        for k in range(count):
            f = near[k]
            distance = hamming(descriptors, rows[q], feature_descriptors, f)
            if distance < best:
                second, second_octave = best, best_octave
                best, best_feature, best_octave = distance, f, feature_octaves[f]
            elif distance < second:
                second, second_octave = distance, feature_octaves[f]
        if best > max_distance or (best_octave == second_octave and best > ratio * second):
            continue
        claim(q, best_feature, best, matches, owners, distances)
    return matches


@compiled
def claim(query: int, feature: int, distance: int, matches: Any, owners: Any, distances: Any) -> None:
    """Assign `feature` to `query` if the current owner, which then loses it, is further away; updates all in place.

    `matches` (Q,) by query; `owners` (F,), -1 for none, and their Hamming `distances` (F,) by feature.
    """
    if distance < distances[feature]:
        if owners[feature] >= 0:
            matches[owners[feature]] = -1
        owners[feature], distances[feature], matches[query] = query, distance, feature


@compiled
def match_by_appearance(
    descriptors_a: Any, nodes_a: Any, usable_a: Any, descriptors_b: Any, nodes_b: Any, usable_b: Any,
    max_distance: int, ratio: float,
) -> Any:  # fmt: skip
    """Match descriptors (N, 4) with descriptors (M, 4) under the same vocabulary node; returns (N,), -1 for none.

    `nodes_a` (N,), `nodes_b` (M,) are the nodes; if all are equal, every pair is compared. `usable_a`, `usable_b` are
    masks. The best match must be within `max_distance` bits and nearer than `ratio` times the second best.
    """
    matches = np.full(len(descriptors_a), -1, np.int64)
    owners = np.full(len(descriptors_b), -1, np.int64)
    distances = np.full(len(descriptors_b), _FAR, np.int64)
    greatest = 0
    for j in range(len(nodes_b)):
        greatest = max(greatest, nodes_b[j])
    order = stable_order(nodes_b, greatest + 1)
    sorted_nodes = nodes_b[order]
    for i in range(len(descriptors_a)):
        if not usable_a[i]:
            continue
        best, second, best_feature = _FAR, _FAR, -1
        start = np.searchsorted(sorted_nodes, nodes_a[i], side="left")
        for k in range(start, len(order)):
            if sorted_nodes[k] != nodes_a[i]:
                break
            j = order[k]
            if not usable_b[j]:
                continue
            distance = hamming(descriptors_a, i, descriptors_b, j)
            if distance < best:
                second, best, best_feature = best, distance, j
            elif distance < second:
                second = distance
        if best <= max_distance and best < ratio * second:
            claim(i, best_feature, best, matches, owners, distances)
    return matches


@compiled
def keep_consistent_rotations(matches: Any, angles_a: Any, angles_b: Any) -> Any:
    """Set to -1, in place, matches whose rotation (angle a minus angle b) is not among the histogram's peaks.

    `matches` (N,) index `angles_b`; angles in radians. The ROTATION_PEAKS fullest of ROTATION_BINS bins count as peaks,
    the second and third only if they hold a tenth of the first. Returns `matches`.
    """
    bins = np.full(len(matches), -1, np.int64)
    counts = np.zeros(ROTATION_BINS, np.int64)
    for i in range(len(matches)):
        if matches[i] >= 0:
            turn = (angles_a[i] - angles_b[matches[i]]) / (2.0 * math.pi)
            bins[i] = int((turn - math.floor(turn)) * ROTATION_BINS) % ROTATION_BINS
            counts[bins[i]] += 1
    peak, visited, fullest = np.zeros(ROTATION_BINS, np.bool_), np.zeros(ROTATION_BINS, np.bool_), 0
    for _ in range(ROTATION_PEAKS):
        fuller = -1
        for k in range(ROTATION_BINS):
            if not visited[k] and (fuller < 0 or counts[k] > counts[fuller]):
                fuller = k
        fullest = max(fullest, counts[fuller])
        visited[fuller], peak[fuller] = True, counts[fuller] * 10 >= fullest
    for i in range(len(matches)):
        if matches[i] >= 0 and not peak[bins[i]]:
            matches[i] = -1
    return matches
