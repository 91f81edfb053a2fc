"""FAST corners and their scores for whole images, without branches so that the compiler vectorizes them.

Source: Rosten, Porter, Drummond, "Faster and Better", IEEE T-PAMI 32(1), 2010, doi:10.1109/TPAMI.2008.275. A pixel is a
corner at threshold t if nine pixels in a row, of the sixteen on the circle of radius three, are all brighter than it by
more than t, or all darker. Its score is the greatest such t, plus one.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numba.cpython.unsafe import numbers as bits

from codecbench.core.kernels.compiled import compiled

SUBPIXELS: Final = 4
"""Parts of a pixel, each way, to which corners are located."""

_RADIUS = 3
_BLOCK = 32  # pixels of 8 bits that a vector holds, or a divisor of it
_trailing_zeros: Any = bits.trailing_zeros


@compiled
def spans(first: int, last: int) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return two spans of pixels, start and end, that cover first..last - 1 in whole blocks.

    The second overlaps the first. If there is no whole block, or no rest, the first span covers everything.
    """
    whole = first + (last - first) // _BLOCK * _BLOCK
    if whole in (first, last):
        return (first, last), (last, last)
    return (first, whole), (last - _BLOCK, last)


@compiled
def _bright_runs(a: Any, b: Any, c: Any, d: Any, e: Any, f: Any, g: Any, h: Any, before: Any, after: Any) -> Any:
    """Return the greater minimum of the two runs of nine that share the eight pixels a..h."""
    return min(min(min(min(a, b), min(c, d)), min(min(e, f), min(g, h))), max(before, after))


@compiled
def _dark_runs(a: Any, b: Any, c: Any, d: Any, e: Any, f: Any, g: Any, h: Any, before: Any, after: Any) -> Any:
    """Return the smaller maximum of the two runs of nine that share the eight pixels a..h."""
    return max(max(max(max(a, b), max(c, d)), max(max(e, f), max(g, h))), min(before, after))


@compiled
def score_corners(level: Any, scores: Any) -> None:
    """Fill `scores` (height, width), uint8, with the FAST scores of `level`; 0 within three pixels of the border."""
    height, width = level.shape
    scores[:] = 0
    if width <= 2 * _RADIUS:
        return
    both = spans(_RADIUS, width - _RADIUS)
    for y in range(_RADIUS, height - _RADIUS):
        u3, u2, u1, row = level[y - 3], level[y - 2], level[y - 1], level[y]
        d1, d2, d3, out = level[y + 1], level[y + 2], level[y + 3], scores[y]
        for start, end in both:
            _score_span(u3, u2, u1, row, d1, d2, d3, out, start, end)


@compiled(inline="always")
def _score_span(u3: Any, u2: Any, u1: Any, row: Any, d1: Any, d2: Any, d3: Any, out: Any, start: int, end: int) -> None:
    """Fill `out` from `start` to `end` with the scores of `row`, given three rows above and three below.

    Unsigned indices cannot mean the end of a row, so the loop becomes vector code.
    """
    for x in range(np.uint64(start), np.uint64(end)):
        l1, l2, l3 = x - np.uint64(1), x - np.uint64(2), x - np.uint64(3)
        r1, r2, r3 = x + np.uint64(1), x + np.uint64(2), x + np.uint64(3)
        c = row[x]
        p0, p1, p2, p3, p4, p5, p6, p7 = u3[x], u3[r1], u2[r2], u1[r3], row[r3], d1[r3], d2[r2], d3[r1]
        p8, p9, pa, pb, pc, pd, pe, pf = d3[x], d3[l1], d2[l2], d1[l3], row[l3], u1[l3], u2[l2], u3[l1]
        bright = max(
            max(
                max(
                    _bright_runs(p1, p2, p3, p4, p5, p6, p7, p8, p0, p9),
                    _bright_runs(p3, p4, p5, p6, p7, p8, p9, pa, p2, pb),
                ),
                max(
                    _bright_runs(p5, p6, p7, p8, p9, pa, pb, pc, p4, pd),
                    _bright_runs(p7, p8, p9, pa, pb, pc, pd, pe, p6, pf),
                ),
            ),
            max(
                max(
                    _bright_runs(p9, pa, pb, pc, pd, pe, pf, p0, p8, p1),
                    _bright_runs(pb, pc, pd, pe, pf, p0, p1, p2, pa, p3),
                ),
                max(
                    _bright_runs(pd, pe, pf, p0, p1, p2, p3, p4, pc, p5),
                    _bright_runs(pf, p0, p1, p2, p3, p4, p5, p6, pe, p7),
                ),
            ),
        )
        dark = min(
            min(
                min(
                    _dark_runs(p1, p2, p3, p4, p5, p6, p7, p8, p0, p9),
                    _dark_runs(p3, p4, p5, p6, p7, p8, p9, pa, p2, pb),
                ),
                min(
                    _dark_runs(p5, p6, p7, p8, p9, pa, pb, pc, p4, pd),
                    _dark_runs(p7, p8, p9, pa, pb, pc, pd, pe, p6, pf),
                ),
            ),
            min(
                min(
                    _dark_runs(p9, pa, pb, pc, pd, pe, pf, p0, p8, p1),
                    _dark_runs(pb, pc, pd, pe, pf, p0, p1, p2, pa, p3),
                ),
                min(
                    _dark_runs(pd, pe, pf, p0, p1, p2, p3, p4, pc, p5),
                    _dark_runs(pf, p0, p1, p2, p3, p4, p5, p6, pe, p7),
                ),
            ),
        )
        out[x] = max(np.uint8(max(bright, c) - c), np.uint8(c - min(dark, c)))


