"""Which known keypoints may look like the next one: those near its place, named by how near they are.

Places are x, y in the image in 1/PLACE_UNIT pixels, so that keypoints of all levels compare.
"""

from __future__ import annotations

from typing import Any, Final

from codecbench.core.kernels.compiled import compiled

PLACE_UNIT: Final = 16
MAX_CANDIDATES: Final = 64
"""Of one kind; what lies behind so many in the order of the arrays is not looked at."""


@compiled
def find_candidates(
    places: Any, octave_starts: Any, firsts: Any, lowest: int, highest: int, x: int, y: int, radius: int,
    found: Any, keys: Any,
) -> int:  # fmt: skip
    """Fill `found` with indices of keypoints within `radius` of x, y both ways; returns how many.

    places: (N, 2) int64, by octave and within one by y. octave_starts: (octaves + 1,) where each begins. firsts:
    (octaves,) where the last search in each began: the next one begins nearby. lowest, highest: octaves that are looked
    at. keys: filled, ascending with distance and then with the index. found, keys: (MAX_CANDIDATES + 1,) int64.
    """
    count = 0
    for octave in range(max(lowest, 0), min(highest, octave_starts.shape[0] - 2) + 1):
        start, end, first = octave_starts[octave], octave_starts[octave + 1], firsts[octave]
        while first < end and places[first, 1] < y - radius:
            first += 1
        while first > start and places[first - 1, 1] >= y - radius:
            first -= 1
        firsts[octave] = first
        for k in range(first, end):
            dx, dy = places[k, 0] - x, places[k, 1] - y
            if dy > radius or count == MAX_CANDIDATES:
                break
            found[count], keys[count] = k, ((dx * dx + dy * dy) << 8) | count
            count += 1 if abs(dx) <= radius else 0  # no branch: what is near cannot be foreseen
    return count


@compiled
def rank_of(candidate: int, keys: Any, count: int) -> int:
    """How many candidates are nearer than this one."""
    rank = 0
    for k in range(count):
        rank += 1 if keys[k] < keys[candidate] else 0
    return rank


@compiled
def candidate_of(rank: int, keys: Any, count: int) -> int:
    """The candidate of a rank; -1 where there is none."""
    for candidate in range(count):
        if rank_of(candidate, keys, count) == rank:
            return candidate
    return -1
