"""Keys and searches against exhaustive enumeration."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codecbench.core.contracts.errors import ParamsError
from codecbench.plugins.codecs.multilevel.keys import (
    canonical_keys,
    check_keys,
    colliding_digits,
    greedy_search,
    is_super_increasing,
    manual_keys,
    pruned_search,
    random_keys,
    sequential_search,
)


def is_one_to_one(keys: np.ndarray, radix: int) -> bool:
    codes = np.array(list(product(range(radix), repeat=len(keys)))) @ keys
    return len(np.unique(codes)) == len(codes)


@given(st.lists(st.integers(1, 60), min_size=2, max_size=4), st.integers(1, 6))
@settings(max_examples=400)
def test_collisions_are_found_exactly_where_they_are(values: list[int], radix: int) -> None:
    keys = np.array(values, np.int64)
    pair = colliding_digits(keys, radix)
    assert (pair is None) == is_one_to_one(keys, radix)
    if pair is not None:
        first, second = (np.array(digits) for digits in pair)
        assert first @ keys == second @ keys
        assert not np.array_equal(first, second)
        assert min(first.min(), second.min()) >= 0
        assert max(first.max(), second.max()) < radix


@given(st.integers(1, 40), st.integers(2, 6), st.integers(0, 1000))
@settings(max_examples=100)
def test_automatic_keys_are_super_increasing(radix: int, group: int, seed: int) -> None:
    assert is_super_increasing(np.array(canonical_keys(radix, group)), radix)
    assert is_super_increasing(np.array(random_keys(radix, group, np.random.default_rng(seed))), radix)


def test_random_keys_follow_their_seed() -> None:
    assert random_keys(50, 3, np.random.default_rng(4)) == random_keys(50, 3, np.random.default_rng(4))
    assert random_keys(50, 3, np.random.default_rng(4)) != random_keys(50, 3, np.random.default_rng(5))


def test_two_decimal_keys_collide_at_the_papers_alphabets() -> None:
    keys = np.array(manual_keys([0.31, 0.52, 0.87]), np.int64)
    for radix in (27, 130, 530):
        assert colliding_digits(keys, radix) is not None


def test_codes_beyond_62_bits_are_refused() -> None:
    with pytest.raises(ParamsError, match="at most 62 fit"):
        check_keys(canonical_keys(500, 8), 500, 1)


def test_keys_that_cannot_be_checked_are_refused() -> None:
    with pytest.raises(ParamsError, match="too many tuples"):
        colliding_digits(np.array([7, 11, 13, 17, 19, 23], np.int64), 500)


ONE_TO_ONE = [
    ([1, 7, 49], 7),
    ([49, 1, 7], 7),
    ([3, 40, 500, 9001], 5),
    (manual_keys([0.1234567891, 0.52345678987, 0.87987654321]), 9),
    ([5, 3], 3),
    ([1, 1, 1], 1),
]


@pytest.mark.parametrize(("values", "radix"), ONE_TO_ONE)
def test_all_searches_find_the_tuple(values: list[int], radix: int) -> None:
    keys = np.array(values, np.int64)
    tuples = np.array(list(product(range(radix), repeat=len(values))))
    codes = tuples @ keys
    assert colliding_digits(keys, radix) is None
    order = np.argsort(keys)
    found = [np.empty(tuples.shape, np.int32) for _ in range(3)]
    assert sequential_search(codes, keys, radix, found[0])
    assert pruned_search(codes, keys, order, radix, found[1])
    assert np.array_equal(found[0], tuples)
    assert np.array_equal(found[1], tuples)
    if is_super_increasing(keys, radix):
        assert greedy_search(codes, keys, order, radix, found[2])
        assert np.array_equal(found[2], tuples)


@pytest.mark.parametrize("values", [[1, 9, 90], [2, 30, 301]])
def test_a_code_without_a_tuple_is_noticed(values: list[int]) -> None:
    keys = np.array(values, np.int64)
    reachable = {int(code) for code in np.array(list(product(range(4), repeat=3))) @ keys}
    order = np.arange(3)
    out = np.empty((1, 3), np.int32)
    for code in range(max(reachable) + 5):
        codes = np.array([code], np.int64)
        expected = code in reachable
        assert sequential_search(codes, keys, 4, out) == expected
        assert pruned_search(codes, keys, order, 4, out) == expected
        assert greedy_search(codes, keys, order, 4, out) == expected
