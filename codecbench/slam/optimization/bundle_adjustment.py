"""Bundle adjustment: keyframe poses and map points that minimize the robust reprojection error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from codecbench.slam.features.sorting import stable_order
from codecbench.slam.geometry.linear_systems import Indices, envelope_offsets, envelope_order, first_neighbors
from codecbench.slam.geometry.rotations import Array, orthonormalize
from codecbench.slam.optimization.bundle_kernels import (
    Observations,
    camera_adjacency,
    classify,
    minimize,
    robust_cost,
)
from codecbench.slam.optimization.bundle_schur import Layout
from codecbench.slam.thresholds import CHI2_95_2DOF

HUBER_95 = float(np.sqrt(CHI2_95_2DOF))
"""Error in units of its sigma above which Huber's kernel grows linearly (ORB-SLAM, appendix)."""

_ALWAYS_DENSE = 24  # keyframes: up to so many, finding the envelope costs more than it saves


@dataclass(frozen=True)
class Adjustment:
    """Result of a bundle adjustment."""

    camera_from_world: Array
    """Poses (K, 4, 4)."""
    points_world: Array
    """Points (P, 3)."""
    inliers: NDArray[np.bool_]
    """Observations (M,) in front of their camera with a chi-square of at most 5.991."""
    cost_before: float
    """Half the sum of the robust chi-squares of all observations."""
    cost_after: float
    """The same after the adjustment."""
    iterations: int
    """Steps tried in all rounds together."""


def adjust(
    camera_from_world: Array,
    points_world: Array,
    camera_indices: Indices,
    point_indices: Indices,
    pixels: Array,
    inverse_sigma2: Array,
    intrinsics: Array,
    fixed: NDArray[np.bool_],
    *,
    iterations: Sequence[int] = (5, 10),
    huber: float | None = HUBER_95,
    tolerance: float = 1e-4,
) -> Adjustment:
    """Return poses and points that minimize the reprojection error of all observations.

    `camera_from_world` (K, 4, 4); `points_world` (P, 3). Observation m is `pixels[m]` (M, 2), undistorted, of point
    `point_indices[m]` in camera `camera_indices[m]`, with `inverse_sigma2` (M,) in 1/px^2. `intrinsics` (4,): fx, fy,
    cx, cy; `fixed` (K,) marks cameras that stay.

    `iterations` gives the steps allowed in each round. After a round the outliers (behind the camera or chi-square
    above 5.991) leave, and after a later one they may come back. `huber` is in units of sigma, None for plain least
    squares. A round ends when a step lowers the cost by less than `tolerance` of it. With no or one fixed camera, the
    free gauge stays near where it was. A point with fewer than two observations in use stays and has no influence.

    Raises ValueError for arrays that do not fit together, indices out of range and values that are not finite. Sources:
    Triggs et al., "Bundle adjustment: a modern synthesis", 2000 (Schur complement); Levenberg-Marquardt with
    multiplicative damping; rounds as in ORB-SLAM, T-RO 31(5), 2015, where outliers never come back.
    """
    problem = _Problem(
        camera_from_world, points_world, camera_indices, point_indices, pixels, inverse_sigma2, intrinsics, fixed
    )
    kernel = np.inf if huber is None else float(huber)
    if not kernel > 0.0:
        raise ValueError(f"adjust: huber is {huber}; it must be above 0, or None")
    cost_before = problem.cost(kernel)
    active, steps = problem.all_active, 0
    for limit in iterations:
        steps += problem.minimize(active, kernel, int(limit), tolerance)
        active = problem.inliers()
    inliers = np.empty_like(active)
    inliers[problem.order] = active
    poses = np.tile(np.eye(4), (len(problem.poses), 1, 1))
    poses[:, :3] = problem.poses
    for k in np.flatnonzero(problem.layout.slots >= 0):
        poses[k, :3, :3] = orthonormalize(poses[k, :3, :3])
    return Adjustment(poses, problem.points, inliers, cost_before, problem.cost(kernel), steps)


