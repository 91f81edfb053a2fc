from __future__ import annotations

import numpy as np
import pytest
from map_scenes import FACTORS, VARIANCES, assert_consistent, build_map, observe_scene
from numpy.typing import NDArray
from rendered_scenes import CAMERA, looking, random_descriptors

from codecbench.slam.geometry.transforms import se3_exp
from codecbench.slam.map.fusion import fuse
from codecbench.slam.map.map import Indices, Map
from codecbench.slam.map.triangulation import triangulate_features
from codecbench.slam.mapping.mapper import Mapper

pytestmark = pytest.mark.thorough

POSES = [looking((0.2 * i, 0.0, 0.0)) for i in range(6)]


@pytest.fixture
def points(rng: np.random.Generator) -> NDArray[np.float64]:
    return rng.uniform([-1.0, -1.5, 4.0], [2.0, 1.5, 7.0], (200, 3))


@pytest.fixture
def descriptors(rng: np.random.Generator) -> NDArray[np.uint64]:
    return random_descriptors(rng, 200)


@pytest.fixture
def mapper(points: NDArray[np.float64], descriptors: NDArray[np.uint64]) -> Mapper:
    """Six keyframes that move sideways, each of which sees every point."""
    slam_map, mapper = build_map(POSES, points, descriptors)
    assert (slam_map.points.observation_counts[:200] == 6).all()
    return mapper


def triangulate(slam_map: Map, keyframe: int, neighbors: list[int]) -> tuple[NDArray[np.float64], Indices]:
    """New points of a keyframe, and which point of the scene each feature shows: features are in their order."""
    features, partners, partner_features, found = triangulate_features(
        keyframe, np.array(neighbors), slam_map.keyframes.views, slam_map.points.positions, CAMERA.matrix, FACTORS,
        VARIANCES,
    )  # fmt: skip
    assert np.array_equal(features, partner_features)
    assert np.isin(partners, neighbors).all()
    return found, features


# Triangulation ------------------------------------------------------------------------------------------------------


def test_free_features_become_the_points_that_they_show(mapper: Mapper, points: NDArray[np.float64]) -> None:
    mapper.map.remove_points(np.arange(80))
    found, shown = triangulate(mapper.map, 5, [4, 1])
    assert len(shown) == len(set(shown.tolist()))
    assert set(shown.tolist()) == set(range(80))
    assert np.abs(found - points[shown]).max() < 1e-8


def test_new_points_are_seen_by_both_keyframes(mapper: Mapper) -> None:
    mapper.map.remove_points(np.arange(80))
    mapper._triangulate(5, np.array([1]))
    added = np.arange(200, 280)
    assert mapper.map.points.alive[added].all()
    which, keyframes, _ = mapper.map.observations(added)
    assert np.array_equal(np.bincount(which), np.full(80, 2))
    assert set(keyframes.tolist()) == {1, 5}
    assert_consistent(mapper.map)


def test_features_off_their_lines_do_not_match(mapper: Mapper, points: NDArray[np.float64]) -> None:
    mapper.map.remove_points(np.arange(80))
    mapper.map.keyframes.pixels[1, :40, 1] += 15.0  # the motion is sideways: lines run along x
    found, shown = triangulate(mapper.map, 5, [1])
    assert set(shown.tolist()) == set(range(40, 80))
    assert np.abs(found - points[shown]).max() < 1e-8


def test_steep_lines_and_an_epipole_in_the_image(rng: np.random.Generator, descriptors: NDArray[np.uint64]) -> None:
    for position in ((0.0, 0.6, 0.0), (0.0, 0.0, 1.0)):
        points = rng.uniform([-1.5, -1.0, 5.0], [1.5, 1.0, 7.0], (200, 3))
        slam_map, _ = build_map([looking((0.0, 0.0, 0.0)), looking(position)], points, descriptors)
        slam_map.remove_points(np.arange(200))
        found, shown = triangulate(slam_map, 1, [0])
        assert np.abs(found - points[shown]).max() < 1e-6
        rays = [points - np.array(p) for p in ((0.0, 0.0, 0.0), position)]
        cosines = (rays[0] * rays[1]).sum(axis=1) / np.linalg.norm(rays, axis=2).prod(axis=0)
        clear = np.nonzero(cosines < 0.999)[0]  # 2.6 degrees: more than twice what is asked for
        assert len(clear) > 20
        assert np.isin(clear, shown).all()


def test_neighbours_too_near_give_no_points(points: NDArray[np.float64], descriptors: NDArray[np.uint64]) -> None:
    slam_map, _ = build_map([POSES[0], looking((0.03, 0.0, 0.0))], points, descriptors)
    slam_map.remove_points(np.arange(100))
    assert len(triangulate(slam_map, 1, [0])[1]) == 0


# Duplicates ---------------------------------------------------------------------------------------------------------


