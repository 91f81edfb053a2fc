from __future__ import annotations

import numpy as np
import pytest
from map_scenes import build_map, observe_scene
from rendered_scenes import looking, random_descriptors

from codecbench.slam.map.map import NONE

pytestmark = pytest.mark.thorough

POSES = [looking((0.2 * i, 0.0, 0.0)) for i in range(3)]


def test_a_synchronised_frame_has_what_its_keyframe_has_now(rng: np.random.Generator) -> None:
    points = rng.uniform([-1.0, -1.5, 4.0], [2.0, 1.5, 7.0], (60, 3))
    descriptors = random_descriptors(rng, 60)
    slam_map, _ = build_map(POSES, points, descriptors)
    frame, shown = observe_scene(POSES[1], points, descriptors)
    frame.reference = 1
    slam_map.remove_points(shown[:5])
    corrected = looking((0.21, 0.01, 0.0), 0.05)
    slam_map.keyframes.set_pose(1, corrected)
    frame.synchronize(slam_map)
    assert np.array_equal(frame.camera_from_world, corrected)
    assert frame.points.tolist() == [NONE] * 5 + shown[5:].tolist()


def test_a_synchronised_frame_is_its_own(rng: np.random.Generator) -> None:
    points = rng.uniform([-1.0, -1.5, 4.0], [2.0, 1.5, 7.0], (60, 3))
    descriptors = random_descriptors(rng, 60)
    slam_map, _ = build_map(POSES, points, descriptors)
    frame, _ = observe_scene(POSES[1], points, descriptors)
    frame.reference = 1
    frame.synchronize(slam_map)
    frame.camera_from_world[:3, 3] += 1.0
    frame.points[:] = NONE
    assert np.array_equal(slam_map.keyframes.camera_from_world[1], POSES[1])
    assert (slam_map.keyframes.points[1] >= 0).sum() == 60
