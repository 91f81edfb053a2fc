"""One map with what works on it: tracker, mapper, loop detector, and the frames tracked in it."""

from __future__ import annotations

import math

import numpy as np

from codecbench.slam import thresholds
from codecbench.slam.geometry.camera import Camera
from codecbench.slam.geometry.transforms import se3_inverse, sim3_compose, sim3_scale
from codecbench.slam.map.frame import Frame
from codecbench.slam.map.map import Map
from codecbench.slam.mapping.loop_closing import adjust_map, close_loop
from codecbench.slam.mapping.loop_detection import LoopDetector
from codecbench.slam.mapping.mapper import Mapper
from codecbench.slam.tracking.relocalization import relocalize
from codecbench.slam.tracking.tracker import Tracker
from codecbench.slam.trajectory import LoopEvent, TrackedPose


class Session:
    """A map that is being tracked in, or was."""

    def __init__(self, slam_map: Map, mapper: Mapper, camera: Camera, rng: np.random.Generator) -> None:
        self.map = slam_map
        self.poses: list[TrackedPose] = []
        self._camera = camera
        self._mapper = mapper
        self._tracker = Tracker(slam_map, camera)
        self._detector = LoopDetector(slam_map, camera, mapper.places, rng)
        self._last_keyframe_s = -math.inf
        self._last_loop_keyframe = -thresholds.LOOP_MIN_GAP_KEYFRAMES
        self._old_from_new = np.eye(4)  # similarity: coordinates without loop corrections from the map's

    def start(self, frame: Frame) -> None:
        """Go on from `frame`, the map's newest keyframe."""
        self._tracker.start(frame)
        self._last_keyframe_s = frame.timestamp_s

    def track(self, frame: Frame) -> int:
        """Pose of `frame` from the one before; returns the inliers, 0 when it is lost."""
        return self._tracker.track(frame)

    def relocalize(self, frame: Frame) -> int:
        """Pose of `frame` from keyframes that look like it; returns the inliers, 0 when it stays lost."""
        return relocalize(frame, self._tracker, self._mapper.places)

    def wants_keyframe(self, frame: Frame, inliers: int) -> bool:
        """Whether `frame` should become a keyframe (ORB-SLAM V-E; the time rules stand for a busy mapper)."""
        slam_map = self.map
        needed = min(thresholds.KEYFRAME_REFERENCE_OBSERVATIONS, len(slam_map.alive_keyframes))
        points = slam_map.keyframes.points[frame.reference]
        points = points[points >= 0]
        share = inliers / max(int((slam_map.points.observation_counts[points] >= needed).sum()), 1)
        waited = frame.timestamp_s - self._last_keyframe_s >= thresholds.KEYFRAME_MIN_INTERVAL_S - 1e-3
        if share < thresholds.KEYFRAME_URGENT_SHARE:
            return True
        return waited and (share < thresholds.KEYFRAME_MAX_SHARE or inliers < thresholds.KEYFRAME_FEW_INLIERS)

    def add_keyframe(self, frame: Frame, loop_closing: bool) -> LoopEvent | None:
        """Make `frame` a keyframe; returns the loop that it closes, if it does."""
        keyframe = self._mapper.insert(frame)
        self._last_keyframe_s = frame.timestamp_s
        if not loop_closing or keyframe - self._last_loop_keyframe < thresholds.LOOP_MIN_GAP_KEYFRAMES:
            return None
        loop = self._detector.detect(keyframe)
        if loop is None:
            return None
        self._last_loop_keyframe = keyframe
        old_from_new = close_loop(self.map, self._camera, loop)
        self._old_from_new = np.asarray(sim3_compose(self._old_from_new, old_from_new))
        table = self.map.keyframes
        frame.camera_from_world = table.camera_from_world[keyframe].copy()
        frame.points = table.points[keyframe, : len(frame.features)].copy()
        return LoopEvent(frame.index, int(table.frame_indices[loop.matched]), loop.inliers)

    def record(self, frame: Frame) -> None:
        """Keep the pose of a tracked frame."""
        world_from_camera = np.asarray(sim3_compose(self._old_from_new, se3_inverse(frame.camera_from_world)))
        world_from_camera[:3, :3] /= sim3_scale(world_from_camera)
        self.poses.append(TrackedPose.of(frame, self.map, world_from_camera))

    def finish(self, adjust: bool) -> None:
        """Adjust the whole map a last time, if so wanted, and then the frames to it."""
        if adjust:
            adjust_map(self.map, self._camera)
            self.poses = [pose.refined(self.map, self._camera) for pose in self.poses]
