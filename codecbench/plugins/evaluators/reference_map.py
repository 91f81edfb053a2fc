"""The map of a sequence's raw frames, and the poses of these frames in it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.errors import Unsupported
from codecbench.core.contracts.sequence import FrameSequence, Trajectory
from codecbench.plugins.evaluators.trajectory.alignment import (
    Poses,
    Similarity,
    Undefined,
    align,
    associate,
    true_poses,
)
from codecbench.plugins.slam_backends.orb import Orb
from codecbench.slam.features.extractor import Features
from codecbench.slam.geometry.transforms import se3_exp, se3_inverse, se3_log
from codecbench.slam.result import FrameTrajectory
from codecbench.slam.system import BuiltMap
from codecbench.slam.tracking.relocalization import Localizer, Location

Way = Literal["tracked", "relocalized"]


@dataclass(frozen=True)
class LocalizedPose:
    """The pose at which a frame was located."""

    world_from_camera: NDArray[np.float64]
    """(4, 4), in metres and the coordinates of the ground truth."""
    inliers: int
    """Map points that agree with the pose."""


@dataclass(frozen=True)
class ReferenceMap:
    """The map of a sequence's raw frames."""

    localizer: Localizer
    world_from_map: Similarity
    """Aligns the map's trajectory with the ground truth."""
    predictions: dict[int, NDArray[np.float64]]
    """By frame, the pose camera_from_map extrapolated from the two frames before it."""
    reasons: dict[int, str]
    """By frame without a prediction, why it is not located."""
    truth: Poses
    """(N, 4, 4) world_from_camera; NaN if not known."""
    limit_m: float
    """Distance from the raw frame's position at which a pose is wrong."""
    limit_deg: float
    """The angle that moves what the camera sees by the same share of its depth as `limit_m`."""

    def localize(self, features: Features, index: int) -> dict[Way, LocalizedPose | None]:
        """The pose of frame `index` by its features, in both ways; None if it is not located."""
        return {
            "tracked": self._align(self.localizer.locate_near(features, self.predictions[index])),
            "relocalized": self._align(self.localizer.locate(features)),
        }

    def _align(self, location: Location | None) -> LocalizedPose | None:
        if location is None:
            return None
        map_from_camera = se3_inverse(location.camera_from_world)[None]
        aligned = self.world_from_map.trajectory(Trajectory(np.zeros(1), map_from_camera))
        return LocalizedPose(aligned.world_from_camera[0], location.inliers)


def build_reference_map(
    sequence: FrameSequence, backend: Orb, association_s: float, limit_share: float
) -> ReferenceMap:
    """Map the raw frames. Raises Unsupported if they make no map, or one that cannot be aligned with the truth."""
    truth, camera = true_poses(sequence, association_s), sequence.camera
    if camera is None or sequence.ground_truth is None:
        raise Unsupported(f"sequence {sequence.name} has no camera; a map needs its calibration")
    built = backend.map_of(sequence, camera, seed=0)
    if built is None:
        raise Unsupported(f"the raw frames of {sequence.name} make no map; SLAM needs motion and texture")
    mapped = Trajectory(built.trajectory.timestamps_s, built.trajectory.world_from_camera)
    try:
        world_from_map = align(associate(mapped, sequence.ground_truth, association_s), whole_turn=True)
    except Undefined as why:
        raise Unsupported(f"the map of {sequence.name} cannot be aligned with the ground truth: {why}") from why
    limit_m = limit_share * world_from_map.scale * built.localizer.scene_depth()
    predictions, reasons = _predictions(built, len(sequence))
    return ReferenceMap(
        built.localizer, world_from_map, predictions, reasons, truth, limit_m, math.degrees(limit_share)
    )


def _predictions(built: BuiltMap, frames: int) -> tuple[dict[int, NDArray[np.float64]], dict[int, str]]:
    """The predicted pose of every frame that will be located, and for the others the reason."""
    poses = {int(index): position for position, index in enumerate(built.trajectory.frame_indices)}
    keyframes = set(built.keyframe_indices.tolist())
    predictions, reasons = {}, {}
    for index in range(frames):
        if index in keyframes:
            reasons[index] = "the raw frame is a keyframe of the map, which contains its features"
        elif not {index, index - 1, index - 2} <= poses.keys():
            reasons[index] = "the raw frame or one of the two before it is not in the map"
        else:
            predictions[index] = _extrapolate(built.trajectory, poses[index])
    return predictions, reasons


def _extrapolate(trajectory: FrameTrajectory, position: int) -> NDArray[np.float64]:
    """camera_from_world of a pose, if the motion between the two before it continued at constant velocity."""
    before, last = (se3_inverse(trajectory.world_from_camera[position - back]) for back in (2, 1))
    stamps_s = trajectory.timestamps_s[position - 2 : position + 1]
    ratio = (stamps_s[2] - stamps_s[1]) / (stamps_s[1] - stamps_s[0])
    return np.asarray(se3_exp(se3_log(last @ se3_inverse(before)) * ratio) @ last)
