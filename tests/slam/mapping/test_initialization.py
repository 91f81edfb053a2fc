from __future__ import annotations

import numpy as np
import pytest
from rendered_scenes import CAMERA, features_at, random_descriptors, two_views

from codecbench.slam.geometry.camera import Camera
from codecbench.slam.geometry.transforms import se3_exp
from codecbench.slam.map.frame import TrackingFrame
from codecbench.slam.mapping.initialization import (
    Initializer,
    NoMotion,
    TwoViewStart,
    match_for_start,
    start_from_two_views,
)

pytestmark = pytest.mark.thorough

FACTORS = 1.2 ** np.arange(8)


def test_what_looks_alike_is_matched(rng: np.random.Generator) -> None:
    views = two_views(rng)
    descriptors = random_descriptors(rng, 300)
    first, second = features_at(views.pixels_a, descriptors), features_at(views.pixels_b, descriptors)
    assert (match_for_start(first, second, CAMERA) == np.arange(300)).mean() > 0.95


@pytest.mark.parametrize(("width", "height"), [(320, 240), (240, 320), (640, 480)])
def test_a_match_is_searched_within_a_share_of_the_image(width: int, height: int) -> None:
    """Two features that look alike, at 0.15 and 0.17 of the longer side: 100 / 640 is 0.156."""
    camera = Camera(width, height, 260.0, 260.0, width / 2, height / 2)
    descriptors = random_descriptors(np.random.default_rng(0), 2)
    places = np.array([[20.0, 30.0], [20.0, 100.0]])
    moved = places + max(width, height) * np.array([[0.15, 0.0], [0.17, 0.0]])
    matches = match_for_start(features_at(places, descriptors), features_at(moved, descriptors), camera)
    assert matches.tolist() == [0, -1]


@pytest.mark.parametrize("planar", [False, True])
def test_the_motion_is_found_in_deep_and_in_flat_scenes(rng: np.random.Generator, planar: bool) -> None:
    views = two_views(rng, planar=planar)
    descriptors = random_descriptors(rng, 300)
    first, second = features_at(views.pixels_a, descriptors), features_at(views.pixels_b, descriptors)
    start = start_from_two_views(first, second, np.arange(300), CAMERA, np.random.default_rng(0))
    assert isinstance(start, TwoViewStart)
    scale = np.linalg.norm(views.b_from_a[:3, 3])
    assert np.abs(start.second_from_first[:3, :3] - views.b_from_a[:3, :3]).max() < 1e-6
    assert np.abs(start.second_from_first[:3, 3] * scale - views.b_from_a[:3, 3]).max() < 1e-5
    assert np.abs(start.points_first * scale - views.points[start.features_first]).max() < 1e-3


def test_points_at_infinity_are_on_no_side(rng: np.random.Generator) -> None:
    """Half the points lie so far away that noise alone decides whether their rays meet before or behind the camera."""
    views = two_views(rng, count=400)
    points = views.points.copy()
    points[:200] *= 1e4
    rotation, translation = views.b_from_a[:3, :3], views.b_from_a[:3, 3]
    noise = rng.normal(0.0, 0.02, (2, 400, 2))
    pixels_a, pixels_b = CAMERA.project(points) + noise[0], CAMERA.project(points @ rotation.T + translation) + noise[1]
    descriptors = random_descriptors(rng, 400)
    first, second = features_at(pixels_a, descriptors), features_at(pixels_b, descriptors)
    start = start_from_two_views(first, second, np.arange(400), CAMERA, np.random.default_rng(0))
    assert isinstance(start, TwoViewStart)
    assert start.second_from_first[:3, 3] @ translation / np.linalg.norm(translation) > 0.999
    assert start.features_first.min() >= 200  # they speak for the motion, and give no point


@pytest.mark.parametrize("noise_px", [0.0, 0.3])
def test_a_plane_before_a_camera_that_backs_away_leaves_two_motions(rng: np.random.Generator, noise_px: float) -> None:
    views = two_views(rng, planar=True)
    b_from_a = se3_exp(np.array([0.1, 0.05, -0.6, 0.02, -0.05, 0.01]))  # the plane lies before both, in either motion
    pixels_b = CAMERA.project(views.points @ b_from_a[:3, :3].T + b_from_a[:3, 3]) + rng.normal(0.0, noise_px, (300, 2))
    descriptors = random_descriptors(rng, 300)
    first, second = features_at(views.pixels_a, descriptors), features_at(pixels_b, descriptors)
    start = start_from_two_views(first, second, np.arange(300), CAMERA, np.random.default_rng(0))
    assert isinstance(start, str)
    assert "two motions agree about as well" in start


