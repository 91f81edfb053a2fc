"""Choose pairs of frames by the true motion between them, in units of the distance of the scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.errors import Unsupported
from codecbench.core.contracts.sequence import Camera, FrameSequence
from codecbench.plugins.evaluators.relative_pose.matching import Matcher
from codecbench.plugins.evaluators.relative_pose.two_view import near_epipolar_lines
from codecbench.plugins.evaluators.sampling import evenly_spread
from codecbench.plugins.evaluators.trajectory.alignment import Poses
from codecbench.slam.geometry.camera import Camera as SlamCamera
from codecbench.slam.geometry.transforms import se3_inverse

Floats = NDArray[np.float64]

DEPTH_PAIRS: Final = 16
"""Pairs of raw frames from which the distance of the scene is triangulated."""
DEPTH_INTERVAL_S: Final = 0.5
"""Time between the frames of such a pair."""
DEPTH_TOLERANCE_PX: Final = 2.0
"""Distance from the true epipolar lines up to which a match is used."""
DEPTH_MIN_PARALLAX_DEG: Final = 1.0
DEPTH_MIN_POINTS: Final = 50
"""The fewest points of which a median depth is taken."""


@dataclass(frozen=True)
class Pair:
    """Two frames by index, and the true motion between them."""

    first: int
    second: int
    second_from_first: Floats
    """(4, 4), in metres."""


def scene_distance_m(sequence: FrameSequence, poses: Poses, matcher: Matcher) -> float:
    """Median depth of the scene in metres: matches in raw frames are triangulated from true poses (N, 4, 4).

    Raises Unsupported if too few can be triangulated, because nothing matches or the camera only turns.
    """
    depths = [np.empty(0)]
    gap = max(1, round(DEPTH_INTERVAL_S * sequence.frame_rate_hz))
    for first in evenly_spread(max(len(sequence) - gap, 0), DEPTH_PAIRS):
        motion = relative_motion(poses, first, first + gap)
        if np.isfinite(motion).all():
            images = [matcher.detect(sequence.read(index).image) for index in (first, first + gap)]
            matches = matcher.match(*images)
            pixels = [image.pixels[matches[:, side]] for side, image in enumerate(images)]
            depths.append(_depths(pixels[0], pixels[1], matcher.matrix, motion))
    depths_m = np.concatenate(depths)
    count = len(depths_m)
    if count < DEPTH_MIN_POINTS:
        raise Unsupported(
            f"the scene distance of {sequence.name} is unknown: {count} points have parallax under the true motion, "
            f"{DEPTH_MIN_POINTS} are needed; the camera must move, and the ground truth must fit the frames"
        )
    return float(np.median(depths_m))


def relative_motion(poses: Poses, first: int, second: int) -> Floats:
    """second_from_first (4, 4); NaN if one of the two has no true pose."""
    return np.asarray(np.linalg.inv(poses[second]) @ poses[first])


def pair_of(
    first: int, poses: Poses, camera: Camera, distance_m: float, baseline: float, min_overlap: float
) -> Pair | str:
    """A frame and the first later one at least `baseline` scene distances away, or why there is none.

    The two must overlap by `min_overlap`; frames without a true pose are skipped.
    """
    if not np.isfinite(poses[first]).all():
        return "the frame has no true pose"
    moved_m = np.linalg.norm(poses[first + 1 :, :3, 3] - poses[first, :3, 3], axis=1)
    with np.errstate(invalid="ignore"):
        far_enough = np.flatnonzero(moved_m >= baseline * distance_m)
    if not len(far_enough):
        return f"no later frame is {baseline:g} scene distances ({baseline * distance_m:.3g} m) away"
    second = first + 1 + int(far_enough[0])
    motion = relative_motion(poses, first, second)
    shared = min(overlap(motion, camera, distance_m), overlap(se3_inverse(motion), camera, distance_m))
    if shared < min_overlap:
        return f"frame {second}, the first so far away, shows only {100 * shared:.0f} % of the same"
    return Pair(first, second, motion)


def overlap(second_from_first: Floats, camera: Camera, distance_m: float) -> float:
    """Share of the first image that the second shows, if everything were at depth `distance_m`."""
    grid = np.meshgrid(np.linspace(0, camera.width - 1, 16), np.linspace(0, camera.height - 1, 12))
    x, y = (part.ravel() for part in grid)
    sizes = (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
    lens = SlamCamera(*sizes, camera.distortion, camera.model)
    if lens.is_fisheye:
        undistorted = lens.undistort(np.column_stack([x, y]))
        x, y = undistorted[np.isfinite(undistorted[:, 0])].T
    rays = np.column_stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones(x.size)])
    seen = distance_m * rays @ second_from_first[:3, :3].T + second_from_first[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v = camera.fx * seen[:, 0] / seen[:, 2] + camera.cx, camera.fy * seen[:, 1] / seen[:, 2] + camera.cy
    if lens.is_fisheye:
        u, v = lens.distort(np.column_stack([u, v])).T
    inside = (np.abs(u - 0.5 * (camera.width - 1)) < 0.5 * camera.width) & (seen[:, 2] > 0)
    inside &= np.abs(v - 0.5 * (camera.height - 1)) < 0.5 * camera.height
    return float(inside.mean())


def _depths(first: Floats, second: Floats, matrix: Floats, motion: Floats) -> Floats:
    """Depths in the first view of matched pixels (M, 2) that agree with the true motion and have enough parallax."""
    near = near_epipolar_lines(first, second, matrix, motion, DEPTH_TOLERANCE_PX)
    first, second = first[near], second[near]
    if not len(first):
        return np.empty(0)
    rays = [np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(matrix).T for pixels in (first, second)]
    turned = rays[0] @ motion[:3, :3].T
    cosines = np.sum(turned * rays[1], axis=1) / (np.linalg.norm(turned, axis=1) * np.linalg.norm(rays[1], axis=1))
    points = cv2.triangulatePoints(matrix @ np.eye(3, 4), matrix @ motion[:3], first.T, second.T)
    with np.errstate(divide="ignore", invalid="ignore"):
        points = (points[:3] / points[3]).T
    depths = points[:, 2]
    ahead = (depths > 0) & (points @ motion[2, :3] + motion[2, 3] > 0)
    return np.asarray(depths[ahead & (cosines < np.cos(np.radians(DEPTH_MIN_PARALLAX_DEG)))])
