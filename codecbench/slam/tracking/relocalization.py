"""Relocalization: finding a lost camera in its map (ORB-SLAM V-C), and frames in a finished map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from codecbench.slam import thresholds
from codecbench.slam.features.extractor import FeatureExtractor, Features, ImageArray, Keypoints, to_gray
from codecbench.slam.geometry.camera import Camera
from codecbench.slam.geometry.rotations import Array
from codecbench.slam.map.frame import TrackingFrame
from codecbench.slam.map.map import NONE, Map
from codecbench.slam.map.projection import project_map_points
from codecbench.slam.options import Options
from codecbench.slam.places.recognition import PlaceRecognition, relocalization_candidates
from codecbench.slam.tracking.tracker import Tracker, match_projections


def relocalize(frame: TrackingFrame, tracker: Tracker, keyframe: int) -> int:
    """Find the pose of `frame` from a similar keyframe; returns the inliers, 0 if the frame stays lost.

    The two are matched by appearance. A pose by P3P and RANSAC is optimized, widened by projecting the keyframe's
    points, and accepted with RELOCALIZED_MIN_INLIERS inliers in the local map. A frame that stays lost shows no points.
    """
    inliers = _search(frame, tracker, keyframe)
    if inliers < thresholds.RELOCALIZED_MIN_INLIERS:
        frame.points[:] = NONE
        return 0
    tracker.start(frame)
    return inliers


def _search(frame: TrackingFrame, tracker: Tracker, keyframe: int) -> int:
    if not tracker.guess_by_keyframe(frame, keyframe, thresholds.RELOCALIZATION_RATIO):
        return 0
    points = tracker.map.keyframes.points[keyframe]
    points = np.setdiff1d(points[points >= 0], frame.points)
    projections = project_map_points(
        tracker.map, points, frame.camera_from_world, tracker.camera, thresholds.VIEWING_COSINE
    )
    match_projections(tracker.map, frame, projections, thresholds.RELOCALIZATION_WIDENING)
    if tracker.optimize(frame) < thresholds.TRACK_MIN_INLIERS:
        return 0
    return tracker.track_local_map(frame)


@dataclass(frozen=True)
class Location:
    """Pose of a frame in a map."""

    camera_from_world: Array
    """Pose (4, 4) in the map's unit."""
    inliers: int
    """Map points that support it."""


class Localizer:
    """Locates frames in a finished map, which stays unchanged.

    The answer for a frame depends on the map and the frame, not on other frames.
    """

    def __init__(self, slam_map: Map, camera: Camera, options: Options) -> None:
        self.map = slam_map
        self._extractor = FeatureExtractor(camera, options)
        self._tracker = Tracker(slam_map, camera)
        self._camera = camera
        self._places = PlaceRecognition(slam_map)
        self._keyframes = slam_map.alive_keyframes
        for keyframe in self._keyframes:
            self._places.add(int(keyframe), slam_map.keyframes.features[keyframe])

    def extract(self, image: ImageArray) -> Features:
        """Return the features of an image, gray (height, width) or RGB (height, width, 3), uint8."""
        return self._extractor.extract(to_gray(image))

    def features_of(self, keypoints: Keypoints) -> Features:
        """Return the features for an image's keypoints, from a pyramid like the map's."""
        return self._extractor.features_of(keypoints)

    def locate_near(self, features: Features, camera_from_world: Array) -> Location | None:
        """Return the pose of a frame near a predicted one, as tracking would find it; None if it is lost.

        The points of the keyframe with the most similar view are searched around the prediction, in the windows of
        tracking, then those of the local map (ORB-SLAM V-B, V-D). The keyframe stands for the previous frame, from
        which tracking would take the points.
        """
        frame = TrackingFrame.of(0, 0.0, features)
        points = self.map.keyframes.points[self._nearest_keyframe(camera_from_world)]
        points = points[points >= 0]
        for window_deg in (thresholds.TRACK_WINDOW_DEG, thresholds.TRACK_WINDOW_WIDE_DEG):
            frame.points[:] = NONE
            frame.camera_from_world = camera_from_world.copy()
            projections = project_map_points(
                self.map, points, camera_from_world, self._camera, thresholds.VIEWING_COSINE
            )
            widen = self._camera.pixels_across(window_deg) / thresholds.LOCAL_WINDOW_PX
            if match_projections(self.map, frame, projections, widen) >= thresholds.TRACK_MIN_MATCHES:
                break
        else:
            return None
        if self._tracker.optimize(frame) < thresholds.TRACK_MIN_INLIERS:
            return None
        inliers = self._tracker.track_local_map(frame)
        return Location(frame.camera_from_world, inliers) if inliers >= thresholds.LOCAL_MIN_INLIERS else None

    def locate(self, features: Features) -> Location | None:
        """Return the pose of a frame without a prediction, from similar keyframes; None if none of them fits."""
        frame = TrackingFrame.of(0, 0.0, features)
        ranked = relocalization_candidates(features, [self._places])
        for _, keyframe in ranked[: thresholds.RELOCALIZATION_CANDIDATES]:
            if inliers := relocalize(frame, self._tracker, keyframe):
                return Location(frame.camera_from_world, inliers)
        return None

    def scene_depth(self) -> float:
        """Return the median depth of the points that the keyframes see, in the map's unit."""
        depths = []
        for keyframe in self._keyframes:
            points = self.map.keyframes.points[keyframe]
            pose = self.map.keyframes.camera_from_world[keyframe]
            depths.append(self.map.points.positions[points[points >= 0]] @ pose[2, :3] + pose[2, 3])
        return float(np.median(np.concatenate(depths)))

    def _nearest_keyframe(self, camera_from_world: Array) -> int:
        """Return the keyframe nearest to a pose among those that look the same way, or among all if none does."""
        poses = self.map.keyframes.camera_from_world[self._keyframes]
        alike = poses[:, 2, :3] @ camera_from_world[2, :3] >= thresholds.VIEWING_COSINE
        center = -camera_from_world[:3, :3].T @ camera_from_world[:3, 3]
        distances = np.linalg.norm(self.map.keyframes.centers_world[self._keyframes] - center, axis=1)
        distances[~alike] += distances.max() + 1.0
        return int(self._keyframes[np.argmin(distances)])
