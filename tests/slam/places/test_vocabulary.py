from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from codecbench.slam.places.train_vocabulary import compose_picture, load_photographs, train
from codecbench.slam.places.vocabulary import BowVector, Vocabulary

pytestmark = pytest.mark.thorough


def random_bits(rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.integers(0, 2**64, (count, 4), dtype=np.uint64)


@pytest.fixture(scope="module")
def small() -> Vocabulary:
    """A tree of 4 branches and 3 levels over descriptors of twenty made-up pictures."""
    rng = np.random.default_rng(5)
    return train(random_bits(rng, 2000), np.arange(2000) % 20, rng, branches=4, depth=3)


def distances(bits: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    return np.unpackbits((bits ^ nodes).view(np.uint8).reshape(len(nodes), 32), axis=1).sum(axis=1)


def test_the_shipped_vocabulary_is_rich_and_small() -> None:
    vocabulary = Vocabulary.load_default()
    assert vocabulary is Vocabulary.load_default()
    assert len(vocabulary) >= 50_000
    file = Path(__import__("codecbench.slam.places", fromlist=["places"]).__file__).parent / "vocabulary.npz"
    assert file.stat().st_size <= 4_000_000


def test_descent_follows_the_nearest_child(small: Vocabulary, rng: np.random.Generator) -> None:
    bits = random_bits(rng, 100)
    found = small.words(bits, level=2)
    starts = np.cumsum(small.child_counts, dtype=np.int64) - small.child_counts + 1
    for i in range(100):
        node, path = 0, []
        while small.child_counts[node]:
            children = np.arange(starts[node], starts[node] + small.child_counts[node])
            node = children[distances(bits[i], small.descriptors[children - 1].view(np.uint64)).argmin()]
            path.append(node)
        assert found.words[i] == (small.child_counts[:node] == 0).sum()
        assert found.nodes[i] == path[min(2, len(path)) - 1]
    np.testing.assert_array_equal(found.weights, small.weights[found.words])


def test_bytes_and_64_bit_descriptors_are_the_same(small: Vocabulary, rng: np.random.Generator) -> None:
    bits = random_bits(rng, 50)
    np.testing.assert_array_equal(small.words(bits).words, small.words(bits.view(np.uint8).reshape(50, 32)).words)
    assert len(small.words(bits[:0]).words) == 0


@pytest.mark.parametrize("descriptors", [np.zeros((3, 31), np.uint8), np.zeros((3, 32)), np.zeros(32, np.uint8)])
def test_other_descriptors_are_refused(small: Vocabulary, descriptors: np.ndarray) -> None:
    with pytest.raises(ValueError, match="expected uint8"):
        small.words(descriptors)


def test_bags_are_normalised_and_score_one_with_themselves(small: Vocabulary, rng: np.random.Generator) -> None:
    bags = [small.bow(small.words(random_bits(rng, 60)).words) for _ in range(5)]
    for bag in bags:
        assert bag.values.sum() == pytest.approx(1.0)
        assert bag.score(bag) == pytest.approx(1.0)
        assert (np.diff(bag.words) > 0).all()
    for a in bags:
        for b in bags:
            dense = np.zeros((2, len(small)))
            dense[0, a.words], dense[1, b.words] = a.values, b.values
            assert a.score(b) == pytest.approx(1.0 - 0.5 * np.abs(dense[0] - dense[1]).sum())
            assert a.score(b) == b.score(a)


def test_bag_of_tf_idf(small: Vocabulary) -> None:
    words = np.array([5, 3, 5, 5])
    bag = small.bow(words)
    expected = np.array([1, 3]) * small.weights[[3, 5]]
    np.testing.assert_array_equal(bag.words, [3, 5])
    np.testing.assert_allclose(bag.values, expected / expected.sum())


def test_an_empty_image_scores_nothing(small: Vocabulary, rng: np.random.Generator) -> None:
    empty = small.bow(np.zeros(0, dtype=np.int64))
    assert len(empty.words) == 0
    assert empty.score(small.bow(small.words(random_bits(rng, 9)).words)) == 0.0
    assert empty.score(BowVector(empty.words, empty.values)) == 0.0


def test_npz_round_trip(small: Vocabulary, tmp_path: Path) -> None:
    small.save(tmp_path / "v.npz")
    again = Vocabulary.load(tmp_path / "v.npz")
    np.testing.assert_array_equal(again.descriptors, small.descriptors)
    np.testing.assert_allclose(again.weights, small.weights, rtol=1e-6)


def test_dbow2_text_round_trip(small: Vocabulary, tmp_path: Path, rng: np.random.Generator) -> None:
    small.write_dbow2_text(tmp_path / "v.txt")
    lines = (tmp_path / "v.txt").read_text().splitlines()
    assert lines[0] == "10 6 0 0"
    assert len(lines) == len(small.child_counts)
    assert all(len(line.split()) == 35 for line in lines[1:])
    again = Vocabulary.read_dbow2_text(tmp_path / "v.txt")
    np.testing.assert_array_equal(again.child_counts, small.child_counts)
    np.testing.assert_array_equal(again.descriptors, small.descriptors)
    np.testing.assert_allclose(again.weights, small.weights, rtol=1e-8)
    bits = random_bits(rng, 40)
    np.testing.assert_array_equal(again.words(bits).words, small.words(bits).words)


def test_dbow2_text_of_another_node_order_is_the_same_tree(small: Vocabulary, tmp_path: Path) -> None:
    """Depth first, as DBoW2 writes: the nodes get other numbers but every descriptor keeps its leaf."""
    parents = np.r_[-1, small.parents]
    order, stack = [], [0]
    while stack:
        node = stack.pop()
        order.append(node)
        stack.extend(np.flatnonzero(parents == node)[::-1].tolist())
    new = np.argsort(order)
    weights = np.zeros(len(parents))
    weights[small.child_counts == 0] = small.weights
    with (tmp_path / "v.txt").open("w") as file:
        file.write("4 3 0 0\n")
        for node in order[1:]:
            leaf = int(small.child_counts[node] == 0)
            row = " ".join(map(str, small.descriptors[node - 1]))
            file.write(f"{new[parents[node]]} {leaf} {row} {weights[node]:.9g}\n")
    again = Vocabulary.read_dbow2_text(tmp_path / "v.txt")
    np.testing.assert_array_equal(again.descriptors, small.descriptors)


@pytest.mark.parametrize(
    ("text", "message"), [("0 1 5\n", "rows of 3"), ("7 1" + " 0" * 32 + " 1\n", "before its parent")]
)
def test_damaged_text_is_refused(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "v.txt").write_text("10 6 0 0\n" + text)
    with pytest.raises(ValueError, match=message):
        Vocabulary.read_dbow2_text(tmp_path / "v.txt")


@pytest.mark.parametrize(
    ("counts", "rows", "weights", "message"),
    [
        ([2, 0], 1, [1.0], "one tree"),
        ([1, 0], 1, [1.0, 2.0], "expected"),
        ([1, 0], 2, [1.0], "expected"),
        ([0, 1], 1, [1.0], "one tree"),
        ([1, 0], 1, [-1.0], "negative"),
        ([1, 0], 1, [np.nan], "not finite"),
    ],
)
def test_what_is_no_tree_is_refused(counts: list[int], rows: int, weights: list[float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Vocabulary(np.array(counts, np.uint8), np.zeros((rows, 32), np.uint8), np.array(weights))


def test_training_repeats_to_the_bit_and_depends_on_the_seed() -> None:
    bits, pictures = random_bits(np.random.default_rng(1), 600), np.arange(600) % 10
    one, two, other = (train(bits, pictures, np.random.default_rng(s), branches=3, depth=3) for s in (1, 1, 2))
    np.testing.assert_array_equal(one.descriptors, two.descriptors)
    np.testing.assert_array_equal(one.weights, two.weights)
    assert one.descriptors.shape != other.descriptors.shape or (one.descriptors != other.descriptors).any()


def test_training_finds_clusters_and_their_idf(rng: np.random.Generator) -> None:
    """Ten far centres, each with descriptors that differ in a few bits: one word each; the first is everywhere."""
    centres = random_bits(rng, 10)
    labels = np.repeat(np.arange(10), 50)
    noise = np.zeros((500, 4), dtype=np.uint64)
    noise[np.arange(500), rng.integers(0, 4, 500)] = np.uint64(1) << rng.integers(0, 64, 500).astype(np.uint64)
    pictures = np.where(labels == 0, np.arange(500) % 10, labels)
    vocabulary = train(centres[labels] ^ noise, pictures, rng, branches=10, depth=1)
    words = vocabulary.words(centres).words
    assert len(set(words)) == 10
    np.testing.assert_array_equal(vocabulary.words(centres[labels] ^ noise).words, words[labels])
    np.testing.assert_array_equal(vocabulary.descriptors[words].view(np.uint64).reshape(10, 4), centres)
    np.testing.assert_allclose(vocabulary.weights[words], [0.0] + [np.log(10.0)] * 9)


def test_training_pictures_are_full_of_corners_and_repeat() -> None:
    photographs = load_photographs()
    one, two = (compose_picture(photographs, np.random.default_rng(4)) for _ in range(2))
    np.testing.assert_array_equal(one, two)
    assert one.shape == (480, 640)
    assert one.dtype == np.uint8
    assert one.std() > 10.0
