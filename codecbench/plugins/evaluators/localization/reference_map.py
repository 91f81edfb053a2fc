"""What is known of a sequence before any codec: the map of its raw frames, and where these are in it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.errors import Unsupported
from codecbench.core.contracts.sequence import FrameSequence, Trajectory
from codecbench.plugins.evaluators.trajectory.alignment import Similarity, Undefined, align, associate
from codecbench.plugins.evaluators.true_poses import Poses, true_poses
from codecbench.plugins.slam_backends.orb import Orb
from codecbench.slam.features.extractor import Features
from codecbench.slam.geometry.transforms import se3_exp, se3_inverse, se3_log
from codecbench.slam.result import FrameTrajectory
from codecbench.slam.system import BuiltMap
from codecbench.slam.tracking.relocalization import Localizer, Location

Way = Literal["tracked", "relocalized"]


@dataclass(frozen=True)
class LocalizedPose:
    """Where a frame was found: `world_from_camera` (4, 4) in metres and the true frame, on `inliers` map points."""

    world_from_camera: NDArray[np.float64]
    inliers: int


@dataclass(frozen=True)
class ReferenceMap:
    """The map of a sequence's raw frames.

    world_from_map: the similarity that aligns the map's trajectory with the truth. predictions: by frame, the pose
    camera_from_map that its predecessors' poses in the map foretell; frames without one are not located, and `reasons`
    says why. truth: (N, 4, 4) world_from_camera, NaN where not known. limit_m, limit_deg: how far from
    the raw frame's pose a pose is wrong. Either moves what the camera sees by the same share of its depth.
    """

    localizer: Localizer
    world_from_map: Similarity
    predictions: dict[int, NDArray[np.float64]]
    reasons: dict[int, str]
    truth: Poses
    limit_m: float
    limit_deg: float

    def localize(self, features: Features, index: int) -> dict[Way, LocalizedPose | None]:
        """Where frame `index` is found, each way, by features of it."""
        return {
            "tracked": self._localized(self.localizer.locate_near(features, self.predictions[index])),
            "relocalized": self._localized(self.localizer.locate(features)),
        }

    def _localized(self, location: Location | None) -> LocalizedPose | None:
        if location is None:
            return None
        map_from_camera = se3_inverse(location.camera_from_world)[None]
        aligned = self.world_from_map.trajectory(Trajectory(np.zeros(1), map_from_camera))
        return LocalizedPose(aligned.world_from_camera[0], location.inliers)


def build_reference_map(
    sequence: FrameSequence, backend: Orb, association_s: float, limit_share: float
) -> ReferenceMap:
    """Map the raw frames. Raises Unsupported where they make no map, or one that cannot be aligned with the truth."""
    truth, camera = true_poses(sequence, association_s), sequence.camera
    if camera is None or sequence.ground_truth is None:
        raise Unsupported(f"sequence {sequence.name} has no camera; a map needs its calibration")
    built = backend.map_of(sequence, camera, seed=0)
    if built is None:
        raise Unsupported(f"the raw frames of {sequence.name} make no map; is there motion enough, and texture?")
    mapped = Trajectory(built.trajectory.timestamps_s, built.trajectory.world_from_camera)
    try:
        world_from_map = align(associate(mapped, sequence.ground_truth, association_s), whole_turn=True)
    except Undefined as why:
        raise Unsupported(f"the map of {sequence.name} cannot be aligned with the truth: {why}") from why
    limit_m = limit_share * world_from_map.scale * built.localizer.scene_depth()
    predictions, reasons = _predictions(built, len(sequence))
    return ReferenceMap(
        built.localizer, world_from_map, predictions, reasons, truth, limit_m, math.degrees(limit_share)
    )


def _predictions(built: BuiltMap, frames: int) -> tuple[dict[int, NDArray[np.float64]], dict[int, str]]:
    """The predicted pose of every frame that is to be located, and why the others are not."""
    poses = {int(index): position for position, index in enumerate(built.trajectory.frame_indices)}
    keyframes = set(built.keyframe_indices.tolist())
    predictions, reasons = {}, {}
    for index in range(frames):
        if index in keyframes:
            reasons[index] = "the map holds features of this raw frame, a keyframe: nothing else could be found so well"
        elif not {index, index - 1, index - 2} <= poses.keys():
            reasons[index] = "the raw frame or one of the two before it is not in the map"
        else:
            predictions[index] = _predicted(built.trajectory, poses[index])
    return predictions, reasons


def _predicted(trajectory: FrameTrajectory, position: int) -> NDArray[np.float64]:
    """camera_from_world of a pose, were the motion between the two before it to go on."""
    before, last = (se3_inverse(trajectory.world_from_camera[position - back]) for back in (2, 1))
    stamps_s = trajectory.timestamps_s[position - 2 : position + 1]
    ratio = (stamps_s[2] - stamps_s[1]) / (stamps_s[1] - stamps_s[0])
    return np.asarray(se3_exp(se3_log(last @ se3_inverse(before)) * ratio) @ last)
