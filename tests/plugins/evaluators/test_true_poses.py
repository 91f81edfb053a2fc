"""True poses of frames, and angles of rotations, against what they were made from."""

from __future__ import annotations

import numpy as np
import pytest
from memory_sequence import MemorySequence
from scipy.spatial.transform import Rotation
from synthetic_path import helix, part

from codecbench.core.contracts.errors import Unsupported
from codecbench.core.contracts.sequence import Trajectory
from codecbench.plugins.evaluators.trajectory.alignment import rotation_angles_deg, true_poses


def sequence(truth: Trajectory | None) -> MemorySequence:
    return MemorySequence([np.zeros((4, 4), np.uint8)] * 20, None, truth)


def test_frames_get_the_pose_nearest_in_time_and_others_none() -> None:
    truth = helix(20)
    poses = true_poses(sequence(part(truth, [2, 3, 9])), 0.02)
    known = np.flatnonzero(np.isfinite(poses).all(axis=(1, 2)))
    assert known.tolist() == [2, 3, 9]
    np.testing.assert_array_equal(poses[[2, 3, 9]], truth.world_from_camera[[2, 3, 9]])


def test_a_sequence_without_truth_is_not_supported() -> None:
    with pytest.raises(Unsupported, match="no ground truth"):
        true_poses(sequence(None), 0.02)
    late = Trajectory(helix(20).timestamps_s + 100.0, helix(20).world_from_camera)
    with pytest.raises(Unsupported, match=r"memory .* association_s = 0\.02 s"):
        true_poses(sequence(late), 0.02)
    poses = np.where(np.arange(4) < 3, np.nan, helix(20).world_from_camera)
    with pytest.raises(Unsupported, match="positions only"):
        true_poses(sequence(Trajectory(helix(20).timestamps_s, poses)), 0.02)


@pytest.mark.parametrize("angle_deg", [0.0, 1e-6, 0.01, 45.0, 90.0, 179.99, 180.0])
def test_angles_are_exact_from_nothing_to_half_a_turn(angle_deg: float) -> None:
    axes = np.array([[1.0, 0.0, 0.0], [0.6, -0.8, 0.0], [0.0, 0.28, 0.96]])
    turns = Rotation.from_rotvec(np.radians(angle_deg) * axes).as_matrix()
    np.testing.assert_allclose(rotation_angles_deg(turns), angle_deg, rtol=1e-6, atol=1e-9)
