"""Bisection over the places of an ordered parameter, as questions and answers."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from typing import Literal

Side = Literal[-1, 0, 1]
"""Of a place: which side of what is sought it is on; 0 where it is that."""


@dataclass(frozen=True)
class Bisected:
    """How a bisection ended. low, high: the places between which it did.

    crossed: low and high are neighbours on different sides. hit: one of the places tried is what is sought. one side:
    both ends are on the same, and so is their middle. spent: no further place may be tried.
    """

    outcome: Literal["crossed", "hit", "one side", "spent"]
    low: int
    high: int


def bisection(length: int, budget: int) -> Generator[list[int], dict[int, Side], Bisected]:
    """Yields places, of `length`, and is sent the side of each; tries at most `budget`.

    Where both ends are on one side, their middle is tried as well: a parameter that does not act in one direction may
    yet show there.
    """
    low, high = 0, length - 1
    sides = yield [low, high][:budget]
    if budget < 2:
        return Bisected("hit" if 0 in sides.values() else "spent", low, high)
    if sides[low] == sides[high] != 0:
        if length == 2 or budget == 2:
            return Bisected("one side" if length == 2 else "spent", low, high)
        middle = length // 2
        sides |= yield [middle]
        if sides[middle] == sides[low]:
            return Bisected("one side", low, high)
        high = middle
    while 0 not in sides.values() and high - low > 1:
        if len(sides) >= budget:
            return Bisected("spent", low, high)
        middle = (low + high) // 2
        sides |= yield [middle]
        low, high = (middle, high) if sides[middle] == sides[low] else (low, middle)
    return Bisected("hit" if 0 in sides.values() else "crossed", low, high)
