"""Several parameters: within the budget, the same way each time, and to the answer."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from codecbench.core.rounds.searching import Score, sampling

pytest.importorskip("optuna")


def sample(lengths: tuple[int, ...], budget: int, score: Callable[[int], Score], seed: int = 0) -> list[int]:
    questions, asked = sampling(lengths, budget, seed), []
    try:
        places = next(questions)
        while True:
            asked += places
            places = questions.send({place: score(place) for place in places})
    except StopIteration:
        return asked


def far(place: int) -> Score:
    """Least at (7, 12) of 20 x 20."""
    return Score(abs(place // 20 - 7) + abs(place % 20 - 12) + 0.5, 0.0)


def test_the_same_answers_lead_the_same_way() -> None:
    asked = sample((20, 20), 40, far)
    assert asked == sample((20, 20), 40, far)
    assert asked != sample((20, 20), 40, far, seed=1)
    assert len(asked) == len(set(asked)) == 40
    assert all(0 <= place < 400 for place in asked)


def test_it_comes_nearer_than_chance_would() -> None:
    best = [min(far(place).cost for place in sample((20, 20), 60, far, seed)) for seed in range(5)]
    assert sorted(best)[2] <= 2.5


def test_a_small_space_is_tried_as_a_whole_and_no_more() -> None:
    asked = sample((2, 3), 50, far)
    assert sorted(asked) == list(range(6))


def test_it_ends_where_nothing_can_be_better() -> None:
    assert len(sample((20, 20), 100, lambda place: Score(0.0, 0.0))) == 4


def test_settings_without_a_value_are_passed_over() -> None:
    asked = sample((10, 10), 30, lambda place: Score(float("inf") if place % 2 else 1.0 + place, 0.0))
    assert len(asked) == 30
