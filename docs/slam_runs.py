"""One SLAM over frames that a table is made of, and how far its path is from the true one."""

from __future__ import annotations

import math

from codecbench import slam
from codecbench.core.contracts.sequence import FrameSequence, Trajectory
from codecbench.plugins.evaluators.trajectory.alignment import Undefined, align, associate
from codecbench.plugins.evaluators.trajectory.errors import position_errors, rms


def system_of(sequence: FrameSequence, features: int = 1000) -> slam.System:
    """A SLAM for the camera of a sequence."""
    camera = sequence.camera
    assert camera is not None
    numbers = (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
    return slam.System(slam.Camera(*numbers, camera.distortion, camera.model), slam.Options(features=features))


def path_of(result: slam.Result) -> Trajectory:
    """The path of the largest map."""
    return Trajectory(result.trajectory.timestamps_s, result.trajectory.world_from_camera)


def error_m(found: Trajectory, truth: Trajectory | None, tolerance_s: float = 0.02) -> float:
    """RMS distance from the true path at times that agree, after alignment; infinite where there is no best one."""
    if truth is None:
        return math.nan
    pairs = associate(found, truth, tolerance_s)
    try:
        return rms(position_errors(pairs, align(pairs)))
    except Undefined:
        return math.inf
