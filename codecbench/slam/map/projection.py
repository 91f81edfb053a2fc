"""Projection of map points into a view."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from codecbench.core.kernels.compiled import compiled
from codecbench.slam import thresholds
from codecbench.slam.geometry.camera import Camera
from codecbench.slam.geometry.rotations import Array
from codecbench.slam.map.map import Indices, Map


@dataclass(frozen=True)
class Projections:
    """The points that a view should show."""

    points: Indices
    """Indices of the points (N,)."""
    pixels: Array
    """Where they should appear (N, 2)."""
    octaves: NDArray[np.int64]
    """Pyramid levels (N,) at which they should appear."""
    cosines: Array
    """Between the ray and the mean viewing direction (N,)."""


def project_map_points(
    slam_map: Map, points: Indices, camera_from_world: Array, camera: Camera, min_cosine: float
) -> Projections:
    """Return those of `points` that the camera should see (ORB-SLAM V-D).

    They lie in front of it, inside the image, at a distance that the pyramid covers, and are seen from within
    acos(`min_cosine`) of their mean viewing direction.
    """
    table = slam_map.points
    visible, pixels, octaves, cosines = project_points(
        points, table.positions, table.normals, table.min_distances, table.max_distances,
        camera_from_world, camera.intrinsics, camera.bounds, slam_map.scale_factors, min_cosine,
    )  # fmt: skip
    return Projections(points[visible], pixels, octaves, cosines)


@compiled
def project_ahead(points: Any, positions: Any, camera_from_world: Any, intrinsics: Any) -> Any:
    """Return which of `points` (N,) lie ahead of the camera, as indices into them (M,), and their pixels (M, 2)."""
    fx, fy, cx, cy = intrinsics
    pose = camera_from_world
    ahead = np.empty(len(points), np.int64)
    pixels = np.empty((len(points), 2))
    count = 0
    for i in range(len(points)):
        x, y, z = positions[points[i]]
        depth = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
        if depth > 0.0:
            ahead[count] = i
            pixels[count, 0] = fx * (pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]) / depth + cx
            pixels[count, 1] = fy * (pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]) / depth + cy
            count += 1
    return ahead[:count], pixels[:count]


@compiled
def project_points(
    points: Any, positions: Any, normals: Any, min_distances: Any, max_distances: Any,
    camera_from_world: Any, intrinsics: Any, bounds: Any, scale_factors: Any, min_cosine: float,
) -> Any:  # fmt: skip
    """Project as project_map_points does, from columns of the point table, for compiled code.

    Returns which of `points` (N,) should be seen, as indices into them (M,), their pixels (M, 2), octaves (M,) and
    cosines (M,).
    """
    fx, fy, cx, cy = intrinsics
    pose = camera_from_world
    n = len(points)
    visible = np.empty(n, np.int64)
    pixels = np.empty((n, 2))
    octaves = np.empty(n, np.int64)
    cosines = np.empty(n)
    top = len(scale_factors) - 1
    log_step = math.log(scale_factors[1] / scale_factors[0]) if top > 0 else 1.0
    center = -(pose[:3, 3].copy() @ pose[:3, :3].copy())
    count = 0
    for i in range(n):
        p = points[i]
        x, y, z = positions[p, 0], positions[p, 1], positions[p, 2]
        depth = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
        if depth <= 1e-9:
            continue
        u = fx * (pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]) / depth + cx
        v = fy * (pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]) / depth + cy
        if not (bounds[0] <= u <= bounds[2] and bounds[1] <= v <= bounds[3]):
            continue
        rx, ry, rz = x - center[0], y - center[1], z - center[2]
        distance = math.sqrt(rx * rx + ry * ry + rz * rz)
        if (
            distance > max_distances[p] * thresholds.DISTANCE_MARGIN
            or distance * thresholds.DISTANCE_MARGIN < min_distances[p]
        ):
            continue
        cosine = (rx * normals[p, 0] + ry * normals[p, 1] + rz * normals[p, 2]) / distance
        if cosine < min_cosine:
            continue
        octave = math.ceil(math.log(max_distances[p] / distance) / log_step - 1e-9)
        visible[count] = i
        pixels[count, 0], pixels[count, 1] = u, v
        octaves[count] = min(max(octave, 0), top)
        cosines[count] = cosine
        count += 1
    return visible[:count], pixels[:count], octaves[:count], cosines[:count]
