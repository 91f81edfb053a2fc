from __future__ import annotations

import numpy as np
import pytest
from rendered_scenes import features_at, random_descriptors

from codecbench.slam.features.hamming import hamming
from codecbench.slam.features.matching import (
    keep_consistent_rotations,
    match_by_appearance,
    match_in_windows,
)

pytestmark = pytest.mark.thorough

FACTORS = 1.2 ** np.arange(8)


def test_hamming_distance_counts_bits(rng: np.random.Generator) -> None:
    a, b = random_descriptors(rng, 20), random_descriptors(rng, 20)
    for i in range(20):
        assert hamming(a, i, b, i) == int(np.unpackbits((a[i] ^ b[i]).view(np.uint8)).sum())


def test_windows_find_every_feature_at_its_place(rng: np.random.Generator) -> None:
    pixels = rng.uniform([5.0, 5.0], [315.0, 235.0], (200, 2))
    descriptors = random_descriptors(rng, 200)
    features = features_at(pixels, descriptors)
    low, high = np.zeros(200, np.int64), np.ones(200, np.int64)
    shifted = pixels + rng.uniform(-4.0, 4.0, (200, 2))
    matches = match_in_windows(shifted, np.full(200, 5.0), low, high, descriptors, features, np.ones(200, bool), 50)
    assert np.array_equal(matches, np.arange(200))


def test_windows_match_as_a_plain_search_does(rng: np.random.Generator) -> None:
    count = 150
    pixels, octaves = rng.uniform([0.0, 0.0], [319.0, 239.0], (count, 2)), rng.integers(0, 8, count).astype(np.int32)
    descriptors = random_descriptors(rng, count)
    features, free = features_at(pixels, descriptors, octaves), rng.random(count) < 0.8
    which = rng.integers(0, count, 200)
    queried = descriptors[which] ^ (random_descriptors(rng, 200) & random_descriptors(rng, 200))
    places, radii = pixels[which] + rng.normal(0.0, 10.0, (200, 2)), rng.uniform(5.0, 60.0, 200)
    low, high = octaves[which] - 1, octaves[which] + rng.integers(0, 3, 200)
    bits = np.unpackbits((queried[:, None] ^ descriptors[None]).view(np.uint8), axis=2).sum(axis=2, dtype=int)
    expected, owners = np.full(200, -1), {}
    for q in range(200):
        near = (np.abs(pixels - places[q]) <= radii[q]).all(axis=1) & free
        chosen = np.nonzero(near & (octaves >= low[q]) & (octaves <= high[q]))[0]
        ranked = sorted(chosen, key=lambda f: bits[q, f])
        if not ranked or bits[q, ranked[0]] > 100:
            continue
        rival = ranked[1] if len(ranked) > 1 else None
        if rival is not None and octaves[ranked[0]] == octaves[rival] and bits[q, ranked[0]] > 0.8 * bits[q, rival]:
            continue
        owner = owners.get(ranked[0])
        if owner is None or bits[q, ranked[0]] < bits[owner, ranked[0]]:
            if owner is not None:
                expected[owner] = -1
            owners[ranked[0]], expected[q] = q, ranked[0]
    matches = match_in_windows(
        places, radii, low.astype(np.int64), high.astype(np.int64), queried, features, free, 100, 0.8
    )
    assert np.array_equal(matches, expected)
    assert (expected >= 0).sum() > 20


def test_windows_respect_radius_level_mask_and_ratio(rng: np.random.Generator) -> None:
    descriptors = random_descriptors(rng, 1)
    features = features_at(np.array([[100.0, 100.0], [103.0, 100.0]]), np.repeat(descriptors, 2, axis=0))
    query, queried = np.array([[100.0, 100.0]]), descriptors ^ np.uint64(1)
    one, zero, free = np.ones(1, np.int64), np.zeros(1, np.int64), np.ones(2, bool)

    def match(radius=5.0, low=zero, free=free, ratio=1.0):  # type: ignore[no-untyped-def]
        return int(match_in_windows(query, np.full(1, radius), low, one, queried, features, free, 50, ratio)[0])

    assert match() == 0
    assert match(low=one) == -1
    assert match(free=np.zeros(2, bool)) == -1
    assert match(free=np.array([False, True])) == 1
    assert match(radius=2.0, free=np.array([False, True])) == -1
    assert match(ratio=0.9) == -1


def test_a_feature_is_given_once_and_to_the_nearest(rng: np.random.Generator) -> None:
    descriptor = random_descriptors(rng, 1)
    near = descriptor.copy()
    near[0, 0] ^= np.uint64(0b111)
    features = features_at(np.array([[50.0, 50.0]]), descriptor)
    queries = np.concatenate([near, descriptor, near])
    levels = np.zeros(3, np.int64)
    matches = match_in_windows(
        np.full((3, 2), 50.0), np.full(3, 5.0), levels, levels, queries, features, np.ones(1, bool), 50
    )
    assert matches.tolist() == [-1, 0, -1]


def test_appearance_finds_the_permutation_and_keeps_to_nodes(rng: np.random.Generator) -> None:
    descriptors = random_descriptors(rng, 100)
    order = rng.permutation(100)
    every = np.ones(100, bool)
    nodes = np.arange(100) % 7
    matches = match_by_appearance(descriptors, nodes, every, descriptors[order], nodes[order], every, 50, 0.7)
    assert np.array_equal(order[matches], np.arange(100))
    apart = match_by_appearance(descriptors, nodes, every, descriptors[order], nodes[order] + 7, every, 50, 0.7)
    assert (apart == -1).all()


def test_matches_that_turn_otherwise_are_dropped(rng: np.random.Generator) -> None:
    angles = rng.uniform(-np.pi, np.pi, 100)
    turned = angles - 0.7
    turned[:8] -= np.pi / 2.0
    matches = keep_consistent_rotations(np.arange(100), angles, turned)
    assert (matches[:8] == -1).all()
    assert (matches[8:] == np.arange(8, 100)).all()
