"""ORB features, spread evenly over the image: corners on a scale pyramid, orientation, binary descriptor.

Source: Rublee, Rabaud, Konolige, Bradski, "ORB", ICCV 2011, doi:10.1109/ICCV.2011.6126544. The spreading follows the
aim of ORB-SLAM V-A (a quota for each level, corners in every cell), by ranking corners within cells.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from codecbench.slam.features.orb_kernels import describe_corners, find_corners, index_cells
from codecbench.slam.geometry.camera import Camera, Floats
from codecbench.slam.options import Options
from codecbench.slam.thresholds import CAMERA_SIGMA_DEG, KEYPOINT_SIGMA_PX

CELL_PX = 10.0
"""Side of the cells in which features are looked up, pixels."""


class View(NamedTuple):
    """Features as compiled code reads them; see Features."""

    pixels: Any
    octaves: Any
    descriptors: Any
    cell_starts: Any
    cell_members: Any
    grid: Any


@dataclass(frozen=True)
class Keypoints:
    """Keypoints of an image as taken, before undistortion."""

    size: tuple[int, int]
    """Width and height of the image."""
    pixels: NDArray[np.float64]
    """Distorted x, y (N, 2)."""
    octaves: NDArray[np.int32]
    """Pyramid levels (N,)."""
    angles: NDArray[np.float64]
    """Orientations (N,), radians."""
    descriptors: NDArray[np.uint64]
    """256 bits each (N, 4)."""

    def __len__(self) -> int:
        return len(self.pixels)


@dataclass
class Features:
    """Features of one image, undistorted and indexed by cell."""

    pixels: NDArray[np.float64]
    """Undistorted x, y (N, 2)."""
    octaves: NDArray[np.int32]
    """Pyramid levels (N,)."""
    angles: NDArray[np.float64]
    """Orientations (N,), radians."""
    descriptors: NDArray[np.uint64]
    """256 bits each (N, 4)."""
    cell_starts: NDArray[np.int64]
    """Where each cell begins in `cell_members` (rows * columns + 1,), row by row."""
    cell_members: NDArray[np.int64]
    """Indices of the features (N,), cell by cell."""
    grid: NDArray[np.float64]
    """x_min, y_min, columns, rows (4,)."""

    def __len__(self) -> int:
        return len(self.pixels)

    def same_as(self, other: Features) -> bool:
        """Return whether these features are of the same image: pixels and descriptors are equal to the bit."""
        return np.array_equal(self.pixels, other.pixels) and np.array_equal(self.descriptors, other.descriptors)

    @property
    def view(self) -> View:
        """The features as compiled code reads them."""
        return View(self.pixels, self.octaves, self.descriptors, self.cell_starts, self.cell_members, self.grid)


def level_sizes(width: int, height: int, scale_factors: NDArray[np.float64]) -> list[tuple[int, int]]:
    """Return (height, width) of each level of the pyramid of an image, in pixels."""
    return [(max(round(height / factor), 1), max(round(width / factor), 1)) for factor in scale_factors]


class FeatureExtractor:
    """Extracts ORB features; the same image always gives the same features.

    It reuses its image buffers from frame to frame: use it from one thread at a time.
    """

    def __init__(self, camera: Camera, options: Options) -> None:
        self._camera = camera
        factors = np.asarray(options.scale_factor ** np.arange(options.levels), dtype=np.float64)
        self.scale_factors: NDArray[np.float64] = factors
        shares = 1.0 / factors
        self._quotas = np.floor(options.features * shares / shares.sum() + 0.5).astype(np.int64)
        self._quotas[0] += options.features - self._quotas.sum()
        sizes = level_sizes(camera.width, camera.height, factors)
        self._ratios = np.array([[camera.width / width, camera.height / height] for height, width in sizes])
        self._levels = [np.empty(size, np.uint8) for size in sizes[1:]]
        self._scratch_images = [np.empty(size, np.uint8) for size in sizes]
        low, high = camera.bounds[:2], camera.bounds[2:]
        columns, rows = np.ceil((high - low + 1.0) / CELL_PX)
        self._grid = np.array([low[0], low[1], max(columns, 1.0), max(rows, 1.0)])

    def extract(self, gray: NDArray[np.uint8]) -> Features:
        """Return the features of a gray image (height, width), uint8."""
        return self.features_of(self.find(gray))

    def find(self, gray: NDArray[np.uint8]) -> Keypoints:
        """Return the keypoints of a gray image (height, width), uint8, by level and in reading order within each."""
        limit, count = int(self._quotas.sum()), 0
        pixels, angles = np.empty((limit, 2)), np.empty(limit)
        octaves, descriptors = np.empty(limit, np.int32), np.empty((limit, 32), np.uint8)
        for octave, level in enumerate(self._pyramid(gray)):
            scratch = self._scratch_images[octave]
            corners, offsets = find_corners(level, self._quotas[octave], scratch)
            end = count + len(corners)
            rows = slice(count, end)
            ratio = self._ratios[octave]
            describe_corners(level, corners, offsets, ratio, scratch, pixels[rows], angles[rows], descriptors[rows])
            octaves[rows] = octave
            count = end
        size = (self._camera.width, self._camera.height)
        return Keypoints(size, pixels[:count], octaves[:count], angles[:count], descriptors[:count].view(np.uint64))

    def features_of(self, keypoints: Keypoints) -> Features:
        """Return the features for keypoints of an image of the camera's size, whatever detected them."""
        undistorted = self._camera.undistort(keypoints.pixels)
        if not self._camera.has_blind_pixels:
            return self.index(undistorted, keypoints.octaves, keypoints.angles, keypoints.descriptors)
        seen = np.flatnonzero(np.isfinite(undistorted[:, 0]))
        return self.index(
            undistorted[seen], keypoints.octaves[seen], keypoints.angles[seen], keypoints.descriptors[seen]
        )

    def index(
        self, pixels: NDArray[Any], octaves: NDArray[Any], angles: NDArray[Any], descriptors: NDArray[Any]
    ) -> Features:
        """Return the features with these arrays, and their cell index."""
        starts, members = index_cells(pixels, self._grid, CELL_PX)
        return Features(pixels, octaves, angles, descriptors, starts, members, self._grid)

    def _pyramid(self, gray: NDArray[np.uint8]) -> list[NDArray[np.uint8]]:
        """Return the image and its smaller levels, which the next frame overwrites."""
        levels = [np.ascontiguousarray(gray)]
        for level in self._levels:
            cv2.resize(levels[-1], level.shape[::-1], dst=level, interpolation=cv2.INTER_LINEAR)
            levels.append(level)
        return levels


ImageArray = NDArray[np.uint8]


def to_gray(image: NDArray[Any]) -> ImageArray:
    """Return the image in gray (height, width); three channels, red first, are converted by BT.601.

    Raises TypeError unless the image is a uint8 array (height, width) or (height, width, 1 or 3).
    """
    if not isinstance(image, np.ndarray) or image.dtype != np.uint8:
        raise TypeError(f"image: got {getattr(image, 'dtype', type(image).__name__)}; expected a uint8 array")
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[:, :, 0]
    if image.ndim == 2:
        return np.ascontiguousarray(image)
    if image.ndim == 3 and image.shape[2] == 3:
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
    raise TypeError(f"image: got shape {image.shape}; expected (height, width) or (height, width, 3)")


def pixel_variances(camera: Camera, scale_factors: Floats) -> Floats:
    """Return the variance of a keypoint's position along each axis, px^2, by level (L,).

    The error of a corner grows with the scale factor of its level (`scale_factors`, (L,)). The error of the camera's
    model, of lens and shutter, does not.
    """
    return np.asarray(camera.pixels_across(CAMERA_SIGMA_DEG) ** 2 + (KEYPOINT_SIGMA_PX * scale_factors) ** 2)
