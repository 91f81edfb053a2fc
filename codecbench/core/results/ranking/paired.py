"""Which of several curves differ, by paired tests that assume no distribution and do not count neighbours twice."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

RESAMPLES: Final = 99_999
"""Sign patterns that are drawn where there are too many to go through all."""


def block_means(values: Array) -> Array:
    """(..., B) means of contiguous blocks of (..., N) values, as many blocks as values in each: B^2 is about N.

    Neighbouring frames show the same things, so that single ones are no independent samples; blocks that grow with the
    root of the length become independent as it grows (Kuensch 1989, doi:10.1214/aos/1176347265).
    """
    count = values.shape[-1]
    edges = np.linspace(0, count, max(1, math.isqrt(count)) + 1).round().astype(int)
    return np.stack([values[..., low:high].mean(axis=-1) for low, high in pairwise(edges)], axis=-1)


def sign_flip_p(differences: Array) -> Array:
    """(P,) two-sided p-values of (P, N) paired differences, under which each is as likely with the other sign.

    Fisher's randomisation test (The Design of Experiments, 1935, section 21) of the sum: exact where there are fewer
    than RESAMPLES patterns of signs, and else by so many seeded ones, the observed among them.
    """
    count = differences.shape[1]
    if 2**count <= RESAMPLES:
        signs = 1.0 - 2.0 * ((np.arange(2**count)[:, None] >> np.arange(count)) & 1)
    else:
        signs = np.random.default_rng(0).choice([-1.0, 1.0], (RESAMPLES, count))
        signs = np.vstack([np.ones(count), signs])
    found = []
    for row in differences:
        observed = abs(row.sum())
        slack = 1e-9 * np.abs(row).sum()  # equal sums that rounding tells apart
        found.append(float(np.mean(np.abs(signs @ row) >= observed - slack)))
    return np.array(found)


def least_units(tests: int, level: float) -> int:
    """How many differences it takes for one of so many tests to be significant at a level, if all have one sign."""
    return 1 + math.ceil(math.log2(max(1, tests) / level) + 1e-12)


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

    apart: (N, N), symmetric. Maximal cliques of the complement, by Bron and Kerbosch 1973, doi:10.1145/362342.362367.
    """
    near = ~apart
    found: list[tuple[int, ...]] = []

    def extend(members: tuple[int, ...], candidates: list[int], done: list[int]) -> None:
        if not candidates and not done:
            found.append(members)
        for place, candidate in enumerate(candidates):
            rest = [other for other in candidates[place + 1 :] if near[candidate, other]]
            before = [other for other in done + candidates[:place] if near[candidate, other]]
            extend((*members, candidate), rest, before)

    extend((), list(range(len(apart))), [])
    return sorted(found)