@pytest.mark.parametrize(("near", "expected"), [(45, False), (60, True)])
def test_fifty_points_must_have_parallax(rng: np.random.Generator, near: int, expected: bool) -> None:
    """The near points move by 13 pixels or more, the others, ten times as far away, by 3.5 or less."""
    views = two_views(rng, baseline=0.4)
    points = views.points.copy()
    points[near:] *= 10.0
    pixels_b = CAMERA.project(points @ views.b_from_a[:3, :3].T + views.b_from_a[:3, 3])
    descriptors = random_descriptors(rng, 300)
    first, second = features_at(views.pixels_a, descriptors), features_at(pixels_b, descriptors)
    start = start_from_two_views(first, second, np.arange(300), CAMERA, np.random.default_rng(0))
    assert isinstance(start, TwoViewStart) == expected
    assert expected or (isinstance(start, NoMotion) and start.startswith("parallax of "))


def test_wrong_matches_do_not_matter(rng: np.random.Generator) -> None:
    views = two_views(rng, noise_px=0.3)
    descriptors = random_descriptors(rng, 300)
    first, second = features_at(views.pixels_a, descriptors), features_at(views.pixels_b, descriptors)
    matches = np.arange(300)
    matches[:60] = np.roll(matches[:60], 1)
    start = start_from_two_views(first, second, matches, CAMERA, np.random.default_rng(0))
    assert isinstance(start, TwoViewStart)
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
    start = start_from_two_views(first, second, np.arange(300), CAMERA, np.random.default_rng(0))
    assert isinstance(start, str)
    assert "a rotation explains" in start


def test_few_matches_are_refused_with_a_reason(rng: np.random.Generator) -> None:
    views = two_views(rng)
    descriptors = random_descriptors(rng, 300)
    first, second = features_at(views.pixels_a, descriptors), features_at(views.pixels_b, descriptors)
    matches = np.where(np.arange(300) < 50, np.arange(300), -1)
    start = start_from_two_views(first, second, matches, CAMERA, np.random.default_rng(0))
    assert start == "50 matches between the first two frames"


def test_the_first_map_is_exact_and_of_unit_depth(rng: np.random.Generator) -> None:
    views = two_views(rng)
    descriptors = random_descriptors(rng, 300)
    initializer = Initializer(CAMERA, FACTORS, 300, np.random.default_rng(0))
    first = TrackingFrame.of(0, 0.0, features_at(views.pixels_a, descriptors))
    second = TrackingFrame.of(1, 0.1, features_at(views.pixels_b, descriptors))
    assert initializer.add(first, 0) == "waiting for a second view"
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


def test_a_poor_frame_is_passed_over(rng: np.random.Generator) -> None:
    views = two_views(rng)
    descriptors = random_descriptors(rng, 300)
    initializer = Initializer(CAMERA, FACTORS, 300, np.random.default_rng(0))
    initializer.add(TrackingFrame.of(0, 0.0, features_at(views.pixels_a, descriptors)), 0)
    dark = TrackingFrame.of(1, 0.1, features_at(views.pixels_a[:20], descriptors[:20]))
    assert initializer.add(dark, 0) == "20 features"
    started = initializer.add(TrackingFrame.of(2, 0.2, features_at(views.pixels_b, descriptors)), 0)
    assert not isinstance(started, str)
    assert started[0].keyframes.frame_indices[:2].tolist() == [0, 2]


def test_the_frame_just_past_serves_where_the_oldest_does_not(rng: np.random.Generator) -> None:
    """The first frame's matches are wrong, but for few; the second and third show one scene."""
    views = two_views(rng)
    descriptors = random_descriptors(rng, 300)
    initializer = Initializer(CAMERA, FACTORS, 300, np.random.default_rng(0))
    shaken = views.pixels_a + rng.uniform(-30.0, 30.0, (300, 2))
    assert initializer.add(TrackingFrame.of(0, 0.0, features_at(shaken, descriptors)), 0) == "waiting for a second view"
    assert isinstance(initializer.add(TrackingFrame.of(1, 0.1, features_at(views.pixels_a, descriptors)), 0), str)
    started = initializer.add(TrackingFrame.of(2, 0.2, features_at(views.pixels_b, descriptors)), 0)
    assert not isinstance(started, str)
    assert started[0].keyframes.frame_indices[:2].tolist() == [1, 2]


def test_a_reference_that_matches_no_longer_is_forgotten(rng: np.random.Generator) -> None:
    views = two_views(rng)
    descriptors, others = random_descriptors(rng, 300), random_descriptors(rng, 300)
    initializer = Initializer(CAMERA, FACTORS, 300, np.random.default_rng(0))
    initializer.add(TrackingFrame.of(0, 0.0, features_at(views.pixels_a, others)), 0)
    elsewhere = TrackingFrame.of(1, 0.1, features_at(views.pixels_a, descriptors))
    assert "0 matches" in str(initializer.add(elsewhere, 0))
    started = initializer.add(TrackingFrame.of(2, 0.2, features_at(views.pixels_b, descriptors)), 0)
    assert not isinstance(started, str)
