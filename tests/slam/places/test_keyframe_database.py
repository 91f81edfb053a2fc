from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from codecbench.slam.features.extractor import FeatureExtractor
from codecbench.slam.geometry.camera import Camera
from codecbench.slam.options import Options
from codecbench.slam.places.recognition import KeyframeDatabase
from codecbench.slam.places.vocabulary import BowVector, Vocabulary

pytestmark = pytest.mark.thorough

WORDS = 300


def random_bag(rng: np.random.Generator, count: int = 40, low: int = 0, high: int = WORDS) -> BowVector:
    words = np.sort(rng.choice(np.arange(low, high), count, replace=False))
    values = rng.random(count)
    return BowVector(words, values / values.sum())


def no_neighbours(_: int) -> list[int]:
    return []


def test_the_index_equals_brute_force_through_additions_and_erasures(rng: np.random.Generator) -> None:
    database, bags = KeyframeDatabase(WORDS), {}
    for step in range(300):
        if bags and rng.random() < 0.35:
            gone = int(rng.choice(list(bags)))
            del bags[gone]
            database.erase(gone)
        else:
            bags[step] = random_bag(rng, int(rng.integers(1, 80)))
            database.add(step, bags[step])
        if step % 10:
            continue
        query = random_bag(rng)
        keyframes, scores, shared = database.query(query)
        expected = {k: len(np.intersect1d(b.words, query.words)) for k, b in sorted(bags.items())}
        assert dict(zip(keyframes, shared, strict=True)) == {k: n for k, n in expected.items() if n}
        np.testing.assert_allclose(scores, [bags[int(k)].score(query) for k in keyframes])
    assert len(database) == len(bags)
    assert all(keyframe in database for keyframe in bags)


def test_an_empty_index_and_an_empty_bag(rng: np.random.Generator) -> None:
    database = KeyframeDatabase(WORDS)
    empty = BowVector(np.zeros(0, np.int64), np.zeros(0))
    assert len(database.query(random_bag(rng))[0]) == 0
    assert database.relocalization_candidates(random_bag(rng), no_neighbours) == []
    database.add(0, empty)
    database.add(1, random_bag(rng))
    assert len(database.query(empty)[0]) == 0
    database.erase(0)
    assert 0 not in database


def test_misuse_is_refused(rng: np.random.Generator) -> None:
    database = KeyframeDatabase(WORDS)
    database.add(3, random_bag(rng))
    with pytest.raises(ValueError, match=r"keyframe 3 .*indexed"):
        database.add(3, random_bag(rng))
    with pytest.raises(ValueError, match=r"allowed 0\.\.299"):
        database.add(4, BowVector(np.array([300]), np.ones(1)))
    with pytest.raises(KeyError):
        database.erase(99)


def test_the_same_place_is_the_first_candidate(rng: np.random.Generator) -> None:
    database = KeyframeDatabase(WORDS)
    places = [random_bag(rng) for _ in range(50)]
    for keyframe, bag in enumerate(places):
        database.add(keyframe, bag)
    for keyframe in (0, 17, 49):
        assert database.relocalization_candidates(places[keyframe], no_neighbours)[0][0] == keyframe


def test_excluded_keyframes_and_low_scores_are_no_candidates(rng: np.random.Generator) -> None:
    database, bag = KeyframeDatabase(WORDS), random_bag(rng)
    database.add(0, bag)
    database.add(1, BowVector(bag.words, np.full(len(bag.words), 1.0 / len(bag.words))))
    low = database.query(bag)[1][1]
    assert set(database.loop_candidates(bag, no_neighbours, [], 0.0)) <= {0, 1}
    assert database.loop_candidates(bag, no_neighbours, [0], 0.0) == [1]
    assert database.loop_candidates(bag, no_neighbours, [0], low + 1e-6) == []
    assert database.loop_candidates(bag, no_neighbours, [0, 1], 0.0) == []


def test_covisible_keyframes_add_up_and_send_their_best(rng: np.random.Generator) -> None:
    """Keyframes 1, 2, 3 each look less like the query than keyframe 9 does, but they see one place together."""
    query, database = BowVector(np.arange(100), np.full(100, 0.01)), KeyframeDatabase(WORDS)
    for keyframe, shared in ((1, 88), (2, 92), (3, 90), (9, 95)):
        database.add(keyframe, BowVector(np.arange(100), np.r_[np.full(shared, 0.01), np.full(100 - shared, 1e-6)]))
    together = {1: [2, 3], 2: [1, 3], 3: [2, 1], 9: []}
    assert database.loop_candidates(query, lambda k: together[k], [], 0.0) == [2]
    assert database.loop_candidates(query, no_neighbours, [], 0.0)[0] == 9


@pytest.mark.real
def test_a_street_is_recognised_when_it_is_driven_again(data_folder: Path) -> None:
    """A town drive comes back at frame 1568 to where it was near frame 120: the old place must rank first."""
    folder = data_folder / "kitti00_half"
    if not folder.is_dir():
        pytest.skip(f"{folder} is not there")
    lines = [line.split() for line in (folder / "rgb.txt").read_text().splitlines() if not line.startswith("#")]
    truth = np.loadtxt(folder / "groundtruth.txt")
    nearest = [int(np.abs(truth[:, 0] - float(stamp)).argmin()) for stamp, _ in lines]
    positions = truth[nearest, 1:4]
    first = cv2.imread(str(folder / lines[0][1]), cv2.IMREAD_GRAYSCALE)
    height, width = first.shape
    extractor = FeatureExtractor(Camera(width, height, 360.0, 360.0, width / 2, height / 2), Options())
    vocabulary = Vocabulary.load_default()

    def bag(frame: int) -> BowVector:
        image = cv2.imread(str(folder / lines[frame][1]), cv2.IMREAD_GRAYSCALE)
        return vocabulary.bow(vocabulary.words(extractor.extract(image).descriptors).words)

    database = KeyframeDatabase(len(vocabulary))
    for frame in [*range(0, 300, 6), *range(300, 1400, 25)]:
        database.add(frame, bag(frame))
    queries = range(1576, 1636, 12)
    best = [database.relocalization_candidates(bag(frame), no_neighbours)[0][0] for frame in queries]
    away_m = np.linalg.norm(positions[list(queries)] - positions[best], axis=1)
    assert (away_m < 10.0).all(), dict(zip(queries, zip(best, away_m, strict=True), strict=True))
