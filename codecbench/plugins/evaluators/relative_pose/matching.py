"""Keypoints of an image, and matches between two images, as usual in the literature on image matching."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.errors import Unsupported
from codecbench.core.contracts.features import Features
from codecbench.core.contracts.image import Image, gray_from_image
from codecbench.core.contracts.sequence import Camera
from codecbench.core.kernels.compiled import compiled
from codecbench.slam.features.hamming import hamming
from codecbench.slam.geometry.camera import Camera as SlamCamera

Detector = Literal["orb", "sift"]

_LEVELS: Final = 8
_SCALE_FACTOR: Final = 1.2
_SMALLEST_SIDE: Final = 64
"""Pixels. A smaller image has no room for ORB's patches of 31 pixels, nor for all levels of OpenCV's pyramid."""


@dataclass(frozen=True)
class KeypointSet:
    """Keypoints of an image."""

    pixels: NDArray[np.float64]
    """(N, 2), undistorted."""
    descriptors: NDArray[Any]
    """(N, 4) uint64 of ORB, or (N, 128) float32 of SIFT."""

    def __len__(self) -> int:
        return len(self.pixels)


NO_KEYPOINTS: Final = KeypointSet(np.empty((0, 2)), np.empty((0, 0)))


class Matcher:
    """Detects up to `keypoints` ORB or SIFT features in an image, and matches two images by nearest descriptors.

    A match is mutual, and its distance is below `ratio` times that of the second best in the second image (Lowe, IJCV
    60(2), 2004, doi:10.1023/B:VISI.0000029664.99615.94).
    """

    def __init__(self, detector: Detector, keypoints: int, ratio: float, camera: Camera) -> None:
        self._ratio = ratio
        self._binary = detector == "orb"
        self._detector: Any = (
            cv2.ORB.create(keypoints, _SCALE_FACTOR, _LEVELS) if self._binary else cv2.SIFT.create(keypoints)
        )
        self.matrix = np.array([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]])
        self._distortion = np.array(camera.distortion)
        sizes = (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
        self._lens = SlamCamera(*sizes, camera.distortion, camera.model)

    def detect(self, image: Image) -> KeypointSet:
        """The keypoints of an image, color or gray."""
        gray = gray_from_image(image)
        keypoints, descriptors = (
            self._detector.detectAndCompute(gray, None) if min(gray.shape) >= _SMALLEST_SIDE else ((), None)
        )
        if not keypoints or descriptors is None:
            return NO_KEYPOINTS
        return self._undistort(np.asarray(cv2.KeyPoint.convert(keypoints), dtype=np.float64), descriptors)

    def convert(self, features: Features) -> KeypointSet:
        """The keypoints of features that a codec sent. Raises Unsupported if the detector is not ORB."""
        if not self._binary:
            raise Unsupported("detector sift cannot match the binary features that the codec sends; use detector orb")
        return self._undistort(features.pixels, features.descriptors) if len(features) else NO_KEYPOINTS

    def _undistort(self, pixels: NDArray[np.float64], descriptors: NDArray[Any]) -> KeypointSet:
        """Undistorted keypoints, without those at blind pixels of the lens."""
        if self._lens.has_blind_pixels:
            pixels = self._lens.undistort(pixels)
            visible = np.isfinite(pixels[:, 0])
            pixels, descriptors = pixels[visible], descriptors[visible]
        elif self._distortion.any():
            undistorted = cv2.undistortPoints(pixels[:, None], self.matrix, self._distortion, P=self.matrix)
            pixels = np.asarray(undistorted[:, 0], dtype=np.float64)
        return KeypointSet(pixels, np.ascontiguousarray(descriptors).view(np.uint64) if self._binary else descriptors)

    def match(self, first: KeypointSet, second: KeypointSet) -> NDArray[np.int64]:
        """(M, 2) indices of matching keypoints, in the order of the first image."""
        if min(len(first), len(second)) < 2:
            return np.empty((0, 2), np.int64)
        nearest = _nearest_bits if self._binary else _nearest_vectors
        partners, back, distinct = nearest(first.descriptors, second.descriptors, self._ratio)
        matches = np.flatnonzero(distinct & (back[partners] == np.arange(len(first))))
        return np.column_stack([matches, partners[matches]]).astype(np.int64)


def _nearest_vectors(first: Any, second: Any, ratio: float) -> tuple[Any, Any, Any]:
    """As `_nearest_bits`, for vectors (N, D) and (M, D) by Euclidean distance."""
    squares = np.sum(first**2, axis=1)[:, None] + np.sum(second**2, axis=1) - 2.0 * first @ second.T
    best, runner_up = np.partition(np.maximum(squares, 0.0), 1, axis=1)[:, :2].T
    return squares.argmin(axis=1), squares.argmin(axis=0), best < ratio**2 * runner_up


@compiled
def _nearest_bits(first: Any, second: Any, ratio: float) -> tuple[Any, Any, Any]:
    """Nearest neighbors of binary descriptors (N, 4) and (M, 4): (N,) of each first, and (M,) of each second.

    The third result (N,) is whether the best Hamming distance is below `ratio` times the second best. The lowest index
    wins among equals.
    """
    count, other_count = len(first), len(second)
    nearest, back = np.zeros(count, np.int64), np.zeros(other_count, np.int64)
    back_best = np.full(other_count, 257, np.int64)
    clear = np.zeros(count, np.bool_)
    for i in range(count):
        best, runner_up = 257, 257
        for j in range(other_count):
            bits = hamming(first, i, second, j)
            if bits < best:
                runner_up, best, nearest[i] = best, bits, j
            elif bits < runner_up:
                runner_up = bits
            if bits < back_best[j]:
                back_best[j], back[j] = bits, i
        clear[i] = best < ratio * runner_up
    return nearest, back, clear