class _Problem:
    """The arrays of one adjustment; observations are sorted by point, then by camera position in the system."""

    def __init__(
        self,
        camera_from_world: Array,
        points_world: Array,
        camera_indices: Indices,
        point_indices: Indices,
        pixels: Array,
        inverse_sigma2: Array,
        intrinsics: Array,
        fixed: NDArray[np.bool_],
    ) -> None:
        poses, self.points = np.asarray(camera_from_world, np.float64), np.array(points_world, np.float64)
        intrinsics, fixed = np.ascontiguousarray(intrinsics, np.float64), np.asarray(fixed, np.bool_)
        cameras, points = np.asarray(camera_indices, np.int64), np.asarray(point_indices, np.int64)
        pixels, inverse_sigma2 = np.asarray(pixels, np.float64), np.asarray(inverse_sigma2, np.float64)
        _check(poses, self.points, cameras, points, pixels, inverse_sigma2, intrinsics, fixed)
        self.poses = poses[:, :3, :].copy()
        self.layout = _layout(cameras, points, fixed, len(self.points))
        order = stable_order(self.layout.slots[cameras] + 1, len(self.layout.first) + 1)
        self.order = order[stable_order(points[order], len(self.points))]
        starts = np.concatenate([[0], np.cumsum(np.bincount(points, minlength=len(self.points)))]).astype(np.int64)
        self.all_active = np.ones(len(cameras), dtype=np.bool_)
        self.observations = Observations(
            cameras[self.order],
            starts,
            np.take(pixels, self.order, axis=0),
            np.sqrt(inverse_sigma2[self.order]),
            self.all_active,
            intrinsics,
        )

    def cost(self, huber: float) -> float:
        """Return half the robust cost of all observations."""
        return float(robust_cost(self.poses, self.points, self.observations, huber))

    def minimize(self, active: NDArray[np.bool_], huber: float, limit: int, tolerance: float) -> int:
        """Move poses and points by the active observations; returns the number of steps tried, at most `limit`."""
        observations = self.observations._replace(active=active)
        return int(minimize(self.poses, self.points, observations, self.layout, huber, limit, tolerance))

    def inliers(self) -> NDArray[np.bool_]:
        """Return which sorted observations are in front of their camera with a chi-square of at most 5.991."""
        inliers = np.empty(len(self.order), dtype=np.bool_)
        classify(self.poses, self.points, self.observations, CHI2_95_2DOF, inliers)
        return inliers


def _layout(cameras: Indices, points: Indices, fixed: NDArray[np.bool_], point_count: int) -> Layout:
    """Return the position of each camera in the reduced system and the system's envelope."""
    slots = np.full(len(fixed), -1, dtype=np.int64)
    free = np.flatnonzero(~fixed)
    slots[free] = np.arange(len(free))
    first = np.zeros(len(free), dtype=np.int64)
    if len(free) > _ALWAYS_DENSE:
        adjacency = camera_adjacency(slots[cameras], points, point_count, len(free))
        order = envelope_order(adjacency)
        slots[free[order]] = np.arange(len(free))
        first = first_neighbors(adjacency[np.ix_(order, order)])
    return Layout(slots, first, envelope_offsets(first, 6))


def _check(
    poses: Array,
    points: Array,
    camera_indices: Indices,
    point_indices: Indices,
    pixels: Array,
    weights: Array,
    intrinsics: Array,
    fixed: NDArray[np.bool_],
) -> None:
    """Raise ValueError unless the arrays fit together; the compiled kernels check nothing."""
    count = len(camera_indices)
    expected = {
        "camera_from_world": (poses, (len(poses), 4, 4)),
        "point_indices": (point_indices, (count,)),
        "pixels": (pixels, (count, 2)),
        "inverse_sigma2": (weights, (count,)),
        "points_world": (points, (len(points), 3)),
        "intrinsics": (intrinsics, (4,)),
        "fixed": (fixed, (len(poses),)),
    }
    for name, (array, shape) in expected.items():
        if array.shape != shape:
            raise ValueError(f"adjust: {name} has shape {array.shape}; expected {shape}")
        if not np.isfinite(array).all():
            raise ValueError(f"adjust: {name} has a value that is not finite")
    if (weights < 0.0).any():
        raise ValueError("adjust: inverse_sigma2 has a negative value")
    for name, indices, limit in (
        ("camera_indices", camera_indices, len(poses)),
        ("point_indices", point_indices, len(points)),
    ):
        if count and (indices.min() < 0 or indices.max() >= limit):
            raise ValueError(f"adjust: {name} span {indices.min()}..{indices.max()}; allowed 0..{limit - 1}")
