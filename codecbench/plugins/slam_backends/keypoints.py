"""Convert between the contract's features, with descriptors in bytes, and the SLAM's keypoints, with them in words."""

from __future__ import annotations

import numpy as np

from codecbench.core.contracts.features import DESCRIPTOR_BYTES, Features
from codecbench.slam.features.extractor import Keypoints


def features_of(keypoints: Keypoints) -> Features:
    """Convert keypoints, sharing arrays if possible. The SLAM does not report the strength of corners, which is NaN."""
    descriptors = np.ascontiguousarray(keypoints.descriptors).view(np.uint8).reshape(-1, DESCRIPTOR_BYTES)
    strengths = np.full(len(keypoints), np.nan)
    return Features(keypoints.size, keypoints.pixels, keypoints.octaves, keypoints.angles, strengths, descriptors)


def keypoints_of(features: Features) -> Keypoints:
    """Convert features, sharing arrays if possible."""
    words = np.ascontiguousarray(features.descriptors).view(np.uint64).reshape(-1, DESCRIPTOR_BYTES // 8)
    return Keypoints(features.size, features.pixels, features.octaves, features.angles, words)