@compiled
def list_corners(scores: Any, threshold: int) -> Any:
    """Return the corners x, y (N, 2) at a threshold, by row, and their scores (N,).

    A corner scores higher than its eight neighbors.
    """
    height, width = scores.shape
    if width <= 2 * _RADIUS:
        return np.empty((0, 2), np.int64), np.empty(0, np.uint8)
    corners = np.empty((height * width // 4 + 1, 2), np.int64)
    corner_scores = np.empty(len(corners), np.uint8)
    peaks = np.zeros((width + 7) // 8 * 8, np.uint8)
    words = peaks.view(np.uint64)
    count, both = 0, spans(_RADIUS, width - _RADIUS)
    for y in range(_RADIUS, height - _RADIUS):
        above, row, below = scores[y - 1], scores[y], scores[y + 1]
        for start, end in both:
            _keep_peaks(above, row, below, threshold, peaks, start, end)
        count = _list_peaks(words, y, corners, corner_scores, count)
    return corners[:count].copy(), corner_scores[:count].copy()


@compiled
def refine_corner(scores: Any, x: int, y: int, offset: Any) -> None:
    """Fill `offset` (2,) x, y, level pixels, with the place in its pixel where a corner's score is greatest.

    This is the maximum of the least-squares quadric through the scores of nine pixels. It is rounded to the middle of
    one of SUBPIXELS parts of the pixel each way, so that it can be sent in few bits. A maximum outside the pixel is
    moved to the nearest part. Without a maximum, the middle of the pixel is taken.
    """
    up, here, down = scores[y - 1], scores[y], scores[y + 1]
    a, b, c = np.int64(up[x - 1]), np.int64(up[x]), np.int64(up[x + 1])
    d, e, f = np.int64(here[x - 1]), np.int64(here[x]), np.int64(here[x + 1])
    g, h, i = np.int64(down[x - 1]), np.int64(down[x]), np.int64(down[x + 1])
    dx, dy = (c + f + i - a - d - g) / 6.0, (g + h + i - a - b - c) / 6.0
    dxx = (a + d + g + c + f + i - 2 * (b + e + h)) / 3.0
    dyy = (a + b + c + g + h + i - 2 * (d + e + f)) / 3.0
    dxy = (a + i - c - g) / 4.0
    determinant = dxx * dyy - dxy * dxy
    offset[0], offset[1] = 0.0, 0.0
    if determinant > 0.0 and dxx < 0.0:
        offset[0], offset[1] = (dxy * dy - dyy * dx) / determinant, (dxy * dx - dxx * dy) / determinant
    for k in range(2):
        part = min(max(math.floor((offset[k] + 0.5) * SUBPIXELS), 0), SUBPIXELS - 1)
        offset[k] = (part + 0.5) / SUBPIXELS - 0.5


@compiled(inline="always")
def _keep_peaks(above: Any, row: Any, below: Any, threshold: int, peaks: Any, start: int, end: int) -> None:
    """Fill `peaks` from `start` to `end` with the scores of `row` that are peaks, 0 elsewhere.

    A peak exceeds the threshold and all eight neighbors.
    """
    limit = np.uint8(threshold)
    for x in range(np.uint64(start), np.uint64(end)):
        before, after = x - np.uint64(1), x + np.uint64(1)
        rival = max(
            max(max(above[before], above[x]), max(above[after], row[before])),
            max(max(row[after], below[before]), max(below[x], below[after])),
        )
        peaks[x] = row[x] if row[x] > max(rival, limit) else np.uint8(0)


@compiled(inline="always")
def _list_peaks(words: Any, y: int, corners: Any, corner_scores: Any, count: int) -> int:
    """Append the pixels of a row that are not 0 to `corners`, eight pixels a word; returns the new count."""
    for k in range(len(words)):
        word = words[k]
        while word != np.uint64(0):
            shift = np.uint64(_trailing_zeros(word)) & np.uint64(56)
            corners[count, 0], corners[count, 1] = 8 * k + np.int64(shift >> np.uint64(3)), y
            corner_scores[count] = np.uint8(word >> shift)
            word &= ~(np.uint64(255) << shift)
            count += 1
    return count
