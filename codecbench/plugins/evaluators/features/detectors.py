"""The two finders of ORB features that are asked: that of our SLAM, which a robot would run, and OpenCV's."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from codecbench import slam
from codecbench.core.contracts.image import Image
from codecbench.slam.features.extractor import FeatureExtractor

LEVELS: Final = 8
SCALE_FACTOR: Final = 1.2
"""Pyramid of ORB as published and as ORB-SLAM uses it."""
OPENCV_BORDER_PX: Final = 31
"""OpenCV's ORB describes patches of 31 pixels and keeps its keypoints this far from the edge of the image."""


@dataclass(frozen=True)
class Keypoints:
    """ORB keypoints of an image: `places` (N, 3) x, y in pixels and pyramid level; `descriptors` (N, 4) uint64."""

    places: NDArray[np.float64]
    descriptors: NDArray[np.uint64]


class Detector(Protocol):
    """Finds the keypoints of a gray image (height, width), uint8; equal images give equal keypoints."""

    def detect(self, gray: Image) -> Keypoints: ...


class SlamDetector:
    """The extractor of the backend `orb`: corners spread evenly over the image, by a quota for each level."""

    def __init__(self, keypoints: int) -> None:
        self._options = slam.Options(features=keypoints, levels=LEVELS, scale_factor=SCALE_FACTOR)
        self._extractors: dict[tuple[int, ...], FeatureExtractor] = {}

    def detect(self, gray: Image) -> Keypoints:
        found = self._extractor(gray.shape).extract(gray)
        return Keypoints(np.column_stack([found.pixels, found.octaves.astype(np.float64)]), found.descriptors)

    def _extractor(self, shape: tuple[int, ...]) -> FeatureExtractor:
        """The extractor of images of this shape, whose camera does not matter: it has no distortion to undo."""
        if shape not in self._extractors:
            height, width = shape
            camera = slam.Camera(width, height, float(width), float(width), width / 2, height / 2)
            self._extractors[shape] = FeatureExtractor(camera, self._options)
        return self._extractors[shape]


class OpencvDetector:
    """OpenCV's ORB, which keeps the strongest corners wherever they lie."""

    def __init__(self, keypoints: int) -> None:
        self._orb = cv2.ORB.create(keypoints, SCALE_FACTOR, LEVELS, edgeThreshold=OPENCV_BORDER_PX)

    def detect(self, gray: Image) -> Keypoints:
        has_room = min(gray.shape) > 2 * OPENCV_BORDER_PX
        found, descriptors = self._orb.detectAndCompute(gray, None) if has_room else ((), None)
        if not found:
            return Keypoints(np.empty((0, 3)), np.empty((0, 4), np.uint64))
        levels = np.array([keypoint.octave for keypoint in found], dtype=np.float64)
        places = np.column_stack([cv2.KeyPoint.convert(found), levels])
        return Keypoints(places, np.ascontiguousarray(descriptors).view(np.uint64))
