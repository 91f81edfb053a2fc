"""Tracking a frame in the map: motion model, reference keyframe, local map (ORB-SLAM V)."""

from __future__ import annotations

import cv2
import numpy as np

from codecbench.slam import thresholds
from codecbench.slam.features.extractor import Features
from codecbench.slam.features.matching import keep_consistent_rotations, match_by_appearance
from codecbench.slam.geometry.camera import Camera
from codecbench.slam.geometry.rotations import Array
from codecbench.slam.geometry.transforms import se3_exp, se3_inverse, se3_log
from codecbench.slam.map.frame import TrackingFrame
from codecbench.slam.map.map import NONE, Indices, Map
from codecbench.slam.map.projection import Projections
from codecbench.slam.tracking.search import (
    Lens,
    columns_of,
    optimize_matched_pose,
    search_last_frame,
    search_local_map,
    search_projections,
)


class Tracker:
    """Follows the camera through one map; `last` is the last frame whose pose is known."""

    def __init__(self, slam_map: Map, camera: Camera) -> None:
        self.map = slam_map
        self.camera = camera
        self.last: TrackingFrame | None = None
        self._velocity: Array | None = None  # twist per second; None if unknown
        self._interval_s = 0.0
        self._lens = Lens(camera.intrinsics, camera.bounds, slam_map.scale_factors)

    def start(self, frame: TrackingFrame, velocity: Array | None = None) -> None:
        """Continue from `frame`, whose pose and points are known."""
        self.last = frame
        self._velocity = velocity

    def track(self, frame: TrackingFrame) -> int:
        """Find the pose and points of `frame`; returns the number of inliers, 0 if it is lost.

        On success `frame` has its pose, points and reference keyframe and is the new `last`. A frame that repeats the
        last image, as a stalled link does, gets the last pose and leaves the motion model unchanged.
        """
        assert self.last is not None
        self.last.points = self.map.resolve_points(self.last.points)
        if frame.features.same_as(self.last.features):
            frame.points, frame.reference = self.last.points.copy(), self.last.reference
            frame.camera_from_world = self.last.camera_from_world.copy()
            return len(frame.matched_features)
        if not (self._track_by_motion(frame) or self._track_by_keyframe(frame) or self._track_by_few_matches(frame)):
            return 0
        inliers = self.track_local_map(frame)
        if inliers < thresholds.LOCAL_MIN_INLIERS:
            return 0
        self._advance(frame)
        return inliers

    def _advance(self, frame: TrackingFrame) -> None:
        assert self.last is not None
        interval_s = frame.timestamp_s - self.last.timestamp_s
        motion = frame.camera_from_world @ se3_inverse(self.last.camera_from_world)
        self._velocity = se3_log(motion) / interval_s
        self._interval_s = interval_s
        self.last = frame

    # First guesses --------------------------------------------------------------------------------------------

    def _track_by_motion(self, frame: TrackingFrame) -> bool:
        """Search around the prediction of constant velocity, then in wider windows."""
        predicted = self._predict_pose(frame)
        if predicted is None:
            return False
        for window_deg in (thresholds.TRACK_WINDOW_DEG, thresholds.TRACK_WINDOW_WIDE_DEG):
            if self._match_last_frame(frame, predicted, window_deg) >= thresholds.TRACK_MIN_MATCHES:
                return self.optimize(frame) >= thresholds.TRACK_MIN_INLIERS
        return False

    def _track_by_few_matches(self, frame: TrackingFrame) -> bool:
        """Continue from few matches near their predictions: after a sharp turn at a low rate little is seen twice.

        The local map then decides whether the guess was right.
        """
        predicted = self._predict_pose(frame)
        if predicted is None:
            return False
        matches = self._match_last_frame(frame, predicted, thresholds.TRACK_WINDOW_DEG)
        return matches >= thresholds.TRACK_MIN_INLIERS and self.optimize(frame) >= thresholds.TRACK_MIN_INLIERS

    def _predict_pose(self, frame: TrackingFrame) -> Array | None:
        """Return the pose by constant velocity; None if the last frame is too long ago."""
        assert self.last is not None
        interval_s = frame.timestamp_s - self.last.timestamp_s
        if self._velocity is None:
            return self.last.camera_from_world
        if interval_s > thresholds.MAX_VELOCITY_GAP * self._interval_s:
            return None
        return np.asarray(se3_exp(self._velocity * interval_s) @ self.last.camera_from_world)

    def _match_last_frame(self, frame: TrackingFrame, camera_from_world: Array, window_deg: float) -> int:
        """Search the last frame's points where a pose predicts them; returns the number of matches."""
        assert self.last is not None
        frame.points[:] = NONE
        frame.camera_from_world = camera_from_world
        last, features = self.last, frame.features
        return int(
            search_last_frame(
                last.points, last.features.octaves, last.features.angles, self.camera.pixels_across(window_deg),
                columns_of(self.map.points), self._lens, frame.camera_from_world, features.view, features.angles,
                frame.points,
            )
        )  # fmt: skip

    def _track_by_keyframe(self, frame: TrackingFrame) -> bool:
        """Match by appearance with the last frame, then the reference keyframe; pose by P3P and RANSAC."""
        assert self.last is not None
        if self._track_by_appearance(frame, self.last.points, self.last.features, thresholds.KEYFRAME_RATIO):
            return True
        return self.guess_by_keyframe(frame, self.last.reference, thresholds.KEYFRAME_RATIO)

    def guess_by_keyframe(self, frame: TrackingFrame, keyframe: int, ratio: float) -> bool:
        """Guess the pose from the points of one keyframe, matched by appearance; returns whether it succeeds."""
        features = self.map.keyframes.features[keyframe]
        points = self.map.keyframes.points[keyframe, : len(features)]
        return self._track_by_appearance(frame, points, features, ratio)

    def _track_by_appearance(self, frame: TrackingFrame, points: Indices, features: Features, ratio: float) -> bool:
        seen = np.nonzero(points >= 0)[0]
        n, m = len(seen), len(frame.features)
        if n < thresholds.KEYFRAME_MIN_MATCHES or m < thresholds.KEYFRAME_MIN_MATCHES:
            return False
        matches = match_by_appearance(
            features.descriptors[seen], np.zeros(n, np.int64), np.ones(n, np.bool_),
            frame.features.descriptors, np.zeros(m, np.int64), np.ones(m, np.bool_),
            thresholds.HAMMING_LOW, ratio,
        )  # fmt: skip
        keep_consistent_rotations(matches, features.angles[seen], frame.features.angles)
        matched = np.nonzero(matches >= 0)[0]
        return self.solve_pose(frame, points[seen[matched]], matches[matched])

    def solve_pose(self, frame: TrackingFrame, points: Indices, features: Indices) -> bool:
        """Find the pose of `frame` from matches with outliers, by P3P and RANSAC, then by optimization."""
        if len(points) < thresholds.KEYFRAME_MIN_MATCHES:
            return False
        ok, rotation, translation, inliers = cv2.solvePnPRansac(
            self.map.points.positions[points], frame.features.pixels[features], self.camera.matrix, None,
            iterationsCount=thresholds.RELOCALIZATION_ITERATIONS, reprojectionError=thresholds.PNP_ERROR_PX,
            confidence=0.999, flags=cv2.SOLVEPNP_P3P,
        )  # fmt: skip
        if not ok or inliers is None or len(inliers) < thresholds.TRACK_MIN_INLIERS:
            return False
        frame.camera_from_world = np.eye(4)
        frame.camera_from_world[:3, :3] = cv2.Rodrigues(rotation)[0]
        frame.camera_from_world[:3, 3] = translation.ravel()
        frame.points[:] = NONE
        frame.points[features[inliers.ravel()]] = points[inliers.ravel()]
        return self.optimize(frame) >= thresholds.TRACK_MIN_INLIERS

    # Refinement -----------------------------------------------------------------------------------------------

    def optimize(self, frame: TrackingFrame) -> int:
        """Optimize the pose of `frame` over its points; outliers lose their match. Returns the inliers."""
        pose, features = frame.camera_from_world.copy(), frame.features
        inliers = optimize_matched_pose(
            pose, frame.points, self.map.points.positions, features.pixels, features.octaves,
            self.map.inverse_sigma2_of_points, self.camera.intrinsics,
        )  # fmt: skip
        frame.camera_from_world = pose
        return int(inliers)

    def track_local_map(self, frame: TrackingFrame) -> int:
        """Match `frame` with the local map and optimize its pose; returns the inliers."""
        local = self._local_points(frame)
        table = self.map.points
        search_local_map(
            local, columns_of(table), table.count, self._lens, frame.camera_from_world, frame.features.view,
            frame.points,
        )  # fmt: skip
        inliers = self.optimize(frame)
        table.found_counts[frame.points[frame.points >= 0]] += 1
        return inliers

    def _local_points(self, frame: TrackingFrame) -> Indices:
        """Return the points of keyframes that share points with `frame` and of their neighbors; sets its reference."""
        first = self.map.rank_covisible(frame.points)[0][: thresholds.LOCAL_KEYFRAMES].tolist()
        if not first:
            return np.empty(0, np.int64)
        frame.reference = first[0]
        keyframes = list(first)
        chosen = set(keyframes)
        for keyframe in first[:10]:
            if len(keyframes) >= thresholds.LOCAL_KEYFRAMES:
                break
            for neighbor in self.map.neighbors(keyframe, 5)[0].tolist():
                if neighbor not in chosen:
                    chosen.add(neighbor)
                    keyframes.append(neighbor)
                    break
        return self.map.points_of(np.array(keyframes))


def match_projections(slam_map: Map, frame: TrackingFrame, projections: Projections, widen: float) -> int:
    """Match projected points with features of `frame` that show none yet; returns the number of matches."""
    return int(
        search_projections(
            projections.points, projections.pixels, projections.octaves, projections.cosines, widen,
            slam_map.points.descriptors, slam_map.scale_factors, frame.features.view, frame.points,
        )
    )  # fmt: skip
