"""Each compiled step of tracking against the same step spelled out with the plain functions it stands for."""

from __future__ import annotations

import numpy as np
import pytest
from map_scenes import build_map
from numpy.typing import NDArray
from rendered_scenes import CAMERA, features_at, looking, random_descriptors

from codecbench.slam import thresholds
from codecbench.slam.features.extractor import Features
from codecbench.slam.features.matching import keep_consistent_rotations, match_in_windows
from codecbench.slam.map.map import NONE, Map
from codecbench.slam.map.projection import project_map_points
from codecbench.slam.optimization.pose_optimization import optimize_pose
from codecbench.slam.tracking.search import Lens, columns_of, optimize_matched_pose, search_last_frame, search_local_map

pytestmark = pytest.mark.thorough

KEYFRAMES = [looking((0.15 * i, 0.02 * i, 0.0), 0.01 * i) for i in range(4)]
POSE = looking((0.5, 0.05, 0.1), 0.03)
POINTS = 500


@pytest.fixture
def slam_map(rng: np.random.Generator) -> Map:
    points = rng.uniform([-3.5, -2.5, 4.0], [3.5, 2.5, 8.0], (POINTS, 3))
    slam_map = build_map(KEYFRAMES, points, random_descriptors(rng, POINTS))[0]
    slam_map.remove_points(np.nonzero(slam_map.points.observation_counts[:POINTS] < 2)[0])
    return slam_map


@pytest.fixture
def features(slam_map: Map, rng: np.random.Generator) -> Features:
    """What POSE sees of the map, off by a pixel or two, with similar descriptors, and as many features of nothing."""
    found = project_map_points(slam_map, slam_map.alive_points, POSE, CAMERA, 0.5)
    count = len(found.points)
    flipped = slam_map.points.descriptors[found.points] ^ (
        random_descriptors(rng, count) & random_descriptors(rng, count)
    )
    pixels = np.concatenate(
        [found.pixels + rng.normal(0.0, 1.0, (count, 2)), rng.uniform([0, 0], [319, 239], (count, 2))]
    )
    octaves = np.concatenate([found.octaves, rng.integers(0, 8, count)]).astype(np.int32)
    made = features_at(pixels, np.concatenate([flipped, random_descriptors(rng, count)]), octaves)
    made.angles[:] = rng.uniform(-3.0, 3.0, len(made))
    return made


def some_shown(slam_map: Map, count: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Points by feature: a third of the features show one, and one point is shown twice."""
    shown = np.full(count, NONE, np.int64)
    which = rng.choice(count, count // 3, replace=False)
    shown[which] = rng.choice(slam_map.alive_points, len(which), replace=False)
    shown[which[0]] = shown[which[1]]
    return shown


def lens(slam_map: Map) -> Lens:
    return Lens(CAMERA.intrinsics, CAMERA.bounds, slam_map.scale_factors)


@pytest.mark.parametrize("window_px", [15.0, 30.0])
def test_points_of_the_last_frame(
    slam_map: Map, features: Features, window_px: float, rng: np.random.Generator
) -> None:
    last_points = some_shown(slam_map, 300, rng)
    last_octaves = rng.integers(0, 8, 300).astype(np.int32)
    last_angles = rng.uniform(-3.0, 3.0, 300)
    seen = np.nonzero(last_points >= 0)[0]
    in_camera = slam_map.points.positions[last_points[seen]] @ POSE[:3, :3].T + POSE[:3, 3]
    seen, in_camera = seen[in_camera[:, 2] > 0.0], in_camera[in_camera[:, 2] > 0.0]
    octaves = last_octaves[seen].astype(np.int64)
    matches = match_in_windows(
        CAMERA.project(in_camera), window_px * slam_map.scale_factors[octaves], octaves - 1, octaves + 1,
        slam_map.points.descriptors[last_points[seen]], features, np.ones(len(features), np.bool_),
        thresholds.HAMMING_HIGH, thresholds.TRACK_RATIO,
    )  # fmt: skip
    keep_consistent_rotations(matches, last_angles[seen], features.angles)
    expected = np.full(len(features), NONE, np.int64)
    expected[matches[matches >= 0]] = last_points[seen[matches >= 0]]

    shown = np.full(len(features), NONE, np.int64)
    found = search_last_frame(
        last_points, last_octaves, last_angles, window_px, columns_of(slam_map.points), lens(slam_map), POSE,
        features.view, features.angles, shown,
    )  # fmt: skip
    assert np.array_equal(shown, expected)
    assert found == (matches >= 0).sum() > 5


def test_the_local_map_and_what_is_counted_as_visible(
    slam_map: Map, features: Features, rng: np.random.Generator
) -> None:
    shown = some_shown(slam_map, len(features), rng)
    local, before = slam_map.alive_points, slam_map.points.visible_counts.copy()
    unseen = np.setdiff1d(local, shown)
    found = project_map_points(slam_map, unseen, POSE, CAMERA, thresholds.VIEWING_COSINE)
    frontal = found.cosines > thresholds.FRONTAL_COSINE
    radii = np.where(frontal, thresholds.LOCAL_WINDOW_FRONTAL_PX, thresholds.LOCAL_WINDOW_PX)
    matches = match_in_windows(
        found.pixels, radii * slam_map.scale_factors[found.octaves], found.octaves - 1, found.octaves,
        slam_map.points.descriptors[found.points], features, shown < 0, thresholds.HAMMING_HIGH, thresholds.LOCAL_RATIO,
    )  # fmt: skip
    expected = shown.copy()
    expected[matches[matches >= 0]] = found.points[matches >= 0]
    visible = before.copy()
    visible[np.union1d(found.points, shown[shown >= 0])] += 1

    count = search_local_map(
        local, columns_of(slam_map.points), slam_map.points.count, lens(slam_map), POSE, features.view, shown
    )
    assert np.array_equal(shown, expected)
    assert np.array_equal(slam_map.points.visible_counts, visible)
    assert count == (matches >= 0).sum() > 20


def test_the_pose_and_which_points_stay(slam_map: Map, features: Features, rng: np.random.Generator) -> None:
    found = project_map_points(slam_map, slam_map.alive_points, POSE, CAMERA, 0.5)
    shown = np.full(len(features), NONE, np.int64)
    shown[: len(found.points)] = found.points  # see `features`
    wrong = rng.choice(len(found.points), 20, replace=False)
    shown[wrong] = np.roll(shown[wrong], 1)
    matched = np.nonzero(shown >= 0)[0]
    inverse_sigma2 = slam_map.scale_factors**-2.0
    start = looking((0.52, 0.04, 0.08), 0.035)
    expected, inliers = optimize_pose(
        start, slam_map.points.positions[shown[matched]], features.pixels[matched],
        inverse_sigma2[features.octaves[matched]], CAMERA.intrinsics,
    )  # fmt: skip
    kept = shown.copy()
    kept[matched[~inliers]] = NONE

    pose = start.copy()
    arguments = slam_map.points.positions, features.pixels, features.octaves, inverse_sigma2, CAMERA.intrinsics
    assert optimize_matched_pose(pose, shown, *arguments) == inliers.sum() < len(matched)
    assert np.array_equal(pose, expected)
    assert np.array_equal(shown, kept)
    assert optimize_matched_pose(pose, np.array([NONE, 1, 2, 3]), *arguments) == 0
    assert np.array_equal(pose, expected)
