"""Which known keypoints may look like the next one: those near its place, the nearest first.

Places are x, y in the image in 1/PLACE_UNIT pixels, so that keypoints of all levels compare.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from codecbench.core.kernels.compiled import compiled

PLACE_UNIT: Final = 16
MAX_CANDIDATES: Final = 16
"""Of one kind; a rank among them is four bits."""


@compiled
def find_candidates(
    places: Any, octave_starts: Any, lowest: int, highest: int, x: int, y: int, radius: int, found: Any
) -> int:
    """Fill `found` with indices of keypoints within `radius` of x, y both ways; returns how many.

    places: (N, 2) int64, by octave and within one by y. octave_starts: (octaves + 1,) where each begins. lowest,
    highest: octaves that are looked at. Ties go to the lower index.
    """
    count = 0
    distances = np.empty(MAX_CANDIDATES, np.int64)
    for octave in range(max(lowest, 0), min(highest, octave_starts.shape[0] - 2) + 1):
        low, high = octave_starts[octave], octave_starts[octave + 1]
        end = high
        while low < high:
            middle = (low + high) >> 1
            if places[middle, 1] < y - radius:
                low = middle + 1
            else:
                high = middle
        for k in range(low, end):
            if places[k, 1] > y + radius:
                break
            dx, dy = abs(places[k, 0] - x), abs(places[k, 1] - y)
            if dx > radius:
                continue
            distance = dx * dx + dy * dy
            if count == MAX_CANDIDATES and distance >= distances[count - 1]:
                continue
            place = min(count, MAX_CANDIDATES - 1)
            while place > 0 and distances[place - 1] > distance:
                distances[place], found[place] = distances[place - 1], found[place - 1]
                place -= 1
            distances[place], found[place] = distance, k
            count = min(count + 1, MAX_CANDIDATES)
    return count
