"""Keyframes of several maps, searched at once."""

from __future__ import annotations

import numpy as np
import pytest
from map_scenes import build_map
from rendered_scenes import features_at, looking, random_descriptors

from codecbench.slam.map.map import Map
from codecbench.slam.places.recognition import PlaceRecognition, relocalization_candidates

pytestmark = pytest.mark.thorough

POSES = [looking((0.2 * i, 0.0, 0.0)) for i in range(4)]


def mapped(rng: np.random.Generator) -> tuple[Map, PlaceRecognition]:
    points = rng.uniform([-3.0, -2.0, 4.0], [4.0, 2.0, 7.0], (200, 3))
    slam_map, mapper = build_map(POSES, points, random_descriptors(rng, 200))
    return slam_map, mapper.places


def test_a_frame_is_looked_for_in_all_maps_and_the_likest_keyframe_comes_first(rng: np.random.Generator) -> None:
    maps = [mapped(rng) for _ in range(3)]
    places = [place for _, place in maps]
    for which, (slam_map, _) in enumerate(maps):
        candidates = relocalization_candidates(slam_map.keyframes.features[2], places)
        assert candidates[0][0] == which
        assert len(set(candidates)) == len(candidates)


def test_of_equal_maps_the_one_listed_first_comes_first(rng: np.random.Generator) -> None:
    slam_map, place = mapped(rng)
    candidates = relocalization_candidates(slam_map.keyframes.features[1], [place, place])
    assert [which for which, _ in candidates[:2]] == [0, 1]
    assert candidates[0][1] == candidates[1][1]


def test_without_maps_or_features_nothing_looks_alike(rng: np.random.Generator) -> None:
    nothing = features_at(np.empty((0, 2)), np.empty((0, 4), np.uint64))
    assert relocalization_candidates(nothing, [mapped(rng)[1]]) == []
    assert relocalization_candidates(nothing, []) == []


def test_in_another_map_connected_keyframes_are_candidates_too(rng: np.random.Generator) -> None:
    """Nobody is a neighbour across maps: keyframe 2 finds itself in a copy, and never in its own map."""
    seeds = [np.random.default_rng(5) for _ in range(2)]
    (_, place), (_, copy) = mapped(seeds[0]), mapped(seeds[1])
    assert place.loop_candidates(2, place) == []
    assert place.loop_candidates(2, copy)
