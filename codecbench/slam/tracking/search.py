"""Compiled steps of tracking: search map points in a frame, and optimize its pose from them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from codecbench.core.kernels.compiled import compiled
from codecbench.slam import thresholds
from codecbench.slam.features.extractor import View
from codecbench.slam.features.matching import Queries, keep_consistent_rotations, search_windows
from codecbench.slam.geometry.rotations import orthonormalize
from codecbench.slam.map.projection import project_ahead, project_points
from codecbench.slam.map.tables import PointTable
from codecbench.slam.optimization.pose_optimization import optimize_in_place


class PointColumns(NamedTuple):
    """Columns of the point table that a search reads."""

    positions: Any
    normals: Any
    min_distances: Any
    max_distances: Any
    descriptors: Any
    visible_counts: Any
    """A search counts up these."""


class Lens(NamedTuple):
    """How a frame sees."""

    intrinsics: Any
    """fx, fy, cx, cy (4,)."""
    bounds: Any
    """Of the undistorted image (4,)."""
    scale_factors: Any
    """Of the pyramid levels (L,)."""


def columns_of(table: PointTable) -> PointColumns:
    """Return the current columns of a table; call again after the table has grown."""
    return PointColumns(
        table.positions,
        table.normals,
        table.min_distances,
        table.max_distances,
        table.descriptors,
        table.visible_counts,
    )


@compiled
def search_last_frame(
    last_points: Any, last_octaves: Any, last_angles: Any, window_px: float,
    table: PointColumns, lens: Lens, camera_from_world: Any, view: View, angles: Any, matched_points: Any,
) -> int:  # fmt: skip
    """Search the points of the last frame (N,) by feature, -1 for none, in windows around their predictions.

    `last_octaves`, `last_angles` (N,) are those of its features; `angles` (F,) those of this frame, whose points
    `matched_points` (F,) are filled in. Returns the number of matches.
    """
    seen = np.nonzero(last_points >= 0)[0]
    ahead, pixels = project_ahead(last_points[seen], table.positions, camera_from_world, lens.intrinsics)
    seen = seen[ahead]
    count = len(seen)
    points, radii, turns = last_points[seen], np.empty(count), last_angles[seen]
    low, high = np.empty(count, np.int64), np.empty(count, np.int64)
    for i in range(count):
        octave = np.int64(last_octaves[seen[i]])
        radii[i], low[i], high[i] = window_px * lens.scale_factors[octave], octave - 1, octave + 1
    queries = Queries(pixels, radii, low, high, points, table.descriptors)
    free = np.ones(len(matched_points), np.bool_)
    matches = search_windows(queries, view, free, thresholds.HAMMING_HIGH, thresholds.TRACK_RATIO)
    keep_consistent_rotations(matches, turns, angles)
    return _assign_points(matches, points, matched_points)


@compiled
def search_projections(
    points: Any, pixels: Any, octaves: Any, cosines: Any, widen: float,
    descriptors: Any, scale_factors: Any, view: View, matched_points: Any,
) -> int:  # fmt: skip
    """Search projected points among the features that show none yet; see Projections.

    Fills in the points `matched_points` (F,); returns the number of matches.
    """
    radii, low = np.empty(len(points)), octaves - 1
    for i in range(len(points)):
        frontal = cosines[i] > thresholds.FRONTAL_COSINE
        radius = thresholds.LOCAL_WINDOW_FRONTAL_PX if frontal else thresholds.LOCAL_WINDOW_PX
        radii[i] = radius * widen * scale_factors[octaves[i]]
    queries = Queries(pixels, radii, low, octaves, points, descriptors)
    matches = search_windows(queries, view, matched_points < 0, thresholds.HAMMING_HIGH, thresholds.LOCAL_RATIO)
    return _assign_points(matches, points, matched_points)


@compiled
def search_local_map(
    local: Any,
    table: PointColumns,
    point_count: int,
    lens: Lens,
    camera_from_world: Any,
    view: View,
    matched_points: Any,
) -> int:
    """Search the local points (N,) that a frame does not show yet; fills in `matched_points` (F,).

    Counts as visible what the frame shows and what it should show. Returns the number of matches.
    """
    unseen = np.ones(point_count, np.bool_)
    for point in matched_points:
        if point >= 0 and unseen[point]:
            unseen[point] = False
            table.visible_counts[point] += 1
    points = local[unseen[local]]
    visible, pixels, octaves, cosines = project_points(
        points, table.positions, table.normals, table.min_distances, table.max_distances,
        camera_from_world, lens.intrinsics, lens.bounds, lens.scale_factors, thresholds.VIEWING_COSINE,
    )  # fmt: skip
    points = points[visible]
    for point in points:
        table.visible_counts[point] += 1
    return int(
        search_projections(
            points, pixels, octaves, cosines, 1.0, table.descriptors, lens.scale_factors, view, matched_points
        )
    )  # fmt: skip


@compiled
def optimize_matched_pose(
    camera_from_world: Any,
    matched_points: Any,
    positions: Any,
    pixels: Any,
    octaves: Any,
    inverse_sigma2: Any,
    intrinsics: Any,
) -> int:
    """Move `camera_from_world` (4, 4) to fit the points `matched_points` (F,) by a frame's features; drops outliers.

    Returns the inliers; with fewer than four points nothing happens. See optimize_pose.
    """
    matched = np.nonzero(matched_points >= 0)[0]
    count = len(matched)
    if count < 4:
        return 0
    points, places, weights = np.empty((count, 3)), np.empty((count, 2)), np.empty(count)
    for i in range(count):
        point, feature = matched_points[matched[i]], matched[i]
        for k in range(3):
            points[i, k] = positions[point, k]
        places[i, 0], places[i, 1] = pixels[feature, 0], pixels[feature, 1]
        weights[i] = inverse_sigma2[octaves[feature]]
    inliers = np.zeros(count, np.bool_)
    optimize_in_place(camera_from_world, points, places, weights, intrinsics, inliers)
    rotation = orthonormalize(camera_from_world[:3, :3])
    for i in range(3):
        for j in range(3):
            camera_from_world[i, j] = rotation[i, j]
    for i in range(count):
        if not inliers[i]:
            matched_points[matched[i]] = -1
    return int(np.count_nonzero(inliers))


@compiled
def _assign_points(matches: Any, points: Any, matched_points: Any) -> int:
    """Write the matched points to `matched_points`; returns the number of matches."""
    count = 0
    for q in range(len(matches)):
        if matches[q] >= 0:
            matched_points[matches[q]] = points[q]
            count += 1
    return count
