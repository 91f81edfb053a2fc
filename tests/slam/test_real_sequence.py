from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from rendered_scenes import position_error

from codecbench.core.contracts.image import gray_from_image
from codecbench.core.engine.plugins.registry import installed
from codecbench.slam import Camera, System

pytestmark = pytest.mark.thorough

CAMERA = Camera(640, 480, 535.4, 539.2, 320.1, 247.6)  # TUM RGB-D, freiburg3
FRAMES = 150


def test_a_desk_filmed_by_hand_is_followed_to_a_centimetre(data_folder: Path) -> None:
    folder = data_folder / "fr3_office_715"
    rows = [line.split() for line in (folder / "rgb.txt").read_text().splitlines() if not line.startswith("#")]
    true = np.loadtxt(folder / "groundtruth.txt")
    system = System(CAMERA)
    for seconds, name in rows[:FRAMES]:
        image = cv2.imread(str(folder / name))
        assert image is not None
        system.process(np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), dtype=np.uint8), float(seconds))
    result = system.finish()
    states = [frame.state for frame in result.frames]
    first = states.index("tracked")
    assert first <= 20
    assert states[first:] == ["tracked"] * (FRAMES - first)
    times = result.trajectory.timestamps_s
    nearest = np.abs(true[:, 0] - times[:, None]).argmin(axis=1)
    assert np.abs(true[nearest, 0] - times).max() < 0.02
    assert position_error(result.trajectory.world_from_camera[:, :3, 3], true[nearest, 1:4]) < 0.010  # metres


@pytest.mark.parametrize("scale", [1.0, 2.0])
def test_right_angle_turns_of_a_street_are_followed_at_five_hertz(data_folder: Path, scale: float) -> None:
    """Each turn leaves 15 to 30 points of the map in a frame, of 1000 features."""
    params = {"path": str(data_folder / "kitti00_half"), "stride": 2, "start": 4, "scale": scale}
    street = installed().create("dataset", "tum", params).open()
    true, seen = street.ground_truth, street.camera
    assert true is not None
    assert seen is not None
    system = System(Camera(seen.width, seen.height, seen.fx, seen.fy, seen.cx, seen.cy))
    for frame in street:
        assert frame.timestamp_s is not None
        system.process(gray_from_image(frame.image), frame.timestamp_s)
    result = system.finish()
    states = [frame.state for frame in result.frames]
    first = states.index("tracked")
    assert states[first:] == ["tracked"] * (len(states) - first)
    assert len(result.maps) == len(result.loops) == 1
    nearest = np.abs(true.timestamps_s - result.trajectory.timestamps_s[:, None]).argmin(axis=1)
    path = true.world_from_camera[nearest, :3, 3]
    length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
    assert position_error(result.trajectory.world_from_camera[:, :3, 3], path) < 0.005 * length
