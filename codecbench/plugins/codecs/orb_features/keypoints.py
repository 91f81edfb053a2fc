"""Keypoints as integers on a grid, and the search for nearby keypoints as references.

Places are x, y in the image in 1/PLACE_UNIT pixels, so that keypoints of all levels compare.
"""

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
"""Ratio of two pyramid levels, as in ORB's publication and the SLAM's default."""

PARTS: Final = SUBPIXELS
"""Number of subpixel positions of the SLAM, in x and in y."""

PLACE_UNIT: Final = 16
"""Units of a place per pixel of the image."""
MAX_CANDIDATES: Final = 64
"""Most candidates of one kind; later ones in the order of the arrays are ignored."""

_TURN: Final = 2.0 * math.pi
_PLACE_BITS: Final = 32  # enough for the cells of the largest image


@dataclass(frozen=True)
class Grid:
    """Possible positions of an image's keypoints: the cells of each level, and the parts of each cell."""

    width: int
    height: int
    levels: int
    step: int
    """Side of a cell in pixels of its level."""
    parts: int = 1
    """Number of parts of a cell, in x and in y."""

    @cached_property
    def sizes(self) -> NDArray[np.int64]:
        """Width and height of each level, (levels, 2), in pixels."""
        factors = np.asarray(SCALE_FACTOR ** np.arange(self.levels), np.float64)
        return np.array([size[::-1] for size in level_sizes(self.width, self.height, factors)], np.int64)

    @cached_property
    def cells(self) -> NDArray[np.int64]:
        """Columns and rows of each level's cells, (levels, 2)."""
        return -(-self.sizes // self.step)

    @cached_property
    def level_units(self) -> NDArray[np.int64]:
        """Columns, rows and cell sizes of each level for `coding.code_set`."""
        sizes, whole = self.sizes, np.array([self.width, self.height], np.int64)
        units = (16 * PLACE_UNIT * self.step * whole + sizes // 2) // sizes
        return np.concatenate([self.cells, units], axis=1)

    @cached_property
    def ratios(self) -> NDArray[np.float64]:
        """Ratio of the image's size to each level's, (levels, 2)."""
        return np.array([self.width, self.height]) / self.sizes


@lru_cache(maxsize=16)
def grid_of(width: int, height: int, levels: int, step: int, parts: int = 1) -> Grid:
    """Return the grid; cached, so that its tables are not computed for every set."""
    return Grid(width, height, levels, step, parts)


@dataclass(frozen=True)
class CodedKeypoints:
    """Keypoints on a grid, by level and in reading order within each."""

    grid: Grid
    angle_bits: int
    octave_starts: NDArray[np.int64]
    """(levels + 1,): first index of each level."""
    cells: NDArray[np.int64]
    """(N,): row * columns + column."""
    parts: NDArray[np.int64]
    """(N,): row * parts + column within the cell."""
    angles: NDArray[np.int64]
    """(N,): in 1/2^angle_bits of a turn."""
    descriptors: NDArray[np.uint64]
    """(N, 4)."""

    def __len__(self) -> int:
        return len(self.cells)

    @classmethod
    def from_keypoints(
        cls, keypoints: Keypoints, levels: int, step: int, parts: int, angle_bits: int
    ) -> CodedKeypoints:
        """Round keypoints of a pyramid of `levels` levels to its grid."""
        grid = grid_of(*keypoints.size, levels, step, parts)
        corners = np.floor((keypoints.pixels + 0.5) / grid.ratios[keypoints.octaves] * (parts / step)).astype(np.int64)
        whole, within = np.divmod(corners, parts)
        cells = whole[:, 1] * grid.cells[keypoints.octaves, 0] + whole[:, 0]
        places_within = within[:, 1] * parts + within[:, 0]
        angles = np.rint(keypoints.angles * (2**angle_bits / _TURN)).astype(np.int64) & (2**angle_bits - 1)
        octaves, descriptors = keypoints.octaves, keypoints.descriptors
        places = (octaves.astype(np.int64) << _PLACE_BITS) | cells
        if (places[1:] < places[:-1]).any():  # not in an extractor's order
            order = np.argsort(places, kind="stable")
            octaves, cells, places_within = octaves[order], cells[order], places_within[order]
            angles, descriptors = angles[order], descriptors[order]
        starts = np.searchsorted(octaves, np.arange(levels + 1)).astype(np.int64)
        return cls(grid, angle_bits, starts, cells, places_within, angles, descriptors)

    @property
    def octaves(self) -> NDArray[np.int32]:
        """Level of each keypoint, (N,)."""
        return np.repeat(np.arange(self.grid.levels, dtype=np.int32), np.diff(self.octave_starts))

    def keypoints(self) -> Keypoints:
        """Reconstruct keypoints in the middle of their cell, or of their part of the cell."""
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


@compiled
def find_candidates(
    places: Any, octave_starts: Any, firsts: Any, lowest: int, highest: int, x: int, y: int, radius: int,
    candidates: Any, keys: Any,
) -> int:  # fmt: skip
    """Fill `candidates` with indices of keypoints within `radius` of x and of y; returns their number.

    places: (N, 2) int64, by octave and then by y. octave_starts: (octaves + 1,) first index of each. firsts: (octaves,)
    first index of the last search in each octave, updated, because the next search begins nearby. lowest, highest:
    octaves to search. keys: filled, ascending with distance and then with the index. candidates, keys:
    (MAX_CANDIDATES + 1,) int64.
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
            candidates[count], keys[count] = k, ((dx * dx + dy * dy) << 8) | count
            count += 1 if abs(dx) <= radius else 0  # no branch, because it would be unpredictable
    return count


@compiled
def rank_of(candidate: int, keys: Any, count: int) -> int:
    """Return the number of nearer candidates."""
    rank = 0
    for k in range(count):
        rank += 1 if keys[k] < keys[candidate] else 0
    return rank


@compiled
def candidate_of(rank: int, keys: Any, count: int) -> int:
    """Return the candidate of a rank, -1 if there is none."""
    for candidate in range(count):
        if rank_of(candidate, keys, count) == rank:
            return candidate
    return -1
