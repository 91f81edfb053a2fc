"""Keypoints as integers, which is what is coded, and back."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from codecbench.core.kernels.compiled import compiled
from codecbench.slam.features.corner_kernels import SUBPIXELS
from codecbench.slam.features.extractor import Keypoints, level_sizes

SCALE_FACTOR: Final = 1.2
"""Between two levels of the pyramid, as ORB was published and as the SLAM has it by default."""

PARTS: Final = SUBPIXELS
"""Of a pixel, each way, in which the SLAM tells positions apart."""

_TURN: Final = 2.0 * math.pi
_PLACE_BITS: Final = 32  # more than cells of the largest image take


@dataclass(frozen=True)
class Grid:
    """Where keypoints of an image can lie: in cells of `step` x `step` pixels of each of `levels` levels, and within a
    cell in one of `parts` x `parts` parts."""

    width: int
    height: int
    levels: int
    step: int
    parts: int = 1

    @cached_property
    def sizes(self) -> NDArray[np.int64]:
        """(levels, 2): width and height of each level, in pixels."""
        factors = np.asarray(SCALE_FACTOR ** np.arange(self.levels), np.float64)
        return np.array([size[::-1] for size in level_sizes(self.width, self.height, factors)], np.int64)

    @cached_property
    def cells(self) -> NDArray[np.int64]:
        """(levels, 2): columns and rows of each level's cells."""
        return -(-self.sizes // self.step)

    @cached_property
    def level_units(self) -> NDArray[np.int64]:
        """As `coding.code_set` reads it."""
        sizes, whole = self.sizes, np.array([self.width, self.height], np.int64)
        units = (16 * PLACE_UNIT * self.step * whole + sizes // 2) // sizes
        return np.concatenate([self.cells, units], axis=1)

    @cached_property
    def ratios(self) -> NDArray[np.float64]:
        """(levels, 2): the image's size over each level's."""
        return np.array([self.width, self.height]) / self.sizes


@lru_cache(maxsize=16)
def grid_of(width: int, height: int, levels: int, step: int, parts: int = 1) -> Grid:
    """The grid, whose tables are made once and not for every set."""
    return Grid(width, height, levels, step, parts)


@dataclass(frozen=True)
class CodedKeypoints:
    """Keypoints on a grid, by level and in reading order within each.

    octave_starts (levels + 1,): where each level begins; cells (N,): row * columns + column; parts (N,): the same
    within the cell; angles (N,): in 1/2^angle_bits of a turn; descriptors (N, 4).
    """

    grid: Grid
    angle_bits: int
    octave_starts: NDArray[np.int64]
    cells: NDArray[np.int64]
    parts: NDArray[np.int64]
    angles: NDArray[np.int64]
    descriptors: NDArray[np.uint64]

    def __len__(self) -> int:
        return len(self.cells)

    @classmethod
    def of(cls, found: Keypoints, levels: int, step: int, parts: int, angle_bits: int) -> CodedKeypoints:
        """Keypoints of a pyramid of so many levels, on its grid."""
        grid = grid_of(*found.size, levels, step, parts)
        corners = np.floor((found.pixels + 0.5) / grid.ratios[found.octaves] * (parts / step)).astype(np.int64)
        whole, within = np.divmod(corners, parts)
        cells = whole[:, 1] * grid.cells[found.octaves, 0] + whole[:, 0]
        places_within = within[:, 1] * parts + within[:, 0]
        angles = np.rint(found.angles * (2**angle_bits / _TURN)).astype(np.int64) & (2**angle_bits - 1)
        octaves, descriptors = found.octaves, found.descriptors
        places = (octaves.astype(np.int64) << _PLACE_BITS) | cells
        if (places[1:] < places[:-1]).any():  # not as an extractor gives them
            order = np.argsort(places, kind="stable")
            octaves, cells, places_within = octaves[order], cells[order], places_within[order]
            angles, descriptors = angles[order], descriptors[order]
        starts = np.searchsorted(octaves, np.arange(levels + 1)).astype(np.int64)
        return cls(grid, angle_bits, starts, cells, places_within, angles, descriptors)

    @property
    def octaves(self) -> NDArray[np.int32]:
        """(N,): the level of each."""
        return np.repeat(np.arange(self.grid.levels, dtype=np.int32), np.diff(self.octave_starts))

    def keypoints(self) -> Keypoints:
        """What the server makes of them: a keypoint lies in the middle of its cell, or of its part of the cell."""
        grid, octaves = self.grid, self.octaves
        rows, columns = np.divmod(self.cells, grid.cells[octaves, 0])
        down, across = np.divmod(self.parts, grid.parts)
        cells = np.stack([columns * grid.parts + across, rows * grid.parts + down], axis=1)
        size = grid.step / grid.parts
        corners = np.clip(cells * size + 0.5 * (size - 1), 0.0, grid.sizes[octaves] - 1.0)
        pixels = (corners + 0.5) * grid.ratios[octaves] - 0.5
        signed = self.angles - ((self.angles >> (self.angle_bits - 1)) << self.angle_bits)  # -pi up to pi
        angles = signed * (_TURN / 2**self.angle_bits)
        return Keypoints((grid.width, grid.height), pixels, octaves, angles, self.descriptors)


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