def duplicated(slam_map: Map, points: Indices) -> Indices:
    """Let keyframes 3 to 5 see copies of `points` instead of them; returns the copies."""
    which, keyframes, features = slam_map.observations(points)
    late = keyframes >= 3
    slam_map.unobserve(keyframes[late], features[late])
    copies = slam_map.points.add(slam_map.points.positions[points], 3, 0)
    slam_map.observe(keyframes[late], features[late], copies[which[late]])
    slam_map.refresh_points(np.concatenate([points, copies]))
    return copies


def test_a_point_seen_as_two_becomes_one(mapper: Mapper) -> None:
    slam_map, points = mapper.map, np.arange(50)
    copies = duplicated(slam_map, points)
    assert fuse(slam_map, CAMERA, 4, points, POSES[4]) == 50
    survivors = slam_map.resolve_points(points)
    assert np.array_equal(survivors, slam_map.resolve_points(copies))
    assert (slam_map.points.observation_counts[survivors] == 6).all()
    assert slam_map.points.alive[points].sum() + slam_map.points.alive[copies].sum() == 50
    assert_consistent(slam_map)


def test_the_point_that_more_keyframes_see_stays(mapper: Mapper) -> None:
    slam_map, points = mapper.map, np.arange(50)
    copies = duplicated(slam_map, points)
    _, keyframes, features = slam_map.observations(points)
    slam_map.unobserve(keyframes[keyframes == 0], features[keyframes == 0])
    fuse(slam_map, CAMERA, 4, points, POSES[4])
    assert np.array_equal(slam_map.resolve_points(points), copies)


def test_a_free_feature_that_shows_a_point_is_given_to_it(mapper: Mapper) -> None:
    slam_map = mapper.map
    slam_map.unobserve(np.full(30, 2), np.arange(30))
    assert fuse(slam_map, CAMERA, 2, np.arange(60), POSES[2]) == 30
    assert np.array_equal(slam_map.keyframes.points[2, :200], np.arange(200))
    assert_consistent(slam_map)


def test_points_of_other_looks_or_places_are_left_alone(mapper: Mapper, rng: np.random.Generator) -> None:
    slam_map = mapper.map
    slam_map.unobserve(np.full(30, 2), np.arange(30))
    slam_map.points.descriptors[:10] = random_descriptors(rng, 10)
    slam_map.points.positions[10:20, 1] += 0.2  # some ten pixels
    slam_map.points.normals[20:29] *= -1.0  # seen from behind only
    assert fuse(slam_map, CAMERA, 2, np.arange(30), POSES[2]) == 1
    assert slam_map.keyframes.points[2, 29] == 29


# Culling ------------------------------------------------------------------------------------------------------------


def test_points_that_are_seldom_found_die(mapper: Mapper) -> None:
    slam_map, table = mapper.map, mapper.map.points
    mapper._probation = np.arange(4)
    table.born[:4] = [5, 5, 3, 5]
    table.visible_counts[:4], table.found_counts[:4] = 20, [4, 5, 20, 20]
    for point in (2, 3):  # seen by two keyframes: too few once the trial is over
        _, keyframes, features = slam_map.observations(np.array([point]))
        slam_map.unobserve(keyframes[:4], features[:4])
    mapper._cull_points()
    assert table.alive[:5].tolist() == [False, True, False, True, True]
    assert mapper._probation.tolist() == [1, 3]
    assert_consistent(slam_map)


def test_keyframes_are_culled_until_three_others_do_not_see_their_points(mapper: Mapper) -> None:
    mapper._cull_keyframes(5)
    alive = mapper.map.alive_keyframes
    assert len(alive) == 3
    assert 0 in alive
    assert 5 in alive
    assert len(mapper.map.alive_points) == 200
    assert_consistent(mapper.map)


# The whole step -----------------------------------------------------------------------------------------------------


def test_an_inserted_keyframe_finds_its_pose_and_its_points(
    mapper: Mapper, points: NDArray[np.float64], descriptors: NDArray[np.uint64], rng: np.random.Generator
) -> None:
    """Between exact keyframes, everything about a frame that was a little wrong comes out right, but for the scale."""
    slam_map = mapper.map
    slam_map.remove_points(np.arange(150, 200))
    true = looking((0.5, 0.3, 0.0), yaw=0.02)
    frame, shown = observe_scene(true, points, descriptors)
    frame.index, frame.timestamp_s = 6, 6.0
    frame.points[:100] = shown[:100]
    frame.camera_from_world = se3_exp(rng.normal(0.0, 1e-3, 6)) @ true
    keyframe = mapper.insert(frame)
    mapper.refine_neighborhood(keyframe)
    frame.synchronize(slam_map)
    scale = slam_map.pose(5)[0, 3] / POSES[5][0, 3]
    assert scale == pytest.approx(1.0, abs=0.01)
    true[:3, 3] *= scale
    assert np.abs(frame.camera_from_world - true).max() < 1e-8
    assert np.array_equal(frame.points[:150], shown[:150])  # 50 of them found by the merging of duplicates
    new = frame.points[150:]
    assert (new >= 200).all()
    assert np.abs(slam_map.points.positions[new] - scale * points[shown[150:]]).max() < 1e-6
    assert slam_map.keyframes.alive[keyframe]
    assert_consistent(slam_map)
