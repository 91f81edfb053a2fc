"""Poses of tracked frames, relative to keyframes so that corrections of the map reach them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from codecbench.slam import thresholds
from codecbench.slam.geometry.camera import Camera
from codecbench.slam.geometry.rotations import Array
from codecbench.slam.geometry.transforms import se3_inverse, sim3_compose, sim3_scale
from codecbench.slam.map.frame import TrackingFrame
from codecbench.slam.map.map import Indices, Map
from codecbench.slam.optimization.pose_optimization import optimize_pose


@dataclass(frozen=True)
class TrackedPose:
    """The pose of a tracked frame relative to its reference keyframe, and the points that it saw."""

    index: int
    timestamp_s: float
    reference: int
    """Index of the reference keyframe."""
    camera_from_reference: Array
    """Relative pose (4, 4)."""
    reference_scale: float
    """Scale of the reference when the frame was tracked."""
    world_from_camera: Array
    """Pose as tracked (4, 4), in the coordinates of a map without loop corrections."""
    points: NDArray[np.int32]
    """Map points that the frame saw (N,)."""
    pixels: NDArray[np.float32]
    """Where it saw them (N, 2)."""
    octaves: NDArray[np.int8]
    """Pyramid levels at which it saw them (N,)."""

    @classmethod
    def of(cls, frame: TrackingFrame, slam_map: Map, world_from_camera: Array) -> TrackedPose:
        """Return the pose of a tracked frame and what it saw."""
        seen = frame.matched_features
        return cls(
            frame.index, frame.timestamp_s, frame.reference,
            frame.camera_from_world @ se3_inverse(slam_map.pose(frame.reference)), slam_map.scale_of(frame.reference),
            world_from_camera, frame.points[seen].astype(np.int32), frame.features.pixels[seen].astype(np.float32),
            frame.features.octaves[seen].astype(np.int8),
        )  # fmt: skip

    def move_to_map(self, numbers: Indices, first_point: int, new_from_old: Array) -> TrackedPose:
        """Return the same pose after its map has become part of another; see Map.append.

        `new_from_old` (4, 4), a similarity, moves the pose as tracked.
        """
        return replace(
            self,
            reference=int(numbers[self.reference]),
            points=self.points + np.int32(first_point),
            world_from_camera=transform_camera(new_from_old, self.world_from_camera),
        )

    def resolve(self, slam_map: Map) -> Array:
        """Return world_from_camera (4, 4) in the map as it is now."""
        step = self.camera_from_reference.copy()
        step[:3, 3] *= slam_map.scale_of(self.reference) / self.reference_scale
        return np.asarray(np.linalg.inv(step @ slam_map.pose(self.reference)))

    def refine(self, slam_map: Map, camera: Camera) -> TrackedPose:
        """Return the pose optimized again over the points that the frame saw, at their current positions.

        Bundle adjustments of the points then reach the frame in full, not through its reference keyframe alone.
        Keyframes have their pose from the map and stay; so does a frame with too few points left.
        """
        table = slam_map.keyframes
        if table.alive[self.reference] and table.frame_indices[self.reference] == self.index:
            return self
        points = slam_map.resolve_points(self.points.astype(np.int64))
        alive = points >= 0
        weights = slam_map.inverse_sigma2_of_points[self.octaves[alive]]
        pose, inliers = optimize_pose(
            np.asarray(np.linalg.inv(self.resolve(slam_map)), np.float64), slam_map.points.positions[points[alive]],
            self.pixels[alive].astype(np.float64), weights, camera.intrinsics,
        )  # fmt: skip
        if int(inliers.sum()) < thresholds.LOCAL_MIN_INLIERS:
            return self
        camera_from_reference = pose @ se3_inverse(slam_map.pose(self.reference))
        scale = slam_map.scale_of(self.reference)
        return replace(self, camera_from_reference=camera_from_reference, reference_scale=scale)


def transform_camera(new_from_old: Array, old_from_camera: Array) -> Array:
    """Return the rigid pose `new_from_camera` (4, 4) of a camera whose world a similarity moves."""
    pose = np.asarray(sim3_compose(new_from_old, old_from_camera))
    pose[:3, :3] /= sim3_scale(pose)
    return pose
