"""Fusing duplicate points: search points in a keyframe that does not see them yet (ORB-SLAM VI-C)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from codecbench.core.kernels.compiled import compiled
from codecbench.slam import thresholds
from codecbench.slam.features.extractor import CELL_PX
from codecbench.slam.features.hamming import hamming
from codecbench.slam.geometry.camera import Camera
from codecbench.slam.geometry.rotations import Array
from codecbench.slam.map.map import Indices, Map
from codecbench.slam.map.projection import project_points


class _Points(NamedTuple):
    """Columns of the point table that fusion reads; see PointTable."""

    positions: Any
    normals: Any
    min_distances: Any
    max_distances: Any
    descriptors: Any
    alive: Any


class _View(NamedTuple):
    """A keyframe's pose and features; for the fields without a description see Features."""

    camera_from_world: Any
    """Pose (4, 4)."""
    intrinsics: Any
    """fx, fy, cx, cy (4,)."""
    bounds: Any
    """Of the undistorted image (4,)."""
    scale_factors: Any
    """Of the pyramid levels (L,)."""
    pixel_variances: Any
    """Of the pyramid levels (L,), px^2."""
    points: Any
    """Map point of each feature (N,), -1 for none."""
    pixels: Any
    octaves: Any
    descriptors: Any
    cell_starts: Any
    cell_members: Any
    grid: Any


def fuse(slam_map: Map, camera: Camera, keyframe: int, points: Indices, camera_from_world: Array) -> int:
    """Project `points` into a keyframe and fuse them with what it shows there; returns how many were matched.

    If the matched feature is free, it observes the point. If it shows another point, the two become one: the one that
    more keyframes see. `camera_from_world` (4, 4) may differ from the keyframe's pose: it is a corrected one while a
    loop is closed.
    """
    table, features = slam_map.points, slam_map.keyframes.features[keyframe]
    seen_points = slam_map.keyframes.points[keyframe, : len(features)]
    view = _View(
        camera_from_world, camera.intrinsics, camera.bounds, slam_map.scale_factors, slam_map.pixel_variances,
        seen_points, features.pixels, features.octaves, features.descriptors, features.cell_starts,
        features.cell_members, features.grid,
    )  # fmt: skip
    columns = table.positions, table.normals, table.min_distances, table.max_distances, table.descriptors, table.alive
    candidates, matches = _find_duplicates(points, _Points(*columns), view)
    others = seen_points[matches]
    free = others < 0
    if free.any():
        slam_map.observe(keyframe, matches[free], candidates[free])
    if not free.all():
        candidates, others = candidates[~free], others[~free]
        stronger = table.observation_counts[candidates] > table.observation_counts[others]
        slam_map.replace_points(np.where(stronger, others, candidates), np.where(stronger, candidates, others))
    return len(free)


@compiled
def _find_duplicates(points: Any, table: _Points, view: _View) -> Any:
    """Return those of `points` (P,) that match features of a view but are not seen there (N,), and the features (N,).

    A feature goes to the point that is nearest in Hamming distance, the first of equals.
    """
    points = _unobserved_points(points, table.alive, view.points)
    visible, pixels, octaves, _ = project_points(
        points, table.positions, table.normals, table.min_distances, table.max_distances,
        view.camera_from_world, view.intrinsics, view.bounds, view.scale_factors, thresholds.VIEWING_COSINE,
    )  # fmt: skip
    points = points[visible]
    descriptors, pixels_b, octaves_b, descriptors_b = table.descriptors, view.pixels, view.octaves, view.descriptors
    starts, members, grid, scale_factors = view.cell_starts, view.cell_members, view.grid, view.scale_factors
    columns, rows = int(grid[2]), int(grid[3])
    winners = np.full(len(pixels_b), -1, np.int64)
    distances = np.full(len(pixels_b), thresholds.HAMMING_LOW + 1, np.int64)
    near = np.empty(len(pixels_b) + 1, np.int64)
    for i in range(len(points)):
        radius = thresholds.FUSE_WINDOW_PX * scale_factors[octaves[i]]
        x, y = pixels[i, 0] - grid[0], pixels[i, 1] - grid[1]
        left, right = max(int((x - radius) / CELL_PX), 0), min(int((x + radius) / CELL_PX) + 1, columns)
        count, octave = 0, octaves[i]
        for row in range(max(int((y - radius) / CELL_PX), 0), min(int((y + radius) / CELL_PX) + 1, rows)):
            for m in range(starts[row * columns + left], starts[row * columns + right]):
                f = members[m]
                dx, dy = pixels_b[f, 0] - pixels[i, 0], pixels_b[f, 1] - pixels[i, 1]
                limit = thresholds.CHI2_95_2DOF * view.pixel_variances[octaves_b[f]]
                near[count] = f  # no branch, which would be unpredictable
                count += (octaves_b[f] >= octave - 1) & (octaves_b[f] <= octave) & (dx * dx + dy * dy < limit)
        best, best_distance = -1, thresholds.HAMMING_LOW + 1
        for k in range(count):
            distance = hamming(descriptors, points[i], descriptors_b, near[k])
            if distance < best_distance:
                best, best_distance = near[k], distance
        if best >= 0 and best_distance < distances[best]:
            winners[best], distances[best] = points[i], best_distance
    matches = np.nonzero(winners >= 0)[0]
    return winners[matches], matches


@compiled
def _unobserved_points(points: Any, alive: Any, seen_points: Any) -> Any:
    """Return those of `points` (P,) that are alive and not seen in a view, (N,)."""
    seen = np.zeros(len(alive), np.bool_)
    for point in seen_points:
        if point >= 0:
            seen[point] = True
    unobserved, count = np.empty(len(points), np.int64), 0
    for point in points:
        if alive[point] and not seen[point]:
            unobserved[count] = point
            count += 1
    return unobserved[:count]
