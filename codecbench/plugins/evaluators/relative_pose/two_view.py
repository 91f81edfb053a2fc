"""Estimate the motion between two views from matches with MAGSAC, and compare it with the true one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from codecbench.plugins.evaluators.trajectory.alignment import rotation_angles_deg

Floats = NDArray[np.float64]

MIN_MATCHES: Final = 5
"""The fewest matches that determine an essential matrix."""
CONFIDENCE: Final = 0.999
ITERATIONS: Final = 1000
WORST_ERROR_DEG: Final = 180.0
"""The error of a pair without an estimated motion: the largest possible."""


@dataclass(frozen=True)
class TwoViewMotion:
    """The motion second_from_first, without its scale."""

    rotation: Floats
    """(3, 3)."""
    translation: Floats
    """(3,), of unit length."""
    inliers: int
    """Matches that agree with the motion."""


def estimate_motion(first: Floats, second: Floats, matrix: Floats, threshold_px: float) -> TwoViewMotion | None:
    """The motion between two views from matched pixels (M, 2), or None if none can be estimated.

    MAGSAC++ (Barath, Noskova, Ivashechkin, Matas, CVPR 2020, doi:10.1109/CVPR42600.2020.00138) in OpenCV's USAC, which
    has a fixed seed: equal matches give equal motions. matrix: (3, 3) calibration.
    """
    if len(first) < MIN_MATCHES:
        return None
    try:
        essential, mask = cv2.findEssentialMat(
            first, second, matrix, method=cv2.USAC_MAGSAC, prob=CONFIDENCE, threshold=threshold_px, maxIters=ITERATIONS
        )
    except cv2.error:  # every sample of the matches is degenerate
        return None
    if essential is None or essential.shape != (3, 3) or mask is None:
        return None
    inliers = mask.ravel() > 0
    rays = [np.column_stack([p[inliers], np.ones(inliers.sum())]) @ np.linalg.inv(matrix).T for p in (first, second)]
    return _choose_in_front(np.asarray(essential, np.float64), rays[0], rays[1])


def _choose_in_front(essential: Floats, first: Floats, second: Floats) -> TwoViewMotion:
    """The one of the four motions of an essential matrix that has the most points in front of both cameras.

    Rays (M, 3) in both cameras: d1 R r1 + t = d2 r2, crossed with r2 and with R r1, gives the signs of the depths.
    """
    one_turn, other_turn, translation = (np.asarray(part, float) for part in cv2.decomposeEssentialMat(essential))
    direction = translation.ravel()
    most, best = -1, TwoViewMotion(one_turn, direction, len(first))
    for rotation in (one_turn, other_turn):
        turned = first @ rotation.T
        normals = np.cross(turned, second)
        depths = -np.sum(np.cross(direction, second) * normals, axis=1)
        other_depths = -np.sum(np.cross(direction, turned) * normals, axis=1)
        for sign in (1.0, -1.0):
            ahead = int(np.count_nonzero((sign * depths > 0) & (sign * other_depths > 0)))
            if ahead > most:
                most, best = ahead, TwoViewMotion(rotation, sign * direction, len(first))
    return best


def pose_error_deg(motion: TwoViewMotion | None, second_from_first: Floats) -> float:
    """The larger of the rotation error and the angle between estimated and true translation, in degrees.

    As in Sarlin et al., "SuperGlue", CVPR 2020, doi:10.1109/CVPR42600.2020.00499: a direction and its opposite count
    as one. Deviation: WORST_ERROR_DEG, not infinity, if there is no motion.
    """
    if motion is None:
        return WORST_ERROR_DEG
    turn = float(rotation_angles_deg(motion.rotation @ second_from_first[:3, :3].T))
    true = second_from_first[:3, 3]
    sine = np.linalg.norm(np.cross(motion.translation, true))
    slant = float(np.degrees(np.arctan2(sine, abs(motion.translation @ true))))
    return max(turn, slant)


def curve_area(error_deg: float, threshold_deg: float) -> float:
    """One pair's share, 0 to 1, of the area under the curve of solved pairs over the error, up to a threshold.

    The mean over pairs is that area divided by the threshold; the curve is the share of pairs with an error up to each
    angle. SuperGlue's trapezoids between the sorted errors give the same up to about one pair's share.
    """
    return max(0.0, 1.0 - error_deg / threshold_deg)


def near_epipolar_lines(
    first: Floats, second: Floats, matrix: Floats, second_from_first: Floats, px: float
) -> NDArray[np.bool_]:
    """(M,) whether matched pixels (M, 2) are within `px` of their epipolar lines under a motion, in both views."""
    x, y, z = second_from_first[:3, 3]
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    inverse = np.linalg.inv(matrix)
    fundamental = inverse.T @ skew @ second_from_first[:3, :3] @ inverse
    ones = np.ones((len(first), 1))
    first_h, second_h = np.hstack([first, ones]), np.hstack([second, ones])
    lines_second, lines_first = first_h @ fundamental.T, second_h @ fundamental
    residuals = np.abs(np.sum(second_h * lines_second, axis=1))
    lengths = np.minimum(np.hypot(*lines_second[:, :2].T), np.hypot(*lines_first[:, :2].T))
    return np.asarray(residuals <= px * lengths)
