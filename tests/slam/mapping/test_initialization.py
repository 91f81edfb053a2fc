from __future__ import annotations

import numpy as np
import pytest
from map_scenes import FACTORS, VARIANCES
from rendered_scenes import CAMERA, features_at, random_descriptors, two_views

from codecbench.slam.geometry.camera import Camera
from codecbench.slam.geometry.transforms import se3_exp
from codecbench.slam.map.frame import TrackingFrame
from codecbench.slam.mapping.initialization import (
    Initializer,
    TwoViewReconstruction,
    match_for_initialization,
    reconstruct_two_views,
)

pytestmark = pytest.mark.thorough


@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_features_are_matched_that_moved_by_less_than_ten_degrees(rng: np.random.Generator, scale: float) -> None:
    camera = Camera(round(320 * scale), round(240 * scale), *(scale * CAMERA.intrinsics))
    descriptors, pixels = random_descriptors(rng, 300), rng.uniform([80.0, 20.0], [300.0, 220.0], (300, 2))
    angles_deg = rng.uniform(0.0, 20.0, 300)
    moved = pixels - np.column_stack([np.deg2rad(angles_deg) * CAMERA.fx, np.zeros(300)])
    matches = match_for_initialization(
        features_at(scale * pixels, descriptors), features_at(scale * moved, descriptors), camera
    )
    assert (matches[angles_deg < 9.9] == np.arange(300)[angles_deg < 9.9]).all()
    assert (matches[angles_deg > 10.1] == -1).all()


@pytest.mark.parametrize("planar", [False, True])
def test_the_motion_is_found_and_the_model_fits_the_scene(rng: np.random.Generator, planar: bool) -> None:
    views = two_views(rng, planar=planar)
    descriptors = random_descriptors(rng, 300)
    first, second = features_at(views.pixels_a, descriptors), features_at(views.pixels_b, descriptors)
    start = reconstruct_two_views(first, second, np.arange(300), VARIANCES, CAMERA, np.random.default_rng(0))
    assert isinstance(start, TwoViewReconstruction)
    assert start.model == ("homography" if planar else "fundamental")
    scale = np.linalg.norm(views.b_from_a[:3, 3])
    assert np.abs(start.second_from_first[:3, :3] - views.b_from_a[:3, :3]).max() < 1e-6
    assert np.abs(start.second_from_first[:3, 3] * scale - views.b_from_a[:3, 3]).max() < 1e-5
    assert np.abs(start.points_first * scale - views.points[start.features_first]).max() < 1e-3


def test_wrong_matches_do_not_matter(rng: np.random.Generator) -> None:
    views = two_views(rng, noise_px=0.3)
    descriptors = random_descriptors(rng, 300)
    first, second = features_at(views.pixels_a, descriptors), features_at(views.pixels_b, descriptors)
    matches = np.arange(300)
    matches[:60] = np.roll(matches[:60], 1)
    start = reconstruct_two_views(first, second, matches, VARIANCES, CAMERA, np.random.default_rng(0))
    assert isinstance(start, TwoViewReconstruction)
    assert np.abs(start.second_from_first[:3, :3] - views.b_from_a[:3, :3]).max() < 0.02
    assert (start.features_first >= 60).mean() > 0.97


@pytest.mark.parametrize("turn", [0.01, 0.05, 0.2])
@pytest.mark.parametrize("noise_px", [0.0, 0.2, 0.7])
def test_pure_rotation_gives_no_map(rng: np.random.Generator, turn: float, noise_px: float) -> None:
    views = two_views(rng)
    rotation = se3_exp(np.array([0.0, 0.0, 0.0, 0.4 * turn, turn, 0.1 * turn]))[:3, :3]
    turned = CAMERA.project(views.points @ rotation.T) + rng.normal(0.0, noise_px, (300, 2))
    turned[:30] = rng.uniform([0.0, 0.0], [320.0, 240.0], (30, 2))  # wrong matches
    descriptors = random_descriptors(rng, 300)
    first, second = features_at(views.pixels_a, descriptors), features_at(turned, descriptors)
    start = reconstruct_two_views(first, second, np.arange(300), VARIANCES, CAMERA, np.random.default_rng(0))
    assert isinstance(start, str)
    assert "a rotation explains" in start


def test_few_matches_are_refused_with_a_reason(rng: np.random.Generator) -> None:
    views = two_views(rng)
    descriptors = random_descriptors(rng, 300)
    first, second = features_at(views.pixels_a, descriptors), features_at(views.pixels_b, descriptors)
    matches = np.where(np.arange(300) < 50, np.arange(300), -1)
    start = reconstruct_two_views(first, second, matches, VARIANCES, CAMERA, np.random.default_rng(0))
    assert isinstance(start, str)
    assert start.startswith("50 matches ")


def test_the_first_map_is_exact_and_of_unit_depth(rng: np.random.Generator) -> None:
    views = two_views(rng)
    descriptors = random_descriptors(rng, 300)
    initializer = Initializer(CAMERA, FACTORS, 300, np.random.default_rng(0))
    first = TrackingFrame.of(0, 0.0, features_at(views.pixels_a, descriptors))
    second = TrackingFrame.of(1, 0.1, features_at(views.pixels_b, descriptors))
    assert str(initializer.add(first, 0)).startswith("waiting ")
    started = initializer.add(second, 0)
    assert not isinstance(started, str)
    slam_map, mapper = started
    assert slam_map.keyframes.count == 2
    assert mapper.median_depth(0) == pytest.approx(1.0)
    assert second.reference == 1
    scale = np.linalg.norm(views.b_from_a[:3, 3]) / np.linalg.norm(slam_map.pose(1)[:3, 3])
    seen = slam_map.keyframes.points[0]
    shown = np.nonzero(seen >= 0)[0]
    points = slam_map.points.positions[seen[shown]] * scale
    assert len(shown) > 250
    assert np.abs(points - views.points[shown]).max() < 1e-3


def test_a_poor_frame_forgets_the_reference(rng: np.random.Generator) -> None:
    descriptors = random_descriptors(rng, 300)
    initializer = Initializer(CAMERA, FACTORS, 300, np.random.default_rng(0))
    pixels = rng.uniform(10.0, 230.0, (300, 2))
    initializer.add(TrackingFrame.of(0, 0.0, features_at(pixels, descriptors)), 0)
    initializer.add(TrackingFrame.of(1, 0.1, features_at(pixels[:20], descriptors[:20])), 0)
    answer = initializer.add(TrackingFrame.of(2, 0.2, features_at(pixels, descriptors)), 0)
    assert isinstance(answer, str)
    assert answer.startswith("waiting ")
