from __future__ import annotations

import numpy as np
import pytest
from map_scenes import build_map, observe_scene
from rendered_scenes import CAMERA, Floats, features_at, looking, random_descriptors

from codecbench.slam.map.frame import TrackingFrame
from codecbench.slam.map.map import NONE
from codecbench.slam.places.recognition import relocalization_candidates
from codecbench.slam.thresholds import RELOCALIZED_MIN_INLIERS
from codecbench.slam.tracking.relocalization import relocalize
from codecbench.slam.tracking.tracker import Tracker

pytestmark = pytest.mark.thorough

POINTS = 900
KEYFRAMES = [looking((0.3 * (i % 2), 0.0, 0.0), yaw) for i, yaw in enumerate((0.0, 0.1, 1.5, 1.6, 3.0, 3.1))]


class Surroundings:
    """Points all around, mapped in three directions that share none."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        angles = rng.uniform(-np.pi, np.pi, POINTS)
        distances = rng.uniform(4.0, 8.0, POINTS)
        heights = rng.uniform(-2.0, 2.0, POINTS)
        self.points = np.column_stack([distances * np.sin(angles), heights, distances * np.cos(angles)])
        self.descriptors = random_descriptors(rng, POINTS)
        self.map, self.mapper = build_map(KEYFRAMES, self.points, self.descriptors)
        self.map.remove_points(np.nonzero(self.map.points.observation_counts[:POINTS] < 2)[0])
        self.tracker = Tracker(self.map, CAMERA)

    def frame(self, pose: Floats, noise_px: float = 0.0) -> TrackingFrame:
        seen, shown = observe_scene(pose, self.points, self.descriptors)
        pixels = seen.features.pixels + self.rng.normal(0.0, 1.0, (len(shown), 2)) * noise_px
        return TrackingFrame.of(50, 5.0, features_at(pixels, self.descriptors[shown]))

    def find(self, frame: TrackingFrame) -> int:
        """Inliers from the first keyframe that looks like the frame and shows where it is."""
        candidates = relocalization_candidates(frame.features, [self.mapper.places])
        return next((n for _, k in candidates if (n := relocalize(frame, self.tracker, k))), 0)


@pytest.fixture
def surroundings(rng: np.random.Generator) -> Surroundings:
    return Surroundings(rng)


@pytest.mark.parametrize(("yaw", "keyframes"), [(0.03, (0, 1)), (1.52, (2, 3)), (3.08, (4, 5))])
def test_a_lost_camera_is_found_exactly_wherever_it_is(
    surroundings: Surroundings, yaw: float, keyframes: tuple[int, int]
) -> None:
    pose = looking((0.12, 0.05, 0.1), yaw, 0.05)
    frame = surroundings.frame(pose)
    inliers = surroundings.find(frame)
    assert inliers >= RELOCALIZED_MIN_INLIERS
    assert inliers == len(frame.matched_features)
    assert np.abs(frame.camera_from_world - pose).max() < 1e-7
    assert frame.reference in keyframes
    assert surroundings.tracker.last is frame


def test_noise_bounds_the_error(surroundings: Surroundings) -> None:
    pose = looking((0.12, 0.05, 0.1), 1.52, 0.05)
    frame = surroundings.frame(pose, noise_px=0.5)
    assert surroundings.find(frame) >= RELOCALIZED_MIN_INLIERS
    assert np.abs(frame.camera_from_world[:3, :3] - pose[:3, :3]).max() < 0.005
    assert np.abs(frame.camera_from_world[:3, 3] - pose[:3, 3]).max() < 0.03


def test_a_place_never_seen_stays_unknown(surroundings: Surroundings) -> None:
    for frame in (
        surroundings.frame(looking((0.0, 0.0, 0.0), -0.8)),
        TrackingFrame.of(1, 0.1, features_at(np.empty((0, 2)), np.empty((0, 4), np.uint64))),
    ):
        assert surroundings.find(frame) == 0
        assert surroundings.tracker.last is None


def test_a_few_points_do_not_suffice(surroundings: Surroundings) -> None:
    """Half of what a relocalized frame needs is visible: the pose would be right, and is not believed."""
    pose = looking((0.12, 0.05, 0.1), 0.03, 0.05)
    seen = surroundings.frame(pose).features
    kept = surroundings.rng.choice(len(seen), RELOCALIZED_MIN_INLIERS // 2, replace=False)
    frame = TrackingFrame.of(1, 0.1, features_at(seen.pixels[kept], seen.descriptors[kept]))
    assert surroundings.find(frame) == 0


def test_what_looks_alike_but_lies_elsewhere_is_refused(surroundings: Surroundings) -> None:
    """The right descriptors at the wrong pixels: no pose explains them."""
    seen = surroundings.frame(looking((0.12, 0.05, 0.1), 0.03, 0.05)).features
    mixed = features_at(surroundings.rng.permutation(seen.pixels), seen.descriptors)
    frame = TrackingFrame.of(1, 0.1, mixed)
    assert surroundings.find(frame) == 0
    assert surroundings.tracker.last is None


def test_points_that_died_are_not_believed(surroundings: Surroundings) -> None:
    dead = surroundings.map.keyframes.points[:2]
    surroundings.map.remove_points(np.unique(dead[dead >= 0]))
    frame = surroundings.frame(looking((0.12, 0.05, 0.1), 0.03, 0.05))
    assert surroundings.find(frame) == 0
    assert (frame.points == NONE).all()
    assert (surroundings.map.keyframes.points[:2] == NONE).all()
