"""Finding a lost camera in the map (ORB-SLAM V-C)."""

from __future__ import annotations

import numpy as np

from codecbench.slam import thresholds
from codecbench.slam.map.frame import TrackingFrame
from codecbench.slam.map.projection import project_map_points
from codecbench.slam.places.recognition import PlaceRecognition
from codecbench.slam.tracking.tracker import Tracker, match_projections


def relocalize(frame: TrackingFrame, tracker: Tracker, places: PlaceRecognition) -> int:
    """Find the pose of `frame` from the keyframes that look like it; returns the inliers, 0 when it stays lost.

    Each candidate is matched by appearance; a pose by P3P and RANSAC is optimised, widened by projecting the
    candidate's points, and accepted with RELOCALIZED_MIN_INLIERS inliers in the local map.
    """
    for keyframe in places.relocalization_candidates(frame.features)[: thresholds.RELOCALIZATION_CANDIDATES]:
        if not tracker.guess_by_keyframe(frame, keyframe, thresholds.RELOCALIZATION_RATIO):
            continue
        points = tracker.map.keyframes.points[keyframe]
        points = np.setdiff1d(points[points >= 0], frame.points)
        projections = project_map_points(
            tracker.map, points, frame.camera_from_world, tracker.camera, thresholds.VIEWING_COSINE
        )
        match_projections(tracker.map, frame, projections, thresholds.RELOCALIZATION_WIDENING)
        if tracker.optimize(frame) < thresholds.TRACK_MIN_INLIERS:
            continue
        inliers = tracker.track_local_map(frame)
        if inliers >= thresholds.RELOCALIZED_MIN_INLIERS:
            tracker.start(frame)
            return inliers
    return 0
