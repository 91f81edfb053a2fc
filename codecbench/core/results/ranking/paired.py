"""Which of several curves differ: paired tests of their differences that do not count neighbouring frames twice."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr

Array = NDArray[np.float64]

_ROUNDING: Final = 1e-12
"""Relative differences up to this are none."""
_MOST_STEPS: Final = 10_000
"""Of the search for groups."""


@dataclass(frozen=True)
class Evidence:
    """A mean difference, the variance of that mean, and the degrees of freedom with which the variance is known."""

    mean: float
    variance: float
    freedom: float

    @property
    def p_value(self) -> float:
        """Two-sided, that there is no difference, by Student's t.

        1 where values do not vary: a single one, or the same run several times, is no evidence.
        """
        if not (self.freedom >= 1 and self.variance > (_ROUNDING * self.mean) ** 2):
            return 1.0
        return float(2.0 * stdtr(self.freedom, -abs(self.mean) / math.sqrt(self.variance)))


def evidence_of_repeats(differences: Array) -> Evidence:
    """What (N,) independent differences say: the paired t-test (Student 1908, doi:10.1093/biomet/6.1.1)."""
    count = len(differences)
    variance = float(np.var(differences, ddof=1)) / count if count > 1 else math.nan
    return Evidence(float(differences.mean()), variance, count - 1)


def evidence_of_frames(differences: Array) -> Evidence:
    """What (N,) differences of neighbours in time say: the same test of the means of blocks.

    Neighbouring frames show the same things, so that single ones are no independent samples. Blocks are as many as
    frames in each (batch means, Kuensch 1989, doi:10.1214/aos/1176347265), and fewer and longer where these still
    depend on their neighbours: by (1 + r) / (1 - r), where r is their correlation (Marriott and Pope 1954,
    doi:10.1093/biomet/41.3-4.390, for its bias).
    """
    first = block_means(differences, math.isqrt(len(differences)))
    return evidence_of_repeats(block_means(differences, max(2, int(len(first) / _time_constant(first)))))


def combined(found: Sequence[Evidence]) -> Evidence:
    """The mean over sequences, each of the same weight (Welch 1947, doi:10.1093/biomet/34.1-2.28).

    Where a sequence has a single value, sequences are the samples.
    """
    if len(found) == 1:
        return found[0]
    if any(math.isnan(each.variance) for each in found):
        return evidence_of_repeats(np.array([each.mean for each in found]))
    variances = np.array([each.variance for each in found]) / len(found) ** 2
    total = float(variances.sum())
    spread = float(np.sum(variances**2 / np.array([each.freedom for each in found])))
    return Evidence(float(np.mean([each.mean for each in found])), total, total**2 / spread if spread else 0.0)


def block_means(values: Array, count: int) -> Array:
    """(B,) means of `count` contiguous blocks of (N,) values, of lengths as equal as can be; at most N."""
    edges = np.linspace(0, len(values), max(1, min(count, len(values))) + 1).round().astype(int)
    return np.asarray(np.add.reduceat(values, edges[:-1]) / np.diff(edges))


def _time_constant(values: Array) -> float:
    """How many values are worth one independent one, from the correlation of neighbours; at least 1."""
    centred = values - values.mean()
    power = float(centred @ centred)
    if len(values) < 3 or power == 0.0:
        return 1.0
    found = float(centred[1:] @ centred[:-1]) / power
    correlation = min(max(found + (1.0 + 4.0 * found) / len(values), 0.0), 0.99)
    return (1.0 + correlation) / (1.0 - correlation)


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
