"""Chroma planes enlarged to the size of the image the way libjpeg does, which all but defines how a JPEG looks."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from codecbench.core.counting.kernel import kernel
from codecbench.core.counting.trace import Run
from codecbench.plugins.codecs.dct.color import double

_NARROWEST_SMOOTHED = 3
"""Planes of one or two samples across are repeated, not interpolated."""


def enlarged(plane: NDArray[np.uint8], h: int, v: int, shape: tuple[int, int], run: Run) -> NDArray[np.uint8]:
    """The plane, of which every sample covers h x v pixels, at `shape` (height, width) of the image.

    (h, v) is (1, 1), (2, 1) or (2, 2).
    """
    if h == v == 1:
        return plane
    large = np.empty(shape, np.uint8)
    if plane.shape[1] < _NARROWEST_SMOOTHED:
        run(repeat, plane, h, v, large)
    else:
        run(double if v == 2 else widen, plane, large)
    return large


@kernel
def repeat(plane: Any, h: Any, v: Any, large: Any) -> None:
    """Every sample h times across and v times down, as far as `large` goes."""
    for row in range(large.shape[0]):
        for column in range(large.shape[1]):
            large[row, column] = plane[row // v, column // h]


@kernel
def widen(plane: Any, large: Any) -> None:
    """Twice as wide: 3:1 means of the nearest two samples, rounded halves down on even columns and up on odd ones.

    plane: (H, ceil W/2) uint8. large: (H, W) uint8, filled.
    """
    last = plane.shape[1] - 1
    for row in range(large.shape[0]):
        for column in range(large.shape[1]):
            odd = column & 1
            near = column >> 1
            far = min(max(near - 1 + 2 * odd, 0), last)
            large[row, column] = np.uint8((3 * np.int32(plane[row, near]) + np.int32(plane[row, far]) + 1 + odd) >> 2)
