from __future__ import annotations

import numpy as np
import pytest
from map_scenes import assert_consistent, build_map
from rendered_scenes import looking, random_descriptors

from codecbench.slam.geometry.transforms import sim3_exp
from codecbench.slam.map.map import NONE, Map, ensure_rows

pytestmark = pytest.mark.thorough

POSES = [looking((0.2 * i, 0.0, 0.0)) for i in range(6)]


@pytest.fixture
def slam_map(rng: np.random.Generator) -> Map:
    points = rng.uniform([-3.0, -2.0, 4.0], [4.0, 2.0, 7.0], (200, 3))
    return build_map(POSES, points, random_descriptors(rng, 200))[0]


def test_a_grown_array_keeps_its_rows() -> None:
    array = ensure_rows(np.arange(6).reshape(3, 2), 4, NONE)
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


def test_covisible_keyframes_are_ranked_by_shared_points_then_age(slam_map: Map, rng: np.random.Generator) -> None:
    points = rng.choice(np.append(slam_map.alive_points, NONE), 6)
    weights = slam_map.covisibility(points)
    order = np.argsort(-weights, kind="stable")
    for left_out in (NONE, int(order[0])):
        expected = [k for k in order if weights[k] > 0 and k != left_out]
        keyframes, counts = slam_map.rank_covisible(points, left_out)
        assert keyframes.tolist() == expected
        assert counts.tolist() == weights[expected].tolist()


def test_a_point_replaced_twice_resolves_to_the_last_and_a_dead_one_to_none(slam_map: Map) -> None:
    first, second, third, dead = slam_map.alive_points[:4]
    slam_map.replace_points(np.array([first]), np.array([second]))
    slam_map.replace_points(np.array([second]), np.array([third]))
    slam_map.remove_points(np.array([dead]))
    resolved = slam_map.resolve_points(np.array([first, NONE, dead, third, second]))
    assert resolved.tolist() == [third, NONE, NONE, third, third]


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


def test_a_similarity_moves_points_and_keyframes_and_no_pixel(slam_map: Map) -> None:
    slam_map.remove_keyframe(4)
    slam_map.remove_keyframe(3)  # 4 hangs on 3, which hangs on another one
    moved = np.asarray(sim3_exp(np.array([0.4, -1.0, 2.0, 0.5, -0.3, 0.2, np.log(1.7)])))
    positions, pixels = slam_map.points.positions[:200].copy(), np.array([pixels_of(slam_map, k) for k in range(6)])
    distances = slam_map.points.max_distances[slam_map.alive_points]
    centres = np.array([np.linalg.inv(slam_map.pose(k)) @ [0.0, 0.0, 0.0, 1.0] for k in range(6)])
    slam_map.transform(moved)
    expected = np.column_stack([positions, np.ones(200)]) @ moved.T
    assert np.allclose(slam_map.points.positions[:200], expected[:, :3])
    assert np.allclose([np.linalg.inv(slam_map.pose(k)) @ [0.0, 0.0, 0.0, 1.0] for k in range(6)], centres @ moved.T)
    assert np.allclose([pixels_of(slam_map, k) for k in range(6)], pixels)
    assert np.allclose(slam_map.points.max_distances[slam_map.alive_points], 1.7 * distances)
    assert np.allclose([slam_map.scale_of(k) for k in range(6)], 1.7)


def pixels_of(slam_map: Map, keyframe: int) -> np.ndarray:
    """Where a keyframe, alive or culled, sees the first 20 points, for a focal length of 1."""
    pose = slam_map.pose(keyframe)
    in_camera = slam_map.points.positions[:20] @ pose[:3, :3].T + pose[:3, 3]
    return np.asarray(in_camera[:, :2] / in_camera[:, 2:])


def test_an_appended_map_is_the_same_under_other_numbers(rng: np.random.Generator, slam_map: Map) -> None:
    points = rng.uniform([-3.0, -2.0, 4.0], [4.0, 2.0, 7.0], (150, 3))
    other = build_map(POSES[:5], points, random_descriptors(rng, 150))[0]
    other = padded(other, slam_map)
    other.replace_points(np.array([7]), np.array([8]))
    other.remove_keyframe(3)
    other.loop_edges.append((0, 4))
    other.refresh_points(other.alive_points)
    order = np.array([2, 1, 0, 4, 3])
    before = {int(k): (other.pose(k), other.keyframes.points[k].copy()) for k in order}
    neighbors = other.neighbors(2)
    numbers, first_point = slam_map.append(other, order)
    assert first_point == 200
    assert numbers[order].tolist() == [6, 7, 8, 9, 10]
    assert_consistent(slam_map)
    for k, (pose, seen) in before.items():
        assert np.allclose(slam_map.pose(int(numbers[k])), pose)
        assert np.array_equal(slam_map.keyframes.points[numbers[k]], np.where(seen >= 0, seen + 200, NONE))
    assert slam_map.keyframes.frame_indices[numbers].tolist() == [0, 1, 2, 3, 4]
    assert slam_map.keyframes.alive[numbers].tolist() == [True, True, True, False, True]
    assert slam_map.neighbors(int(numbers[2]))[1].tolist() == neighbors[1].tolist()
    assert slam_map.resolve_points(np.array([207, 209])).tolist() == [208, 209]
    assert slam_map.loop_edges == [(8, 9)]
    assert len(slam_map.keyframes.features[9]) == len(other.keyframes.features[4])
    alive = other.alive_points
    assert np.array_equal(slam_map.points.references[alive + 200], numbers[other.points.references[alive]])
    slam_map.refresh_points(slam_map.alive_points)  # whatever derives from observations is found in the new place
    for column in ("normals", "max_distances", "descriptors"):
        assert np.allclose(getattr(slam_map.points, column)[alive + 200], getattr(other.points, column)[alive])


def test_rows_that_come_after_an_appended_map_are_empty(slam_map: Map) -> None:
    other = Map(1, slam_map.scale_factors, slam_map.pixel_variances, 200)
    other.points.add(np.zeros((5000, 3)), NONE, 0)
    other.points.heads[:] = 3
    slam_map.append(other, np.empty(0, np.int64))
    added = slam_map.points.add(np.ones((10, 3)), 0, 0)
    assert (slam_map.points.heads[added] == NONE).all()
    assert (slam_map.points.replaced_by[added] == NONE).all()


def padded(slam_map: Map, like: Map) -> Map:
    """The map with as many columns for features as another: a System makes them all alike."""
    table, width = slam_map.keyframes, like.keyframes.points.shape[1]
    for name in ("pixels", "octaves", "descriptors", "points"):
        column = getattr(table, name)
        wider = np.full((len(column), width, *column.shape[2:]), NONE if name == "points" else 0, column.dtype)
        wider[:, : column.shape[1]] = column
        setattr(table, name, wider)
    return slam_map
