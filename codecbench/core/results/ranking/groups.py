"""Which of many pairs differ: tests corrected for their number, and groups of which no two members are told apart."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_MOST_STEPS: Final = 10_000
"""Of the search for groups."""


def holm(p_values: Array) -> Array:
    """(P,) p-values adjusted so that all that are below a level are true together with that confidence.

    Holm 1979, Scandinavian Journal of Statistics 6(2), 65-70. A NaN, where nothing was tested, stays one.
    """
    adjusted = np.full(len(p_values), np.nan)
    tested = np.flatnonzero(~np.isnan(p_values))
    order = tested[np.argsort(p_values[tested], kind="stable")]
    factors = np.arange(len(order), 0, -1)
    adjusted[order] = np.minimum(1.0, np.maximum.accumulate(p_values[order] * factors))
    return adjusted


def joined_groups(apart: NDArray[np.bool_]) -> list[tuple[int, ...]]:
    """The largest groups of which no two members are told apart, in order; everybody is in one or more.

    apart: (N, N), symmetric, in order of place. Maximal cliques of the complement, by Bron and Kerbosch 1973,
    doi:10.1145/362342.362367, with a pivot. There can be more of them than anybody could list: then the longest runs of
    neighbours in order, which are at most N.
    """
    near = [set(np.flatnonzero(~row).tolist()) - {place} for place, row in enumerate(apart)]
    found: list[tuple[int, ...]] = []
    waiting: list[tuple[tuple[int, ...], set[int], set[int]]] = [((), set(range(len(near))), set())]
    for _ in range(_MOST_STEPS):
        if not waiting:
            return sorted(found)
        members, candidates, done = waiting.pop()
        if not candidates and not done and members:
            found.append(tuple(sorted(members)))
        if not candidates:
            continue
        pivot = max(sorted(candidates | done), key=lambda place: len(near[place]))
        for place in sorted(candidates - near[pivot]):
            waiting.append(((*members, place), candidates & near[place], done & near[place]))
            candidates.remove(place)
            done.add(place)
    return longest_runs(apart)


def longest_runs(apart: NDArray[np.bool_]) -> list[tuple[int, ...]]:
    """The longest runs of neighbours in order of which no two are told apart."""
    found: list[tuple[int, ...]] = []
    start = 0
    for end in range(len(apart)):
        first = start
        while apart[first : end + 1, end].any():
            first += 1
        if first > start:
            found.append(tuple(range(start, end)))
            start = first
    return [*found, tuple(range(start, len(apart)))]
