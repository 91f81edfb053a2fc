"""ORB features, spread evenly over the image: corners on a scale pyramid, orientation, binary descriptor.

Source: Rublee, Rabaud, Konolige, Bradski, "ORB", ICCV 2011, doi:10.1109/ICCV.2011.6126544; the spreading follows the
aim of ORB-SLAM V-A (a quota for each level, corners in every cell), by ranking corners within cells.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from codecbench.slam import thresholds
from codecbench.slam.features.corner_kernels import list_corners, score_corners
from codecbench.slam.features.orb_kernels import (
    blur_level,
    describe_patches,
    index_cells,
    orient_patches,
    select_evenly,
)
from codecbench.slam.geometry.camera import Camera
from codecbench.slam.options import Options

CELL_PX = 10.0
"""Side of the cells by which features are looked up, pixels."""


@dataclass
class Features:
    """The features of one image.

    `pixels` (N, 2) undistorted x, y; `octaves` (N,) pyramid level; `angles` (N,) orientation in radians;
    `descriptors` (N, 4) uint64: 256 bits. `cell_starts` (rows * columns + 1,) and `cell_members` (N,) list the
    features of each cell of CELL_PX, row by row; `grid` (4,) is x_min, y_min, columns, rows.
    """

    pixels: NDArray[np.float64]
    octaves: NDArray[np.int32]
    angles: NDArray[np.float64]
    descriptors: NDArray[np.uint64]
    cell_starts: NDArray[np.int64]
    cell_members: NDArray[np.int64]
    grid: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.pixels)


class FeatureExtractor:
    """Finds ORB features; `extract` gives the same features for the same image, always."""

    def __init__(self, camera: Camera, options: Options) -> None:
        self._camera = camera
        factors = np.asarray(options.scale_factor ** np.arange(options.levels), dtype=np.float64)
        self.scale_factors: NDArray[np.float64] = factors
        shares = 1.0 / factors
        self._quotas = np.floor(options.features * shares / shares.sum() + 0.5).astype(np.int64)
        self._quotas[0] += options.features - self._quotas.sum()
        low, high = camera.bounds[:2], camera.bounds[2:]
        columns, rows = np.ceil((high - low + 1.0) / CELL_PX)
        self._grid = np.array([low[0], low[1], max(columns, 1.0), max(rows, 1.0)])

    def extract(self, gray: NDArray[np.uint8]) -> Features:
        """Features of a gray image (height, width), uint8."""
        parts = [self._extract_level(level, octave) for octave, level in enumerate(self._pyramid(gray))]
        pixels = np.concatenate([part[0] for part in parts])
        octaves = np.concatenate([np.full(len(part[0]), i, np.int32) for i, part in enumerate(parts)])
        angles = np.concatenate([part[1] for part in parts])
        descriptors = np.concatenate([part[2] for part in parts]).view(np.uint64)
        return self.index(self._camera.undistort(pixels), octaves, angles, descriptors)

    def index(
        self, pixels: NDArray[Any], octaves: NDArray[Any], angles: NDArray[Any], descriptors: NDArray[Any]
    ) -> Features:
        """Features from their arrays, with the cell index built."""
        starts, members = index_cells(pixels, self._grid, CELL_PX)
        return Features(pixels, octaves, angles, descriptors, starts, members, self._grid)

    def _pyramid(self, gray: NDArray[np.uint8]) -> list[NDArray[np.uint8]]:
        height, width = gray.shape
        levels = [np.ascontiguousarray(gray)]
        for factor in self.scale_factors[1:]:
            size = (max(round(width / factor), 1), max(round(height / factor), 1))
            level = cv2.resize(levels[-1], size, interpolation=cv2.INTER_LINEAR)
            levels.append(np.asarray(level, dtype=np.uint8))
        return levels

    def _extract_level(
        self, level: NDArray[np.uint8], octave: int
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.uint8]]:
        corners = _select_corners(level, int(self._quotas[octave]))
        if len(corners) == 0:
            return np.empty((0, 2)), np.empty(0), np.empty((0, 32), np.uint8)
        angles = orient_patches(level, corners)
        descriptors = describe_patches(blur_level(level), corners, angles)
        # The pyramid maps pixel areas, not pixel centres: a centre moves by half a pixel of each level.
        ratio = np.array([self._camera.width / level.shape[1], self._camera.height / level.shape[0]])
        return (corners + 0.5) * ratio - 0.5, angles, descriptors


def _select_corners(level: NDArray[np.uint8], quota: int) -> NDArray[np.int64]:
    """At most `quota` corners x, y (N, 2): of the low threshold where the high one leaves too few to choose from."""
    image = np.empty_like(level)
    score_corners(level, image)
    corners, scores = list_corners(image, thresholds.FAST_THRESHOLD_LOW)
    enough = np.count_nonzero(scores > thresholds.FAST_THRESHOLD) >= thresholds.FAST_CANDIDATES_PER_FEATURE * quota
    threshold = thresholds.FAST_THRESHOLD if enough else thresholds.FAST_THRESHOLD_LOW
    height, width = level.shape
    kept = select_evenly(corners, scores, threshold, quota, height, width, thresholds.BORDER_PX)
    return np.asarray(corners[kept])
