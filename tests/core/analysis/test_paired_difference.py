"""Paired differences of series whose dependence, and whose standard error, is known in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from codecbench.core.analysis.evidence import PairedDifference, paired_difference


def autoregressive(rng: np.random.Generator, count: int, memory: float) -> np.ndarray:
    """Values of variance 1 / (1 - memory^2) of which each keeps a share of the one before."""
    series = np.zeros(count + 100)
    for index, shock in enumerate(rng.normal(size=count + 100)[1:], start=1):
        series[index] = memory * series[index - 1] + shock
    return series[100:]


def against_nothing(series: np.ndarray) -> PairedDifference:
    return paired_difference(series, np.zeros_like(series))


@pytest.mark.parametrize("memory", [0.0, 0.5, 0.8])
def test_the_standard_error_is_that_of_the_process(rng: np.random.Generator, memory: float) -> None:
    found = np.mean([against_nothing(autoregressive(rng, 1000, memory)).standard_error for _ in range(30)])
    assert found == pytest.approx(1.0 / (1.0 - memory) / np.sqrt(1000), rel=0.12)


@pytest.mark.thorough
def test_a_difference_that_is_not_there_is_seldom_found(rng: np.random.Generator) -> None:
    for memory, most in ((0.0, 0.08), (0.5, 0.11)):
        chances = [against_nothing(autoregressive(rng, 400, memory)).p_value for _ in range(400)]
        assert np.mean(np.array(chances) < 0.05) < most
        assert np.mean(np.array(chances) < 0.01) < 0.04


def test_a_difference_that_can_be_shown_is_found_in_four_of_five_cases(rng: np.random.Generator) -> None:
    error = 1.0 / np.sqrt(200)
    size = np.mean([against_nothing(rng.normal(size=200)).detectable for _ in range(200)])
    assert size == pytest.approx(3.2 * error, rel=0.15), "2.8 where the standard error is known"
    found = [against_nothing(rng.normal(size, 1.0, 200)).p_value < 0.05 for _ in range(400)]
    assert 0.7 < np.mean(found) < 0.9


def test_equal_series_differ_in_nothing(rng: np.random.Generator) -> None:
    series = rng.normal(size=100)
    same = paired_difference(series, series.copy())
    assert (same.mean, same.p_value, same.detectable, same.frames, same.missing) == (0.0, 1.0, 0.0, 100, 0)


def test_what_both_share_takes_no_part(rng: np.random.Generator) -> None:
    scene, wobble = 100.0 * autoregressive(rng, 200, 0.9), rng.normal(size=200)
    found = paired_difference(scene + 1.0 + 0.1 * wobble, scene)
    assert found.mean == pytest.approx(1.0, abs=0.05)
    assert found.p_value < 1e-6
    assert found.interval[0] < 1.0 < found.interval[1]
    swapped = paired_difference(scene, scene + 1.0 + 0.1 * wobble)
    assert (swapped.mean, swapped.p_value) == (pytest.approx(-found.mean), pytest.approx(found.p_value))


def test_frames_that_one_lacks_are_counted_and_take_no_part(rng: np.random.Generator) -> None:
    first, second = rng.normal(size=50), rng.normal(size=50)
    first[:4], second[2:7] = np.nan, np.inf
    found = paired_difference(first, second)
    assert (found.frames, found.missing) == (43, 5)
    assert found.mean == pytest.approx(np.mean(first[7:] - second[7:]))


def test_too_few_frames_say_nothing() -> None:
    found = paired_difference(np.arange(7.0), np.zeros(7))
    assert np.isnan([found.mean, found.standard_error, *found.interval, found.p_value, found.detectable]).all()
    assert found.frames == 7
    with pytest.raises(ValueError, match=r"one length.*\(7,\).*\(8,\)"):
        paired_difference(np.zeros(7), np.zeros(8))
