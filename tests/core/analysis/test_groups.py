"""Corrected p-values against a textbook's, groups against brute force."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codecbench.core.analysis.ranking import holm, joined_groups, longest_runs


def test_holm_is_the_textbook_s() -> None:
    """Four p-values times 4, 3, 2, 1 in order, and never less than one before."""
    found = holm(np.array([0.01, 0.04, 0.03, 0.005]))
    np.testing.assert_allclose(found, [0.03, 0.06, 0.06, 0.02])
    np.testing.assert_allclose(holm(np.array([0.6, np.nan, 0.7])), [1.0, np.nan, 1.0])


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


def test_groups_beyond_number_are_runs_and_many_codecs_take_no_time() -> None:
    assert joined_groups(np.zeros((300, 300), dtype=bool)) == [tuple(range(300))]
    apart = np.kron(np.eye(40, dtype=bool), np.ones((3, 3), dtype=bool)) & ~np.eye(120, dtype=bool)
    assert joined_groups(apart) == longest_runs(apart), "3 to the power of 40 groups"


@pytest.mark.parametrize("density", [0.0, 0.1, 0.4, 1.0])
def test_runs_are_the_longest_without_two_told_apart(density: float, rng: np.random.Generator) -> None:
    for count in (1, 2, 6, 9):
        apart = np.triu(rng.random((count, count)) < density, 1)
        apart |= apart.T
        runs = [
            tuple(range(first, end + 1))
            for first in range(count)
            for end in range(first, count)
            if not apart[first : end + 1, first : end + 1].any()
        ]
        assert longest_runs(apart) == [run for run in runs if not any(set(run) < set(other) for other in runs)]
