"""Merging duplicates: points searched in a keyframe that does not see them yet (ORB-SLAM VI-C)."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from codecbench.slam import thresholds
from codecbench.slam.camera import Camera
from codecbench.slam.features import CELL_PX
from codecbench.slam.hamming import hamming
from codecbench.slam.map import Indices, Map
from codecbench.slam.transforms import Array

_DISTANCE_MARGIN = 1.2
"""Times: how far a distance may leave the range that the pyramid covers (ORB-SLAM V-D, own margin)."""


class _Points(NamedTuple):
    """What a view of the points depends on; see PointTable."""

    positions: Any
    normals: Any
    min_distances: Any
    max_distances: Any
    descriptors: Any
    alive: Any


class _View(NamedTuple):
    """A keyframe's pose and features: `camera_from_world` (4, 4), `center` (3,) in the world, `intrinsics` (4,),
    `bounds` (4,) of the image, `scale_factors`; `points` (N,) that it sees; the rest as in Features."""

    camera_from_world: Any
    center: Any
    intrinsics: Any
    bounds: Any
    scale_factors: Any
    points: Any
    pixels: Any
    octaves: Any
    descriptors: Any
    cell_starts: Any
    cell_members: Any
    grid: Any


def fuse(slam_map: Map, camera: Camera, keyframe: int, points: Indices, camera_from_world: Array) -> int:
    """Project `points` into a keyframe: where a feature is free they are observed, where it shows another point the
    two become one, the one that more keyframes see. Returns how many were matched.

    `camera_from_world` (4, 4) may differ from the keyframe's pose: a corrected one while a loop is closed.
    """
    table, features = slam_map.points, slam_map.keyframes.features[keyframe]
    shown = slam_map.keyframes.points[keyframe, : len(features)]
    view = _View(
        camera_from_world, -(camera_from_world[:3, 3] @ camera_from_world[:3, :3]), camera.intrinsics, camera.bounds,
        slam_map.scale_factors, shown, features.pixels, features.octaves, features.descriptors, features.cell_starts,
        features.cell_members, features.grid,
    )  # fmt: skip
    columns = table.positions, table.normals, table.min_distances, table.max_distances, table.descriptors, table.alive
    candidates, found = _find_duplicates(points, _Points(*columns), view)
    others = shown[found]
    free = others < 0
    if free.any():
        slam_map.observe(keyframe, found[free], candidates[free])
    if not free.all():
        candidates, others = candidates[~free], others[~free]
        stronger = table.observation_counts[candidates] > table.observation_counts[others]
        slam_map.replace_points(np.where(stronger, others, candidates), np.where(stronger, candidates, others))
    return len(free)


@njit(cache=True)
def _find_duplicates(points: Any, table: _Points, view: _View) -> Any:
    """Those of `points` (P,) that features of a view may show though it does not see them, (N,), and the features (N,).

    A feature is given to the point that is nearest in Hamming distance, the first of equals.
    """
    points, pixels, octaves = _place(points, table, view)
    descriptors, pixels_b, octaves_b, descriptors_b = table.descriptors, view.pixels, view.octaves, view.descriptors
    starts, members, grid, scale_factors = view.cell_starts, view.cell_members, view.grid, view.scale_factors
    columns, rows = int(grid[2]), int(grid[3])
    winners = np.full(len(pixels_b), -1, np.int64)
    distances = np.full(len(pixels_b), thresholds.HAMMING_LOW + 1, np.int64)
    for i in range(len(points)):
        radius = thresholds.FUSE_WINDOW_PX * scale_factors[octaves[i]]
        x, y = pixels[i, 0] - grid[0], pixels[i, 1] - grid[1]
        left, right = max(int((x - radius) / CELL_PX), 0), min(int((x + radius) / CELL_PX) + 1, columns)
        best, best_distance = -1, thresholds.HAMMING_LOW + 1
        for row in range(max(int((y - radius) / CELL_PX), 0), min(int((y + radius) / CELL_PX) + 1, rows)):
            for f in members[starts[row * columns + left] : starts[row * columns + right]]:
                if octaves_b[f] < octaves[i] - 1 or octaves_b[f] > octaves[i]:
                    continue
                dx, dy, scale = (
                    pixels_b[f, 0] - pixels[i, 0],
                    pixels_b[f, 1] - pixels[i, 1],
                    scale_factors[octaves_b[f]],
                )
                if dx * dx + dy * dy >= thresholds.CHI2_95_2DOF * scale * scale:
                    continue
                distance = hamming(descriptors, points[i], descriptors_b, f)
                if distance < best_distance:
                    best, best_distance = f, distance
        if best >= 0 and best_distance < distances[best]:
            winners[best], distances[best] = points[i], best_distance
    found = np.nonzero(winners >= 0)[0]
    return winners[found], found


@njit(cache=True)
def _place(points: Any, table: _Points, view: _View) -> Any:
    """Those of `points` that a view should show and does not show yet: indices (N,), pixels (N, 2), levels (N,)."""
    positions, normals, min_distances, max_distances, _, alive = table
    pose, center, (fx, fy, cx, cy), bounds, scale_factors = view[:5]
    seen = np.zeros(len(alive), np.bool_)
    for point in view.points:
        if point >= 0:
            seen[point] = True
    kept, octaves = np.empty((2, len(points)), np.int64)
    pixels, count, top = np.empty((len(points), 2)), 0, len(scale_factors) - 1
    for p in points:
        if seen[p] or not alive[p]:
            continue
        x, y, z = positions[p, 0], positions[p, 1], positions[p, 2]
        depth = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
        if depth <= 1e-9:
            continue
        u = fx * (pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]) / depth + cx
        v = fy * (pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]) / depth + cy
        if not (bounds[0] <= u <= bounds[2] and bounds[1] <= v <= bounds[3]):
            continue
        x, y, z = x - center[0], y - center[1], z - center[2]
        distance = math.sqrt(x * x + y * y + z * z)
        if distance > max_distances[p] * _DISTANCE_MARGIN or distance * _DISTANCE_MARGIN < min_distances[p]:
            continue
        if x * normals[p, 0] + y * normals[p, 1] + z * normals[p, 2] < thresholds.VIEWING_COSINE * distance:
            continue
        octave = 0
        while octave < top and distance * scale_factors[octave] < max_distances[p] * (1.0 - 1e-9):
            octave += 1
        kept[count], octaves[count] = p, octave
        pixels[count, 0], pixels[count, 1] = u, v
        count += 1
    return kept[:count], pixels[:count], octaves[:count]
