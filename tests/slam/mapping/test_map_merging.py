"""A walk mapped in two parts, each in coordinates of its own, put together again."""

from __future__ import annotations

import numpy as np
import pytest
from map_scenes import assert_consistent, build_map
from numpy.typing import NDArray
from rendered_scenes import CAMERA, looking, random_descriptors
from solver_scenes import similarity_from_tangent

from codecbench.slam.mapping.loop_closing import close_loop
from codecbench.slam.mapping.loop_detection import Loop
from codecbench.slam.mapping.map_merging import absorb_map, reroot_spanning_tree
from codecbench.slam.mapping.mapper import Mapper

pytestmark = pytest.mark.thorough

WALK = [looking((0.25 * i, 0.02 * i, 0.0), 0.01 * i) for i in range(16)]
FIRST, SECOND = range(9), range(6, 16)
MOVED = similarity_from_tangent((0.4, -1.0, 2.0, 0.5, -0.3, 0.2, np.log(1.7)))


def halves(rng: np.random.Generator) -> tuple[Mapper, Mapper, Loop, NDArray[np.float64]]:
    """The first part's mapper and the second one's, what its keyframe 8 shows of that one's keyframe 2, all points.

    Point i of the scene is point i of either map, where that has it.
    """
    points = rng.uniform([-3.0, -2.0, 4.0], [7.0, 2.0, 8.0], (500, 3))
    descriptors = random_descriptors(rng, len(points))
    first, second = (build_map([WALK[i] for i in part], points, descriptors)[1] for part in (FIRST, SECOND))
    for mapper in (first, second):
        mapper.map.remove_points(np.nonzero(mapper.map.points.observation_counts[: len(points)] < 2)[0])
    second.map.transform(MOVED)
    second.map.keyframes.scales[:] = 1.0  # as if it had been mapped so
    seen = first.map.keyframes.points[8].copy()
    seen[(seen >= 0) & ~second.map.points.alive[seen]] = -1
    keyframe_from_second = WALK[8] @ np.linalg.inv(MOVED)
    return first, second, Loop(8, 2, keyframe_from_second, seen, int((seen >= 0).sum())), points


def test_two_parts_of_a_walk_fit_together_exactly(rng: np.random.Generator) -> None:
    first, second, seen, points = halves(rng)
    joint = absorb_map(first, second, seen)
    slam_map = first.map
    assert np.allclose(joint.map_from_other, np.linalg.inv(MOVED))
    assert slam_map.keyframes.count == len(FIRST) + len(SECOND)
    for part, numbers in ((FIRST, np.arange(9)), (SECOND, joint.numbers)):
        assert np.allclose(slam_map.keyframes.camera_from_world[numbers], [WALK[i] for i in part])
    there = second.map.alive_points
    assert np.allclose(slam_map.points.positions[there + joint.first_point], points[there])
    assert_consistent(slam_map)
    before_from_after = close_loop(slam_map, CAMERA, joint.loop)
    assert np.allclose(before_from_after, np.eye(4), atol=1e-6)
    assert_consistent(slam_map)
    assert np.allclose(slam_map.keyframes.camera_from_world[joint.numbers], [WALK[i] for i in SECOND], atol=1e-6)


def test_points_of_both_sides_become_one(rng: np.random.Generator) -> None:
    first, second, seen, points = halves(rng)
    both = np.intersect1d(first.map.alive_points, second.map.alive_points)
    joint = absorb_map(first, second, seen)
    close_loop(first.map, CAMERA, joint.loop)
    resolved = first.map.resolve_points(both), first.map.resolve_points(both + joint.first_point)
    joined = (resolved[0] == resolved[1]) & (resolved[0] >= 0)
    assert joined.mean() > 0.9
    assert np.allclose(first.map.points.positions[resolved[0][joined]], points[both[joined]], atol=1e-6)


def test_keyframes_of_the_other_map_are_recognised_here(rng: np.random.Generator) -> None:
    first, second, seen, _ = halves(rng)
    nodes = second.places.nodes(9)
    number = int(absorb_map(first, second, seen).numbers[9])
    assert np.array_equal(first.places.nodes(number), nodes)
    assert first.places.loop_candidates(number, first.places)  # it is in the index: this raises KeyError where not


def test_points_on_probation_are_tended_on(rng: np.random.Generator) -> None:
    first, second, seen, _ = halves(rng)
    shared = np.intersect1d(*second.map.keyframes.points[8:10])[-1]  # it is exchanged for one made by the mapper
    features = [np.nonzero(second.map.keyframes.points[k] == shared)[0] for k in (8, 9)]
    second.map.remove_points(np.array([shared]))
    second.add_points(9, features[1], 8, features[0], np.array([[1.0, 1.0, 9.0]]))
    young = int(second.map.alive_points[-1])
    joint = absorb_map(first, second, seen)
    first.map.points.visible_counts[young + joint.first_point] = 100  # and hardly ever found
    first._cull_points()
    assert not first.map.points.alive[young + joint.first_point]


def test_parents_come_first_wherever_the_tree_is_hung_up(rng: np.random.Generator) -> None:
    _, second, _, _ = halves(rng)
    slam_map = second.map
    slam_map.remove_keyframe(5)
    parents = slam_map.keyframes.parents[:10].copy()
    edges = {frozenset((k, int(parents[k]))) for k in slam_map.alive_keyframes if parents[k] >= 0}
    order = reroot_spanning_tree(slam_map, 7).tolist()
    assert sorted(order) == list(range(10))
    assert (order[0], order[-1]) == (7, 5)
    hung = slam_map.keyframes.parents
    assert hung[7] == -1
    assert all(order.index(hung[k]) < order.index(k) for k in order[1:-1])
    assert {frozenset((k, int(hung[k]))) for k in order[1:-1]} == edges
