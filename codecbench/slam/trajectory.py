"""What a run leaves behind: frames, trajectory, map, loops."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from codecbench.slam import thresholds
from codecbench.slam.geometry.camera import Camera
from codecbench.slam.geometry.rotations import Array
from codecbench.slam.geometry.transforms import se3_inverse
from codecbench.slam.map.frame import Frame
from codecbench.slam.map.map import Map
from codecbench.slam.optimisation.pose_optimization import optimize_pose

State = Literal["not_initialized", "tracked", "lost", "refused"]


@dataclass(frozen=True)
class FrameState:
    """What happened to one frame: its state and the reason for it, the map points that support its pose, whether it
    became a keyframe, and the map that it is in."""

    index: int
    timestamp_s: float
    state: State
    inliers: int = 0
    keyframe: bool = False
    map_index: int = 0
    reason: str = ""


@dataclass(frozen=True)
class LoopEvent:
    """A loop closed at `frame_index` with the keyframe of `matched_frame_index`, on `inliers` matches; `maps_merged`
    when it joined two maps."""

    frame_index: int
    matched_frame_index: int
    inliers: int
    maps_merged: bool = False


@dataclass(frozen=True)
class Trajectory:
    """Poses by time: `frame_indices` (N,), `timestamps_s` (N,), `world_from_camera` (N, 4, 4), in the map's unit."""

    frame_indices: NDArray[np.int64]
    timestamps_s: Array
    world_from_camera: Array

    def __len__(self) -> int:
        return len(self.timestamps_s)


@dataclass(frozen=True)
class MapResult:
    """One map of a run: `trajectory` after all corrections, `trajectory_before_loops` as tracked, `keyframe_indices`
    (K,) frame indices of the keyframes that are left, `points_world` (P, 3)."""

    index: int
    trajectory: Trajectory
    trajectory_before_loops: Trajectory
    keyframe_indices: NDArray[np.int64]
    points_world: Array


@dataclass(frozen=True)
class Result:
    """A run: a state for each frame, the loops, and the maps, the one with most frames first.

    `trajectory`, `trajectory_before_loops`, `keyframe_indices` and `points_world` are those of that first map.
    """

    frames: tuple[FrameState, ...]
    loops: tuple[LoopEvent, ...]
    maps: tuple[MapResult, ...]
    trajectory: Trajectory
    trajectory_before_loops: Trajectory
    keyframe_indices: NDArray[np.int64]
    points_world: Array


@dataclass(frozen=True)
class TrackedPose:
    """The pose of a tracked frame, held relative to its reference keyframe so that corrections of the map reach it.

    `reference_scale` is the stretch of the reference at that time; `world_from_camera` the pose as tracked, in the
    coordinates of a map without loop corrections; `points` (N,), `pixels` (N, 2), `octaves` (N,) what the frame saw.
    """

    index: int
    timestamp_s: float
    reference: int
    camera_from_reference: Array
    reference_scale: float
    world_from_camera: Array
    points: NDArray[np.int32]
    pixels: NDArray[np.float32]
    octaves: NDArray[np.int8]

    @classmethod
    def of(cls, frame: Frame, slam_map: Map, world_from_camera: Array) -> TrackedPose:
        """The pose of a tracked frame and what it saw."""
        seen = frame.matched
        return cls(
            frame.index, frame.timestamp_s, frame.reference,
            frame.camera_from_world @ se3_inverse(slam_map.pose(frame.reference)), slam_map.scale_of(frame.reference),
            world_from_camera, frame.points[seen].astype(np.int32), frame.features.pixels[seen].astype(np.float32),
            frame.features.octaves[seen].astype(np.int8),
        )  # fmt: skip

    def resolve(self, slam_map: Map) -> Array:
        """world_from_camera (4, 4) in the map as it is now."""
        step = self.camera_from_reference.copy()
        step[:3, 3] *= slam_map.scale_of(self.reference) / self.reference_scale
        return np.asarray(np.linalg.inv(step @ slam_map.pose(self.reference)))

    def refined(self, slam_map: Map, camera: Camera) -> TrackedPose:
        """The pose optimised anew over the points that the frame saw, where they are now.

        What bundle adjustments did to the points since then reaches the frame in full, not through its reference
        keyframe alone. Keyframes have their pose from the map, and stay; so does a frame with too few points left.
        """
        table = slam_map.keyframes
        if table.alive[self.reference] and table.frame_indices[self.reference] == self.index:
            return self
        points = slam_map.resolve_points(self.points.astype(np.int64))
        kept = points >= 0
        weights = np.asarray(slam_map.scale_factors[self.octaves[kept]] ** -2.0, np.float64)
        pose, inliers = optimize_pose(
            np.asarray(np.linalg.inv(self.resolve(slam_map)), np.float64), slam_map.points.positions[points[kept]],
            self.pixels[kept].astype(np.float64), weights, camera.intrinsics,
        )  # fmt: skip
        if int(inliers.sum()) < thresholds.LOCAL_MIN_INLIERS:
            return self
        camera_from_reference = pose @ se3_inverse(slam_map.pose(self.reference))
        scale = slam_map.scale_of(self.reference)
        return replace(self, camera_from_reference=camera_from_reference, reference_scale=scale)


def summarize_map(slam_map: Map, poses: list[TrackedPose]) -> MapResult:
    """The result of one map and the frames tracked in it."""
    indices = np.array([pose.index for pose in poses], dtype=np.int64)
    times = np.array([pose.timestamp_s for pose in poses], dtype=np.float64)
    resolved = np.array([pose.resolve(slam_map) for pose in poses]).reshape(-1, 4, 4)
    tracked = np.array([pose.world_from_camera for pose in poses]).reshape(-1, 4, 4)
    return MapResult(
        slam_map.index,
        Trajectory(indices, times, resolved),
        Trajectory(indices, times, tracked),
        slam_map.keyframes.frame_indices[slam_map.alive_keyframes].copy(),
        slam_map.points.positions[slam_map.alive_points].copy(),
    )


def summarize(frames: list[FrameState], loops: list[LoopEvent], maps: list[tuple[Map, list[TrackedPose]]]) -> Result:
    """The result of a run over `maps`, each with the frames tracked in it."""
    results = sorted((summarize_map(*entry) for entry in maps), key=lambda m: (-len(m.trajectory), m.index))
    if results:
        main = results[0]
    else:
        empty = Trajectory(np.empty(0, np.int64), np.empty(0), np.empty((0, 4, 4)))
        main = MapResult(0, empty, empty, np.empty(0, np.int64), np.empty((0, 3)))
    return Result(
        tuple(frames), tuple(loops), tuple(results),
        main.trajectory, main.trajectory_before_loops, main.keyframe_indices, main.points_world,
    )  # fmt: skip
