"""Renders the exposure of a frame: sub-frames while the shutter is open, each row at its own time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.sequence import Camera
from codecbench.core.kernels.compiled import compiled
from codecbench.plugins.datasets.synthetic.render import (
    LANE,
    TEXEL_WEIGHT,
    candidate_rows,
    cover,
    plane_equations,
    texel,
    texture_level,
)
from codecbench.plugins.datasets.synthetic.scene import Atlas

Floats = NDArray[np.float64]
Pose = Callable[[float], Floats]

MOST_SAMPLES = 16
"""Most sub-frames whose sum fits into the 21 bits of a channel."""

SAMPLE_WEIGHT = TEXEL_WEIGHT // 2
"""What a sub-frame of gray level 1 adds to the sum."""

_HALVES = np.uint64((LANE >> np.uint64(1)) * np.uint64(1 + (1 << 21) + (1 << 42)))
"""Mask of the bits that remain when a color's three numbers are halved."""

_FEWEST_SAMPLES = 2
CACHED_ROWS = 32
"""So many rows that the data of a sub-frame fit into the cache of a core."""

_KNOT_ROWS = 60
_STRIP_ROWS = 4


class Exposure:
    """Renders an atlas through a moving camera with a moving shutter; reuses its buffers between frames."""

    def __init__(self, atlas: Atlas, camera: Camera) -> None:
        self._atlas = atlas
        self._camera = camera
        self._intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
        shape = (camera.height, camera.width)
        self._nearness = np.empty(shape, np.float64)
        self._panels = np.empty(shape, np.int32)

    def total(
        self, pose: Pose, time_s: float, open_s: float, readout_s: float, samples: int, carrier: Pose | None = None
    ) -> NDArray[np.uint64]:
        """The sum (H, W) of sub-frames, three channels of 21 bits per word, SAMPLE_WEIGHT per sample and gray level.

        pose: world_from_camera (4, 4) at a time. time_s: middle of the middle row's exposure. open_s: exposure time of
        a row. readout_s: from the first row's exposure to the last row's. carrier: position of the atlas's moving
        panels at a time, (3,) meters.
        """
        total = np.zeros((self._camera.height, self._camera.width), np.uint64)
        a = self._atlas
        middles_s = time_s + ((np.arange(samples) + 0.5) / samples - 0.5) * open_s
        sub_frames = zip(middles_s.tolist(), offsets_px(samples), strict=True)
        # Render all sub-frames of a strip before the next, so that the textures they share are still in the cache.
        for strips in zip(
            *(self._strips(pose, carrier, s, readout_s, offset) for s, offset in sub_frames), strict=True
        ):
            for k, (first, last, planes, rows) in enumerate(strips):
                self._nearness[first:last] = 0.0
                self._panels[first:last] = -1
                cover(planes, rows, self._nearness, self._panels)
                layout = (a.texels, a.first_level, a.level_count, a.levels)
                _add_rows(planes, self._panels, first, last, 8 * (k + 0.5) / samples, *layout, total)
        return total

    def distances_m(self, pose: Pose, time_s: float, carrier: Pose | None = None) -> Floats:
        """Distances (H, W) along the optical axis at a time, in meters; infinity where there is nothing."""
        for first, last, planes, rows in self._strips(pose, carrier, time_s, 0.0, np.zeros(2)):
            self._nearness[first:last] = 0.0
            self._panels[first:last] = -1
            cover(planes, rows, self._nearness, self._panels)
        with np.errstate(divide="ignore"):
            return np.asarray(1.0 / self._nearness)

    def _strips(
        self, pose: Pose, carrier: Pose | None, middle_s: float, readout_s: float, offset: Floats
    ) -> Iterator[tuple[int, int, Floats, NDArray[np.int64]]]:
        """Yield first row, one past the last, plane equations and candidate rows of strips with one pose each.

        With a rolling shutter, coefficients are computed at knots and interpolated linearly: they are smooth in time.
        """
        height, width = self._camera.height, self._camera.width
        if readout_s == 0.0:
            planes = plane_equations(self._edges(carrier, middle_s), pose(middle_s), self._intrinsics, offset)
            rows = candidate_rows(planes, width, height)
            for first in range(0, height, CACHED_ROWS):
                last = min(first + CACHED_ROWS, height)
                yield first, last, planes, np.clip(rows, first, last)
            return
        knots = np.linspace(0, height, max(2, ceil(height / _KNOT_ROWS) + 1))
        times = middle_s + (knots / height - 0.5) * readout_s
        solved = [plane_equations(self._edges(carrier, t), pose(t), self._intrinsics, offset) for t in times]
        candidates = [candidate_rows(planes, width, height) for planes in solved]
        for first in range(0, height, _STRIP_ROWS):
            last = min(first + _STRIP_ROWS, height)
            place = (first + last) / 2 / height * (len(knots) - 1)
            k = int(place)
            share = place - k
            rows = np.empty_like(candidates[k])
            rows[:, 0] = np.clip(np.minimum(candidates[k][:, 0], candidates[k + 1][:, 0]) - 1, first, last)
            rows[:, 1] = np.clip(np.maximum(candidates[k][:, 1], candidates[k + 1][:, 1]) + 1, first, last)
            yield first, last, solved[k] * (1 - share) + solved[k + 1] * share, rows

    def _edges(self, carrier: Pose | None, time_s: float) -> Floats:
        """The atlas's edges, with the moving panels at their positions at a time."""
        if carrier is None:
            return self._atlas.edges
        edges = self._atlas.edges.copy()
        edges[len(edges) - self._atlas.moving_count :, 0] += carrier(time_s)
        return edges


