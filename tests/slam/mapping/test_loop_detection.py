"""Which candidates a keyframe closes a loop with, on points of which a known number agree on one similarity."""

from __future__ import annotations

import numpy as np
import pytest
from map_scenes import build_map
from numpy.typing import NDArray
from rendered_scenes import CAMERA, looking, random_descriptors

from codecbench.slam import thresholds
from codecbench.slam.geometry.transforms import sim3_exp
from codecbench.slam.map.map import Map
from codecbench.slam.mapping.loop_detection import Loop, LoopDetector

pytestmark = pytest.mark.thorough

POSES = [looking((0.2 * i, 0.0, 0.0)) for i in range(4)]  # the first two saw the place early, the last two again, late
MATCHES = 36
SCALE = 1.3  # by which the late side has drifted


class EarlySide:
    """Place recognition that knows the answer: every keyframe looks like keyframe 0 of any map."""

    def __init__(self, slam_map: Map) -> None:
        self.map = slam_map

    def nodes(self, keyframe: int) -> NDArray[np.int64]:
        return np.zeros(2 * MATCHES, np.int64)

    def loop_candidates(self, keyframe: int, there: EarlySide) -> list[int]:
        return [0]


def place_seen_twice(rng: np.random.Generator, agreeing: int) -> Map:
    """A map that has each of MATCHES points twice; `agreeing` late ones are where one similarity puts them."""
    points = rng.uniform([-1.0, -1.2, 4.0], [1.5, 1.2, 7.0], (MATCHES, 3))
    descriptors = random_descriptors(rng, MATCHES)
    slam_map, _ = build_map(POSES, np.tile(points, (2, 1)), np.tile(descriptors, (2, 1)))
    table = slam_map.keyframes.points
    assert (table[:4, : 2 * MATCHES] >= 0).all()  # every point is in every image
    for k in range(4):
        other_side = np.nonzero((table[k] >= MATCHES) != (k >= 2))[0]
        slam_map.unobserve(np.full(len(other_side), k), other_side)
    late = slam_map.points.positions[MATCHES:]
    late[agreeing:MATCHES] += rng.choice([-1.0, 1.0], (MATCHES - agreeing, 3)) * rng.uniform(
        0.5, 1.0, (MATCHES - agreeing, 3)
    )
    late[:MATCHES] *= SCALE
    drifted = slam_map.keyframes.camera_from_world[2:4].copy()
    drifted[:, :3, 3] *= SCALE
    slam_map.keyframes.set_pose(np.array([2, 3]), drifted)
    slam_map.refresh_points(slam_map.alive_points)
    return slam_map


def detect(here: Map, there: Map | None = None) -> list[Loop | None]:
    sides = EarlySide(here), EarlySide(there or here)
    detector = LoopDetector(*sides, CAMERA, np.random.default_rng(0))  # type: ignore[arg-type]
    return [detector.detect(3) for _ in range(thresholds.LOOP_CONSISTENT_KEYFRAMES)]


@pytest.fixture
def any_projected(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few points will do once a similarity is accepted: these maps are small."""
    monkeypatch.setattr(thresholds, "LOOP_MIN_PROJECTED", 1)


@pytest.mark.usefixtures("any_projected")
def test_a_loop_is_seen_when_its_candidate_has_held_for_three_keyframes(rng: np.random.Generator) -> None:
    *early, loop = detect(place_seen_twice(rng, MATCHES))
    assert early == [None, None]
    assert loop is not None
    assert (loop.keyframe, loop.matched_keyframe) == (3, 0)
    expected = POSES[3].copy()
    expected[:3, :3] *= SCALE
    expected[:3, 3] *= SCALE
    assert np.abs(loop.keyframe_from_world - expected).max() < 1e-6
    shown = np.nonzero(loop.points >= 0)[0]
    assert loop.inliers == len(shown) > 0.9 * MATCHES
    assert np.array_equal(loop.points[shown], shown % MATCHES)  # features are in the order of the points


@pytest.mark.usefixtures("any_projected")
@pytest.mark.parametrize("spare", [-1, 0])
def test_a_similarity_needs_loop_min_inliers(rng: np.random.Generator, spare: int) -> None:
    found = detect(place_seen_twice(rng, thresholds.LOOP_MIN_INLIERS + spare))[-1]
    assert (found is not None) == (spare == 0)


@pytest.mark.usefixtures("any_projected")
def test_the_threshold_is_read_as_it_stands(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    slam_map = place_seen_twice(rng, 14)
    assert detect(slam_map)[-1] is not None
    monkeypatch.setattr(thresholds, "LOOP_MIN_INLIERS", 15)
    assert detect(slam_map)[-1] is None


def test_a_loop_that_few_points_project_into_is_refused(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    slam_map = place_seen_twice(rng, MATCHES)
    monkeypatch.setattr(thresholds, "LOOP_MIN_PROJECTED", MATCHES + 1)
    assert detect(slam_map)[-1] is None


@pytest.mark.usefixtures("any_projected")
def test_of_what_a_loop_s_side_should_show_a_share_must_be_found(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    slam_map = place_seen_twice(rng, MATCHES)
    elsewhere = slam_map.points.add(rng.uniform([-1.0, -1.2, 4.0], [1.5, 1.2, 7.0], (9 * MATCHES, 3)), 0, 0)
    monkeypatch.setattr(slam_map, "points_of", lambda group: np.concatenate([np.arange(MATCHES), elsewhere]))
    slam_map.points.normals[elsewhere] = [0.0, 0.0, 1.0]
    slam_map.points.min_distances[elsewhere], slam_map.points.max_distances[elsewhere] = 0.1, 100.0
    slam_map.points.descriptors[elsewhere] = random_descriptors(rng, 9 * MATCHES)
    monkeypatch.setattr(thresholds, "LOOP_MIN_PROJECTED_SHARE", 0.05)
    assert detect(slam_map)[-1] is not None
    monkeypatch.setattr(thresholds, "LOOP_MIN_PROJECTED_SHARE", 0.2)
    assert detect(slam_map)[-1] is None


@pytest.mark.usefixtures("any_projected")
def test_a_place_of_another_map_is_seen_in_that_maps_coordinates() -> None:
    """The other map is as large as it likes and lies as it likes: what is found follows it."""
    here, there = (place_seen_twice(np.random.default_rng(4), MATCHES) for _ in range(2))
    moved = np.asarray(sim3_exp(np.array([0.5, -2.0, 1.0, 0.3, -0.2, 0.4, np.log(2.5)])))
    there.transform(moved)
    loop = detect(here, there)[-1]
    assert loop is not None
    assert (loop.keyframe, loop.matched_keyframe) == (3, 0)
    expected = POSES[3].copy()
    expected[:3] *= SCALE
    assert np.abs(loop.keyframe_from_world @ moved - expected).max() < 1e-6
    shown = np.nonzero(loop.points >= 0)[0]
    assert len(shown) > 0.9 * MATCHES
    assert np.array_equal(loop.points[shown], shown % MATCHES)
