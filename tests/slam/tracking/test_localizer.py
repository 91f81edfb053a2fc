"""Frames located in a finished map: one with exact points, and one that SLAM made of a filmed room."""

from __future__ import annotations

import numpy as np
import pytest
from map_scenes import FACTORS, build_map, observe_scene
from rendered_scenes import CAMERA, Floats, Room, features_at, looking, path_pose, random_descriptors

from codecbench.slam import system as module
from codecbench.slam.features.extractor import Features
from codecbench.slam.options import Options
from codecbench.slam.thresholds import LOCAL_MIN_INLIERS, RELOCALIZED_MIN_INLIERS
from codecbench.slam.tracking.relocalization import Localizer

pytestmark = pytest.mark.thorough

KEYFRAMES = [looking((0.3 * (i % 2), 0.0, 0.0), yaw) for i, yaw in enumerate((0.0, 0.1, 1.5, 1.6))]
POSE = looking((0.12, 0.05, 0.1), 0.03, 0.05)


class Scene:
    """Points ahead and to the right, mapped by two keyframes each, and what a camera sees of them."""

    def __init__(self, rng: np.random.Generator) -> None:
        angles, distances = rng.uniform(-0.9, 2.5, 900), rng.uniform(4.0, 8.0, 900)
        self.points = np.column_stack([distances * np.sin(angles), rng.uniform(-2, 2, 900), distances * np.cos(angles)])
        self.descriptors = random_descriptors(rng, 900)
        slam_map, _ = build_map(KEYFRAMES, self.points, self.descriptors)
        slam_map.remove_points(np.nonzero(slam_map.points.observation_counts[:900] < 2)[0])
        self.localizer = Localizer(slam_map, CAMERA, Options())

    def seen(self, pose: Floats) -> Features:
        return observe_scene(pose, self.points, self.descriptors)[0].features


@pytest.fixture
def scene(rng: np.random.Generator) -> Scene:
    return Scene(rng)


def shifted(pose: Floats, right: float) -> Floats:
    moved = pose.copy()
    moved[0, 3] -= right
    return moved


@pytest.mark.parametrize("right", [0.0, 0.1, -0.2])
def test_a_frame_is_found_exactly_from_a_pose_nearby(scene: Scene, right: float) -> None:
    found = scene.localizer.locate_near(scene.seen(POSE), shifted(POSE, right))
    assert found is not None
    assert found.inliers >= LOCAL_MIN_INLIERS
    assert np.abs(found.camera_from_world - POSE).max() < 1e-6


def test_a_frame_is_found_exactly_from_nothing(scene: Scene) -> None:
    for pose in (POSE, looking((0.12, 0.05, 0.1), 1.52, 0.05)):
        found = scene.localizer.locate(scene.seen(pose))
        assert found is not None
        assert found.inliers >= RELOCALIZED_MIN_INLIERS
        assert np.abs(found.camera_from_world - pose).max() < 1e-6


def test_what_cannot_be_located_is_not(scene: Scene) -> None:
    nothing = features_at(np.empty((0, 2)), np.empty((0, 4), np.uint64))
    assert scene.localizer.locate(nothing) is None
    assert scene.localizer.locate_near(nothing, POSE) is None
    assert scene.localizer.locate_near(scene.seen(POSE), shifted(POSE, 3.0)) is None  # predicted far away
    assert scene.localizer.locate(scene.seen(looking((0.0, 0.0, 0.0), -2.5))) is None  # never mapped


def test_an_answer_does_not_depend_on_what_was_asked_before(scene: Scene) -> None:
    features, prediction = scene.seen(POSE), shifted(POSE, 0.1)
    first = scene.localizer.locate_near(features, prediction), scene.localizer.locate(features)
    for yaw in (1.52, 0.06, -2.5):
        scene.localizer.locate(scene.seen(looking((0.1, 0.0, 0.0), yaw)))
    again = scene.localizer.locate_near(features, prediction), scene.localizer.locate(features)
    for before, after in zip(first, again, strict=True):
        assert before is not None
        assert after is not None
        np.testing.assert_array_equal(before.camera_from_world, after.camera_from_world)
        assert before.inliers == after.inliers
    np.testing.assert_array_equal(prediction, shifted(POSE, 0.1))


def test_the_scene_is_as_deep_as_its_points(scene: Scene) -> None:
    slam_map = scene.localizer.map
    depths = []
    for keyframe, pose in enumerate(KEYFRAMES):
        points = slam_map.keyframes.points[keyframe]
        depths.extend((scene.points[points[points >= 0]] @ pose[:3, :3].T + pose[:3, 3])[:, 2])
    assert scene.localizer.scene_depth() == pytest.approx(np.median(depths))
    assert len(FACTORS) == Options().levels


def test_frames_of_a_film_are_located_in_the_map_that_it_makes() -> None:
    """With every third frame left out of the map: these are where the frames between which they lie say."""
    room = Room()
    film = [room.image(path_pose(step)) for step in range(40)]
    mapped = [step for step in range(40) if step % 3 != 2]
    built = module.build_map(((film[step], step / 15.0) for step in mapped), CAMERA, Options(features=600), seed=1)
    assert built is not None
    poses = {mapped[i]: np.linalg.inv(pose) for i, pose in
             zip(built.trajectory.frame_indices, built.trajectory.world_from_camera, strict=True)}  # fmt: skip
    centers = {step: -pose[:3, :3].T @ pose[:3, 3] for step, pose in poses.items()}
    asked = [step for step in range(2, 40, 3) if {step - 1, step + 1} <= poses.keys()]
    assert len(asked) >= 5
    for step in asked:
        features = built.localizer.extract(film[step])
        for found in (built.localizer.locate_near(features, poses[step - 1]), built.localizer.locate(features)):
            assert found is not None
            center = -found.camera_from_world[:3, :3].T @ found.camera_from_world[:3, 3]
            middle = 0.5 * (centers[step - 1] + centers[step + 1])
            assert np.linalg.norm(center - middle) < 0.03 * built.localizer.scene_depth()
    assert set(built.keyframe_indices.tolist()) <= set(range(len(mapped)))


def test_a_film_of_nothing_makes_no_map() -> None:
    gray = np.full((CAMERA.height, CAMERA.width), 90, np.uint8)
    assert module.build_map(((gray, 0.1 * step) for step in range(5)), CAMERA) is None
