from __future__ import annotations

import numpy as np
import pytest
from map_scenes import assert_consistent, build_map
from rendered_scenes import looking, random_descriptors

from codecbench.slam.map.map import NONE, Map, grown

pytestmark = pytest.mark.thorough

POSES = [looking((0.2 * i, 0.0, 0.0)) for i in range(6)]


@pytest.fixture
def slam_map(rng: np.random.Generator) -> Map:
    points = rng.uniform([-3.0, -2.0, 4.0], [4.0, 2.0, 7.0], (200, 3))
    return build_map(POSES, points, random_descriptors(rng, 200))[0]


def test_a_grown_array_keeps_its_rows() -> None:
    array = grown(np.arange(6).reshape(3, 2), 4, NONE)
    assert array.shape == (6, 2)
    assert array[:3].tolist() == [[0, 1], [2, 3], [4, 5]]
    assert (array[3:] == NONE).all()


def test_covisibility_counts_shared_points(slam_map: Map) -> None:
    assert_consistent(slam_map)
    sets = [set(row[row >= 0].tolist()) for row in slam_map.keyframes.points[:6]]
    expected = [len(sets[2] & other) for other in sets]
    assert slam_map.covisibility(slam_map.keyframes.points[2]).tolist() == expected
    neighbors, weights = slam_map.neighbors(2)
    assert 2 not in neighbors
    assert (np.diff(weights) <= 0).all()
    assert [expected[k] for k in neighbors] == weights.tolist()


def test_a_point_that_one_keyframe_sees_dies(slam_map: Map) -> None:
    point = int(slam_map.keyframes.points[0][0])
    for _ in range(int(slam_map.points.observation_counts[point]) - 1):
        _, keyframes, features = slam_map.observations(np.array([point]))
        slam_map.unobserve(keyframes[:1], features[:1])
    assert not slam_map.points.alive[point]
    assert_consistent(slam_map)


def test_a_replaced_point_hands_its_observations_over(slam_map: Map) -> None:
    a, b = (int(p) for p in slam_map.keyframes.points[3][:2])
    only_a = set(slam_map.observations(np.array([a]))[1].tolist())
    only_b = set(slam_map.observations(np.array([b]))[1].tolist())
    slam_map.replace_points(np.array([a]), np.array([b]))
    assert set(slam_map.observations(np.array([b]))[1].tolist()) == only_a | only_b
    assert slam_map.resolve_points(np.array([a, b, NONE])).tolist() == [b, b, NONE]
    assert_consistent(slam_map)


def test_distances_and_normals_come_from_the_observations(slam_map: Map) -> None:
    point = int(slam_map.keyframes.points[0][0])
    position = slam_map.points.positions[point]
    _, keyframes, _ = slam_map.observations(np.array([point]))
    rays = position - slam_map.keyframes.centers_world[keyframes]
    mean = (rays / np.linalg.norm(rays, axis=1)[:, None]).sum(axis=0)
    assert np.allclose(slam_map.points.normals[point], mean / np.linalg.norm(mean))
    reference = int(slam_map.points.references[point])
    distance = np.linalg.norm(position - slam_map.keyframes.centers_world[reference])
    assert slam_map.points.max_distances[point] == pytest.approx(distance)
    assert slam_map.points.min_distances[point] == pytest.approx(distance / 1.2**7)


def test_a_removed_keyframe_stays_attached_and_stretches_with_its_anchor(slam_map: Map) -> None:
    before = slam_map.pose(3).copy()
    slam_map.remove_keyframe(3)
    assert not slam_map.keyframes.alive[3]
    assert np.allclose(slam_map.pose(3), before)
    assert_consistent(slam_map)
    assert all(slam_map.keyframes.alive[slam_map.keyframes.parents[k]] for k in slam_map.alive_keyframes if k > 0)
    anchor = slam_map.culled[3].anchor
    relative = before @ np.linalg.inv(slam_map.keyframes.camera_from_world[anchor])
    slam_map.keyframes.scales[anchor] *= 2.0
    stretched = slam_map.pose(3) @ np.linalg.inv(slam_map.keyframes.camera_from_world[anchor])
    assert np.allclose(stretched[:3, 3], 2.0 * relative[:3, 3])
    assert slam_map.scale_of(3) == pytest.approx(2.0)


def test_a_keyframe_is_redundant_once_others_see_nearly_all_its_points(slam_map: Map) -> None:
    own = slam_map.keyframes.points[2]
    features = np.nonzero(own >= 0)[0]
    others = slam_map.points.observation_counts[own[features]] - 1
    assert (others >= 3).mean() > 0.9
    assert slam_map.is_redundant(2)
    for point in own[features][others >= 3][: len(features) // 8]:  # an eighth is left to it and one other
        _, keyframes, seen_at = slam_map.observations(np.array([point]))
        forgotten = keyframes != 2
        forgotten[np.argmax(forgotten)] = False
        slam_map.unobserve(keyframes[forgotten], seen_at[forgotten])
    assert not slam_map.is_redundant(2)


def test_rescaling_keeps_every_projection(slam_map: Map) -> None:
    point = int(slam_map.keyframes.points[4][0])

    def ray() -> np.ndarray:
        pose = slam_map.keyframes.camera_from_world[4]
        x = pose[:3, :3] @ slam_map.points.positions[point] + pose[:3, 3]
        return x[:2] / x[2]

    before = ray()
    slam_map.rescale(0.25)
    assert np.allclose(ray(), before)
    assert slam_map.points.max_distances[point] == pytest.approx(
        np.linalg.norm(
            slam_map.points.positions[point] - slam_map.keyframes.centers_world[int(slam_map.points.references[point])]
        )
    )
