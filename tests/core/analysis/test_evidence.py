"""Tests of means against scipy's, and on series whose dependence, and whose standard error, is known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import ttest_1samp, ttest_ind

from codecbench.core.analysis.evidence import (
    combine,
    evidence_of_frames,
    evidence_of_repeats,
)


def test_repeats_are_tested_as_scipy_does(rng: np.random.Generator) -> None:
    for count in (2, 5, 40):
        values = rng.normal(0.5, 1.0, count)
        assert evidence_of_repeats(values).p_value == pytest.approx(ttest_1samp(values, 0.0).pvalue, rel=1e-9)


@pytest.mark.parametrize("values", [[0.0] * 5, [0.7], [0.7] * 5])
def test_what_does_not_vary_is_no_evidence(values: list[float]) -> None:
    """A single run, and the same run several times under other seeds that change nothing."""
    assert evidence_of_repeats(np.array(values)).p_value == 1.0
    assert evidence_of_frames(np.array(values)).p_value == 1.0, "so few frames say nothing"


def test_many_frames_that_differ_by_the_same_are_evidence() -> None:
    same = evidence_of_frames(np.full(8, 0.7))
    assert (same.mean, same.p_value) == (pytest.approx(0.7), 0.0)
    assert evidence_of_frames(np.zeros(8)).p_value == 1.0
    assert combine([same, same]).p_value == 0.0


def drifting(rng: np.random.Generator, trials: int, count: int, correlation: float) -> np.ndarray:
    """(trials, count) values about zero of which neighbours are correlated."""
    steps = rng.normal(size=(trials, count + 300))
    return np.asarray(lfilter([1.0], [1.0, -correlation], steps, axis=1)[:, 300:])


@pytest.mark.parametrize("correlation", [*(pytest.param(r, marks=pytest.mark.thorough) for r in (0.0, 0.5)), 0.9])
def test_neighbours_that_depend_on_each_other_are_not_counted_twice(correlation: float) -> None:
    """At a level of 1 %, 715 frames without a difference show one in about 1 % of trials, and not in most."""
    rng = np.random.default_rng(5)
    series = drifting(rng, 500, 715, correlation)
    assert np.mean([evidence_of_frames(values).p_value < 0.01 for values in series]) < 0.03
    if correlation > 0.8:
        assert np.mean([evidence_of_repeats(values).p_value < 0.01 for values in series]) > 0.4


@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.9])
@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_the_variance_of_a_mean_is_that_of_the_process(correlation: float, noise: float) -> None:
    """Of an autoregressive process (1 + r) / (1 - r) times that of independent values, plus that of the noise."""
    rng = np.random.default_rng(6)
    known = (1.0 + correlation) / (1.0 - correlation) + noise**2
    found = []
    for _ in range(100):
        series = drifting(rng, 6, 400, correlation) * np.sqrt(1.0 - correlation**2) + noise * rng.normal(size=(6, 400))
        evidence = evidence_of_frames(series[0], series[1:])
        found.append(400 * evidence.variance)
        assert (
            evidence.worth == pytest.approx(series[0].var(ddof=1) / evidence.variance, rel=0.01)
            or evidence.worth == 400
        )
    assert np.median(found) == pytest.approx(known, rel=0.35)


def test_what_the_settings_have_in_common_makes_each_surer(rng: np.random.Generator) -> None:
    """With three repeats one series has two degrees of freedom; ten of the same scatter have more."""
    series = rng.normal(0.0, 1.0, (10, 3))
    assert evidence_of_repeats(series[0], series[1:]).freedom > 3
    assert evidence_of_repeats(np.array([0.0, 0.1, 0.2])).freedom == 2
    assert evidence_of_repeats(series[0], np.array([series[0]] * 9)).freedom == pytest.approx(2.0), "copies say nothing"


def test_three_shots_count_as_about_three_frames(rng: np.random.Generator) -> None:
    """Each with an offset of its own, ten times as large as what changes from frame to frame."""
    offsets = np.repeat(rng.normal(size=(7, 3)), 30, axis=1)
    series = offsets + 0.1 * rng.normal(size=(7, 90))
    evidence = evidence_of_frames(series[0], series[1:])
    assert evidence.worth < 6
    assert evidence_of_frames(rng.normal(size=90), rng.normal(size=(6, 90))).worth > 45


def test_frames_still_find_a_difference(rng: np.random.Generator) -> None:
    series = drifting(rng, 100, 715, 0.5) + 0.5  # a quarter of the standard deviation
    assert np.mean([evidence_of_frames(values).p_value < 0.01 for values in series]) > 0.8


def test_sequences_count_alike_however_long_they_are(rng: np.random.Generator) -> None:
    short, long = rng.normal(1.0, 1.0, 5), rng.normal(0.0, 0.1, 500)
    found = combine([evidence_of_repeats(short), evidence_of_repeats(long)])
    welch = ttest_ind(short, -long, equal_var=False)
    assert found.mean == pytest.approx(0.5 * (short.mean() + long.mean()))
    assert found.p_value == pytest.approx(welch.pvalue, rel=1e-9)
    assert found.freedom == pytest.approx(welch.df, rel=1e-9)


def test_where_each_sequence_has_one_run_sequences_are_the_samples(rng: np.random.Generator) -> None:
    means = rng.normal(0.5, 1.0, 6)
    found = combine([evidence_of_repeats(np.array([mean])) for mean in means])
    assert found == evidence_of_repeats(means)


@pytest.mark.parametrize(("correlation", "least"), [(0.0, 0.92), (0.5, 0.91), (0.8, 0.87)])
def test_the_interval_of_one_mean_covers_it_and_varies_little(
    correlation: float, least: float, rng: np.random.Generator
) -> None:
    noise = rng.normal(size=(400, 450))
    series = lfilter([1.0], [1.0, -correlation], noise, axis=1)[:, 300:]
    found = [evidence_of_frames(values, halved=False) for values in series]
    reach = np.array([evidence.reach(0.95) for evidence in found])
    covered = np.mean([abs(evidence.mean) <= own for evidence, own in zip(found, reach, strict=True)])
    assert least <= covered <= 0.98
    assert np.std(np.log(reach)) < 0.35
