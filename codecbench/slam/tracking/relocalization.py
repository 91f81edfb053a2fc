"""Finding a lost camera in the map (ORB-SLAM V-C)."""

from __future__ import annotations

import numpy as np

from codecbench.slam import thresholds
from codecbench.slam.map.frame import TrackingFrame
from codecbench.slam.map.map import NONE
from codecbench.slam.map.projection import project_map_points
from codecbench.slam.tracking.tracker import Tracker, match_projections


def relocalize(frame: TrackingFrame, tracker: Tracker, keyframe: int) -> int:
    """Find the pose of `frame` from a keyframe that looks like it; returns the inliers, 0 when that is not where it is.

    The two are matched by appearance; a pose by P3P and RANSAC is optimised, widened by projecting the keyframe's
    points, and accepted with RELOCALIZED_MIN_INLIERS inliers in the local map. A frame that is not found shows
    no points.
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
