from __future__ import annotations

import numpy as np
import pytest
from map_scenes import build_map, observe_scene
from rendered_scenes import CAMERA, looking, random_descriptors

from codecbench.slam.geometry.transforms import sim3_exp
from codecbench.slam.map.map import Map
from codecbench.slam.tracking.tracked_pose import TrackedPose

pytestmark = pytest.mark.thorough

POSES = [looking((0.3 * i, 0.05 * i, 0.0), 0.02 * i) for i in range(4)]
BETWEEN = looking((0.45, 0.1, 0.05), 0.05)


def tracked(count: int) -> tuple[TrackedPose, Map]:
    """A frame between four keyframes, noted while the map's points were 4 % too near, and the map with exact points."""
    rng = np.random.default_rng(5)
    points = rng.uniform([-2.0, -1.5, 3.0], [3.0, 1.5, 8.0], (count, 3))
    slam_map, _ = build_map(POSES, points, random_descriptors(rng, count))
    frame, shown = observe_scene(BETWEEN, points, slam_map.points.descriptors[:count])
    frame.index, frame.reference = 99, 1
    frame.points = shown.copy()
    frame.camera_from_world[:3, 3] *= 0.96
    return TrackedPose.of(frame, slam_map, np.linalg.inv(frame.camera_from_world)), slam_map


def test_a_frame_is_fitted_anew_to_the_points_where_they_are_now() -> None:
    pose, slam_map = tracked(200)
    before = np.abs(pose.resolve(slam_map) - np.linalg.inv(BETWEEN)).max()
    refined = pose.refine(slam_map, CAMERA)
    after = np.abs(refined.resolve(slam_map) - np.linalg.inv(BETWEEN)).max()
    assert before > 0.01
    assert after < 1e-6  # pixels are kept as float32
    assert np.array_equal(refined.world_from_camera, pose.world_from_camera)  # what was tracked stays


def test_a_frame_with_too_few_points_left_stays() -> None:
    pose, slam_map = tracked(200)
    slam_map.remove_points(pose.points[10:].astype(np.int64))
    assert pose.refine(slam_map, CAMERA) is pose


def test_a_frame_follows_its_map_into_another_one() -> None:
    pose, slam_map = tracked(200)
    camera = pose.resolve(slam_map)
    other, _ = tracked(200)[1], slam_map
    moved = np.asarray(sim3_exp(np.array([0.4, -1.0, 2.0, 0.5, -0.3, 0.2, np.log(1.7)])))
    slam_map.transform(moved)
    numbers, first_point = other.append(slam_map, np.array([2, 1, 3, 0]))
    there = pose.move_to_map(numbers, first_point, moved)
    expected = moved @ camera
    expected[:3, :3] /= 1.7
    assert np.allclose(there.resolve(other), expected)
    assert np.allclose(there.world_from_camera[:3, 3], (moved @ pose.world_from_camera)[:3, 3])
    assert np.allclose(np.linalg.det(there.world_from_camera[:3, :3]), 1.0)
    refined = there.refine(other, CAMERA)  # over the points that it saw, as they are called now
    assert np.abs(refined.resolve(other)[:3, 3] - (moved @ np.linalg.inv(BETWEEN))[:3, 3]).max() < 1e-5
