from __future__ import annotations

import numpy as np
import pytest
from map_scenes import FACTORS, build_map
from rendered_scenes import CAMERA, Floats, looking, random_descriptors

from codecbench.slam.map.map import Map
from codecbench.slam.map.projection import Projections, project_ahead, project_map_points

pytestmark = pytest.mark.thorough

POSES = [looking((0.0, 0.0, 0.0)), looking((0.2, 0.0, 0.0)), looking((-0.2, 0.1, 0.0))]


def seen_from(slam_map: Map, pose: Floats, min_cosine: float = 0.5) -> Projections:
    return project_map_points(slam_map, slam_map.alive_points, pose, CAMERA, min_cosine)


def single_point(position: tuple[float, float, float]) -> Map:
    """A map of one point, seen at the finest level from the three poses."""
    return build_map(POSES, np.array([position]), np.zeros((1, 4), np.uint64))[0]


@pytest.fixture
def cloud(rng: np.random.Generator) -> Map:
    points = rng.uniform([-3.0, -2.0, 4.0], [3.0, 2.0, 8.0], (300, 3))
    slam_map = build_map(POSES, points, random_descriptors(rng, 300))[0]
    slam_map.remove_points(np.nonzero(slam_map.points.observation_counts[:300] < 2)[0])
    return slam_map


def test_pixels_are_exact_and_only_what_is_in_the_image_is_kept(cloud: Map) -> None:
    pose = looking((0.1, 0.05, 0.3), 0.1, -0.05)
    found = seen_from(cloud, pose)
    points = cloud.alive_points
    in_camera = cloud.points.positions[points] @ pose[:3, :3].T + pose[:3, 3]
    pixels = CAMERA.project(in_camera)
    inside = (pixels >= 0.0).all(axis=1) & (pixels <= [319.0, 239.0]).all(axis=1)
    assert 50 < inside.sum() < len(points)
    assert np.array_equal(found.points, points[inside])
    assert np.abs(found.pixels - pixels[inside]).max() < 1e-9


def test_a_view_like_the_old_ones_is_frontal_and_on_their_level(cloud: Map) -> None:
    found = seen_from(cloud, POSES[0])
    assert (found.cosines > 0.99).all()
    assert (found.octaves <= 1).all()


@pytest.mark.parametrize(("levels_nearer", "octave"), [(-0.9, 0), (0.0, 0), (0.5, 1), (2.0, 2), (2.5, 3), (7.5, 7)])
def test_the_level_follows_the_distance(levels_nearer: float, octave: int) -> None:
    slam_map = single_point((0.0, 0.0, 5.0))
    reference = slam_map.keyframes.centers_world[slam_map.points.references[0]]
    distance = np.linalg.norm([0.0, 0.0, 5.0] - reference) / FACTORS[1] ** levels_nearer
    found = seen_from(slam_map, looking((0.0, 0.0, 5.0 - distance)))
    assert found.octaves.tolist() == [octave]


def test_points_too_far_too_near_or_seen_from_the_side_are_left_out() -> None:
    slam_map = single_point((0.0, 0.0, 5.0))
    assert len(seen_from(slam_map, looking((0.0, 0.0, -0.8))).points) == 1
    assert len(seen_from(slam_map, looking((0.0, 0.0, -1.3))).points) == 0  # 6.3 away: above 1.2 times 5
    assert len(seen_from(slam_map, looking((0.0, 0.0, 5.0 - 1.1 * 5.0 / FACTORS[-1]))).points) == 1
    assert len(seen_from(slam_map, looking((0.0, 0.0, 5.0 - 0.8 * 5.0 / FACTORS[-1]))).points) == 0
    for degrees, kept in ((55.0, 1), (65.0, 0)):
        turn = np.radians(degrees)
        beside = (-5.0 * np.sin(turn), 0.0, 5.0 - 5.0 * np.cos(turn))
        assert len(seen_from(slam_map, looking(beside, turn)).points) == kept


def test_points_behind_are_left_out_and_the_rest_keep_their_order(rng: np.random.Generator) -> None:
    positions = rng.uniform(-4.0, 4.0, (100, 3))
    chosen = rng.permutation(100)[:60]
    pose = looking((0.3, -0.2, 0.1), 0.7, 0.2)
    ahead, pixels = project_ahead(chosen, positions, pose, CAMERA.intrinsics)
    in_camera = positions[chosen] @ pose[:3, :3].T + pose[:3, 3]
    assert np.array_equal(ahead, np.nonzero(in_camera[:, 2] > 0.0)[0])
    assert np.allclose(pixels, CAMERA.project(in_camera[ahead]))
