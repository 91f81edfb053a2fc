"""Trajectories of the orb backend change with its version, and only with it: stored cells are kept by version."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from rendered_scenes import CAMERA, Room, looking, path_pose

from codecbench.core.contracts.sequence import Camera, Frame
from codecbench.plugins.slam_backends.orb import Orb


def ride(step: float) -> NDArray[np.float64]:
    """A swing from side to side, looking about."""
    t = step / 20.0
    position = 2.2 * np.sin(0.5 * t), 0.1 * np.sin(2.0 * t), -1.0 + 0.5 * np.cos(t)
    return looking(position, 0.6 * np.sin(0.8 * t), 0.15)


@pytest.mark.parametrize(
    ("pose", "steps", "expected"),
    [
        pytest.param(path_pose, range(30), ("12", [0.19543512, 0.00964288, 0.05302278]), id="walk"),
        pytest.param(
            ride,
            [*range(20), *range(22, 40)],
            ("12", [0.41094231, -0.04809509, -0.15088688]),
            id="swing with a gap",
            marks=pytest.mark.thorough,
        ),
    ],
)
def test_a_trajectory_changes_with_the_version_alone(
    pose: Callable[[float], NDArray[np.float64]], steps: list[int], expected: tuple[str, list[float]]
) -> None:
    """A change on purpose raises `Orb.version` and writes it here with the new last place.

    Any change of tracking or mapping moves the last place by more than 1e-6 of the median depth; code for another
    processor by 3e-9.
    """
    room = Room()
    sizes = CAMERA.width, CAMERA.height, CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy
    frames = (Frame(i, i / 15.0, room.image(pose(i))) for i in steps)
    poses = Orb.create(features=600).run(frames, Camera(*sizes), seed=1).trajectory.world_from_camera
    assert len(poses) >= 20
    version, place = expected
    assert Orb.version == version
    np.testing.assert_allclose(poses[-1, :3, 3], place, rtol=0.0, atol=1e-6)
