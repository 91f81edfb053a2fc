"""A verdict that is looked at after every run is wrong as rarely as it says, and agrees with that of the limits."""

from __future__ import annotations

import numpy as np
import pytest

from codecbench.core.analysis.passing import Standing
from codecbench.core.rounds.trials import runs_to_make, stands, verdict


def test_the_fewest_runs_that_stand_are_eight_alike() -> None:
    assert not stands(7, 7)
    assert stands(8, 8)
    assert stands(0, 8)
    assert runs_to_make(0, 0, 100) == 8
    assert runs_to_make(0, 0, 5) == 5
    assert verdict(8, 8, 100) == "passes"
    assert verdict(0, 8, 100) == "fails"
    assert verdict(7, 8, 100) == "inconclusive"


def test_the_interval_says_the_same_wherever_the_verdict_stands() -> None:
    for runs in (*range(1, 50), 100, 300):
        for successes in range(runs + 1):
            if stands(successes, runs):
                assert Standing("", 0.0, successes, runs).verdict == verdict(successes, runs, 1000)


def test_the_last_run_decides_by_the_interval() -> None:
    assert verdict(5, 5, 5) == "passes"
    assert verdict(5, 5, 6) == "inconclusive"
    assert verdict(3, 3, 3) == "inconclusive"
    assert verdict(0, 0, 0) == "inconclusive"


def test_runs_are_added_until_they_could_tell_and_never_beyond_the_most() -> None:
    for most in (1, 4, 9, 40):
        for runs in range(most):
            for successes in range(runs + 1):
                found = runs_to_make(successes, runs, most)
                assert runs < found <= most
                if found < most:
                    gained = (found - runs) * (2 * successes >= runs)
                    assert stands(successes + gained, found)


def decided(rate: float, most: int, rng: np.random.Generator) -> tuple[str, int]:
    """What a sequence of runs comes to, and how many that took."""
    outcomes, count = rng.random(most) < rate, runs_to_make(0, 0, most)
    while (said := verdict(int(outcomes[:count].sum()), count, most)) == "inconclusive" and count < most:
        count = runs_to_make(int(outcomes[:count].sum()), count, most)
    return said, count


@pytest.mark.parametrize(("rate", "most"), [(0.5, 20), pytest.param(0.5, 100, marks=pytest.mark.thorough)])
def test_a_coin_is_seldom_said_to_hold_or_to_fail(rate: float, most: int, rng: np.random.Generator) -> None:
    said = [decided(rate, most, rng)[0] for _ in range(2000)]
    wrong = sum(verdict != "inconclusive" for verdict in said) / len(said)
    assert 0.01 < wrong < 0.10, "at most a twentieth early, and a twentieth in the end"


def test_clear_rates_are_decided_early(rng: np.random.Generator) -> None:
    for rate, expected in ((0.95, "passes"), (0.05, "fails")):
        said = [decided(rate, 40, rng) for _ in range(500)]
        assert sum(verdict == expected for verdict, _ in said) > 495
        assert np.mean([count for _, count in said]) < 11
