"""Paired tests against scipy's, against brute force, and on samples in which nothing differs."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import permutation_test

from codecbench.core.results.ranking.paired import block_means, holm, joined_groups, least_units, sign_flip_p


@pytest.mark.parametrize("count", [1, 2, 5, 9])
def test_few_differences_are_tested_exactly_as_scipy_does(count: int, rng: np.random.Generator) -> None:
    rows = rng.normal(0.5, 1.0, (4, count))
    expected = [
        permutation_test((row, np.zeros(count)), lambda a, b: np.sum(a - b), permutation_type="samples").pvalue
        if count > 1
        else 1.0
        for row in rows
    ]
    np.testing.assert_allclose(sign_flip_p(rows), expected, atol=1e-12)


def test_many_differences_are_tested_by_seeded_signs(rng: np.random.Generator) -> None:
    rows = rng.normal(0.3, 1.0, (2, 40))
    found = sign_flip_p(rows)
    np.testing.assert_array_equal(found, sign_flip_p(rows))
    # The sum of independent signs times the differences is nearly normal: z = sum / root of the sum of squares.
    z = np.abs(rows.sum(axis=1)) / np.sqrt((rows**2).sum(axis=1))
    from scipy.stats import norm

    np.testing.assert_allclose(found, 2 * norm.sf(z), atol=0.02)


def test_no_difference_is_no_evidence() -> None:
    assert sign_flip_p(np.zeros((1, 5))).tolist() == [1.0]
    assert sign_flip_p(np.zeros((1, 50))).tolist() == [1.0]


def test_all_of_one_sign_is_the_least_that_so_many_can_give() -> None:
    assert sign_flip_p(np.ones((1, 5))).tolist() == [2 / 32]


@pytest.mark.parametrize(("tests", "least"), [(1, 8), (3, 10), (10, 11), (15, 12)])
def test_so_many_units_can_be_significant_and_one_less_cannot(tests: int, least: int) -> None:
    assert least_units(tests, 0.01) == least
    for units, significant in ((least, True), (least - 1, False)):
        p_values = np.full(tests, sign_flip_p(np.ones((1, units)))[0])
        assert bool((holm(p_values) < 0.01).all()) is significant


def test_holm_is_the_textbook_s() -> None:
    """Four p-values times 4, 3, 2, 1 in order, and never less than one before."""
    found = holm(np.array([0.01, 0.04, 0.03, 0.005]))
    np.testing.assert_allclose(found, [0.03, 0.06, 0.06, 0.02])
    np.testing.assert_allclose(holm(np.array([0.6, np.nan, 0.7])), [1.0, np.nan, 1.0])


def test_blocks_are_contiguous_and_as_many_as_they_are_long() -> None:
    np.testing.assert_allclose(block_means(np.arange(16.0)), [1.5, 5.5, 9.5, 13.5])
    assert block_means(np.ones((3, 715))).shape == (3, 26)
    np.testing.assert_allclose(block_means(np.array([[4.0]])), [[4.0]])


@given(st.integers(1, 7), st.randoms(use_true_random=False))
@settings(deadline=None)
def test_groups_are_the_largest_without_a_pair_that_is_apart(count: int, random: object) -> None:
    pairs = [pair for pair in combinations(range(count), 2) if random.random() < 0.4]  # type: ignore[attr-defined]
    apart = np.zeros((count, count), dtype=bool)
    for first, second in pairs:
        apart[first, second] = apart[second, first] = True

    def joined(members: tuple[int, ...]) -> bool:
        return not any(apart[pair] for pair in combinations(members, 2))

    subsets = [subset for size in range(1, count + 1) for subset in combinations(range(count), size) if joined(subset)]
    largest = [subset for subset in subsets if not any(set(subset) < set(other) for other in subsets)]
    assert joined_groups(apart) == sorted(largest)
