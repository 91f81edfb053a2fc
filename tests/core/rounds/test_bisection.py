"""Bisection finds where a side changes, with about as many questions as the length has binary digits."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from codecbench.core.rounds.searching import BisectionResult, Side, bisection


def ask(length: int, side: Callable[[int], Side], budget: int = 1000) -> tuple[BisectionResult, list[int]]:
    questions, asked = bisection(length, budget), []
    try:
        places = next(questions)
        while True:
            asked += places
            places = questions.send({place: side(place) for place in places})
    except StopIteration as ended:
        return ended.value, asked


@pytest.mark.parametrize("length", [2, 3, 4, 17, 100, 1000])
def test_every_place_of_the_change_is_found(length: int) -> None:
    for change in range(1, length):
        for rising in (1, -1):
            ended, asked = ask(length, lambda place, c=change, r=rising: r if place >= c else -r)  # type: ignore
            assert (ended.outcome, ended.low, ended.high) == ("crossed", change - 1, change)
            assert len(asked) == len(set(asked)) <= 2 + math.ceil(math.log2(length))


def test_what_is_sought_ends_it_where_it_is_met() -> None:
    ended, asked = ask(101, lambda place: 0 if place == 50 else (1 if place > 50 else -1))
    assert (ended.outcome, asked) == ("hit", [0, 100, 50])
    assert ask(101, lambda place: 0 if place == 100 else -1)[1] == [0, 100]


def test_ends_on_one_side_are_asked_about_their_middle() -> None:
    ended, asked = ask(101, lambda place: 1)
    assert (ended.outcome, asked) == ("one side", [0, 100, 50])
    ended, asked = ask(101, lambda place: 1 if 30 <= place <= 70 else -1)
    assert (ended.outcome, ended.low, ended.high) == ("crossed", 29, 30)
    assert ask(2, lambda place: 1)[0].outcome == "one side"


def test_no_more_is_asked_than_may_be() -> None:
    for budget in range(1, 12):
        ended, asked = ask(1000, lambda place: 1 if place >= 321 else -1, budget)
        assert len(asked) <= budget
        assert ended.outcome == ("spent" if budget < 12 else "crossed")
        assert ended.low < 321 <= ended.high or budget < 3
