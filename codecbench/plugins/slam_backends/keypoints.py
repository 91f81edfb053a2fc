"""Features of the contract and keypoints of the SLAM: the same numbers, and descriptors in bytes or in words."""

from __future__ import annotations

import numpy as np

from codecbench.core.contracts.features import DESCRIPTOR_BYTES, Features
from codecbench.slam.features.extractor import Keypoints


def features_of(found: Keypoints) -> Features:
    """Arrays are shared where they can be; the SLAM does not tell how strong a corner is."""
    descriptors = np.ascontiguousarray(found.descriptors).view(np.uint8).reshape(-1, DESCRIPTOR_BYTES)
    return Features(found.size, found.pixels, found.octaves, found.angles, np.full(len(found), np.nan), descriptors)


def keypoints_of(features: Features) -> Keypoints:
    """Arrays are shared where they can be."""
    words = np.ascontiguousarray(features.descriptors).view(np.uint64).reshape(-1, DESCRIPTOR_BYTES // 8)
    return Keypoints(features.size, features.pixels, features.octaves, features.angles, words)
