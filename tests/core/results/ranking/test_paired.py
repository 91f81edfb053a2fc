"""Paired tests against scipy's, against brute force, and on samples in which nothing differs."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter
from scipy.stats import ttest_1samp, ttest_ind

from codecbench.core.results.ranking.paired import (
    block_means,
    combined,
    evidence_of_frames,
    evidence_of_repeats,
    holm,
    joined_groups,
    longest_runs,
)


def test_repeats_are_tested_as_scipy_does(rng: np.random.Generator) -> None:
    for count in (2, 5, 40):
        values = rng.normal(0.5, 1.0, count)
        assert evidence_of_repeats(values).p_value == pytest.approx(ttest_1samp(values, 0.0).pvalue, rel=1e-9)


@pytest.mark.parametrize("values", [[0.0] * 5, [0.7], [0.7] * 5])
def test_what_does_not_vary_is_no_evidence(values: list[float]) -> None:
    """A single run, and the same run several times under other seeds that change nothing."""
    assert evidence_of_repeats(np.array(values)).p_value == 1.0
    assert evidence_of_frames(np.array(values)).p_value == 1.0


def drifting(rng: np.random.Generator, trials: int, count: int, correlation: float) -> np.ndarray:
    """(trials, count) values about zero of which neighbours are correlated."""
    steps = rng.normal(size=(trials, count + 300))
    return np.asarray(lfilter([1.0], [1.0, -correlation], steps, axis=1)[:, 300:])


@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.9])
def test_neighbours_that_depend_on_each_other_are_not_counted_twice(correlation: float) -> None:
    """At a level of 1 %, 715 frames without a difference show one in about 1 % of trials, and not in most."""
    rng = np.random.default_rng(5)
    series = drifting(rng, 500, 715, correlation)
    assert np.mean([evidence_of_frames(values).p_value < 0.01 for values in series]) < 0.03
    if correlation > 0.8:
        assert np.mean([evidence_of_repeats(values).p_value < 0.01 for values in series]) > 0.4


def test_frames_still_find_a_difference(rng: np.random.Generator) -> None:
    series = drifting(rng, 100, 715, 0.5) + 0.5  # a quarter of the standard deviation
    assert np.mean([evidence_of_frames(values).p_value < 0.01 for values in series]) > 0.8


def test_sequences_count_alike_however_long_they_are(rng: np.random.Generator) -> None:
    short, long = rng.normal(1.0, 1.0, 5), rng.normal(0.0, 0.1, 500)
    found = combined([evidence_of_repeats(short), evidence_of_repeats(long)])
    welch = ttest_ind(short, -long, equal_var=False)
    assert found.mean == pytest.approx(0.5 * (short.mean() + long.mean()))
    assert found.p_value == pytest.approx(welch.pvalue, rel=1e-9)
    assert found.freedom == pytest.approx(welch.df, rel=1e-9)


def test_where_each_sequence_has_one_run_sequences_are_the_samples(rng: np.random.Generator) -> None:
    means = rng.normal(0.5, 1.0, 6)
    found = combined([evidence_of_repeats(np.array([mean])) for mean in means])
    assert found == evidence_of_repeats(means)


def test_holm_is_the_textbook_s() -> None:
    """Four p-values times 4, 3, 2, 1 in order, and never less than one before."""
    found = holm(np.array([0.01, 0.04, 0.03, 0.005]))
    np.testing.assert_allclose(found, [0.03, 0.06, 0.06, 0.02])
    np.testing.assert_allclose(holm(np.array([0.6, np.nan, 0.7])), [1.0, np.nan, 1.0])


def test_blocks_are_contiguous_and_of_equal_length() -> None:
    np.testing.assert_allclose(block_means(np.arange(16.0), 4), [1.5, 5.5, 9.5, 13.5])
    np.testing.assert_allclose(block_means(np.arange(5.0), 2), [0.5, 3.0])
    np.testing.assert_allclose(block_means(np.array([4.0]), 3), [4.0])


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