def samples_for(pose: Pose, time_s: float, open_s: float, focal_px: float, view_m: float) -> int:
    """Number of sub-frames of a frame: about one for three pixels of motion blur, within limits."""
    first, last = pose(time_s - open_s / 2), pose(time_s + open_s / 2)
    turned = np.abs(first[:3, :3] - last[:3, :3]).max()
    moved = np.abs(first[:3, 3] - last[:3, 3]).max() / view_m
    return int(min(max(ceil((turned + moved) * focal_px / 3), _FEWEST_SAMPLES), MOST_SAMPLES))


def offsets_px(samples: int) -> Floats:
    """Offset in the pixel of each sub-frame's samples (S, 2): no two in one row or column, their mean in the middle."""
    rng = np.random.default_rng(samples)
    places = (np.arange(samples) + 0.5) / samples - 0.5
    return np.column_stack([places[rng.permutation(samples)], places[rng.permutation(samples)]])


@compiled
def _add_rows(
    planes: Any, panels: Any, first: int, last: int, sharper: float,
    texels: Any, first_level: Any, level_count: Any, levels: Any, total: Any,
) -> None:  # fmt: skip
    """Add the texture's color at the covered pixels of some rows.

    sharper: threshold in eighths. The coarser of two mip levels is taken if its share is larger, else the finer one.
    The threshold differs between the sub-frames of a frame, so their sum is a blend.
    """
    width = panels.shape[1]
    for y in range(first, last):
        x = 0
        while x < width:
            panel, begin = panels[y, x], x
            while x < width and panels[y, x] == panel:
                x += 1
            if panel >= 0:
                some = levels[first_level[panel] : first_level[panel] + level_count[panel]]
                _add_run(planes[panel], y, begin, x, sharper, some, texels, total)


@compiled
def _add_run(plane: Any, y: int, begin: int, end: int, sharper: float, levels: Any, texels: Any, total: Any) -> None:
    """Add one panel's color to the pixels begin <= x < end of row y."""
    sx, tx, nx = plane[0, 0], plane[1, 0], plane[2, 0]
    s1, t1, n1 = plane[0, 1] * y + plane[0, 2], plane[1, 1] * y + plane[1, 2], plane[2, 1] * y + plane[2, 2]
    level = 0
    for x in range(begin, end):
        depth = 1.0 / (nx * x + n1)
        along, below = (sx * x + s1) * depth, (tx * x + t1) * depth
        if (x - begin) & 7 == 0:
            level, share = texture_level(plane, along, below, depth, levels)
            if share > sharper:
                level += 1
        total[y, x] += (texel(texels, levels, level, along, below) >> np.uint64(1)) & _HALVES
