"""Keyframes whose image is coded and decoded before the map sees it, while tracking sees the raw one."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from codecbench.slam import thresholds
from codecbench.slam.features.extractor import Features
from codecbench.slam.features.matching import match_in_windows
from codecbench.slam.map.frame import TrackingFrame
from codecbench.slam.map.map import NONE


def match_decoded(
    raw: Features, decoded: Features, chosen: NDArray[np.int64], scale_factors: NDArray[np.float64]
) -> NDArray[np.int64]:
    """The features of the decoded image that show what features `chosen` (N,) of the raw image show, (N,), -1 for
    none: the nearest in appearance within a small window."""
    octaves = raw.octaves[chosen].astype(np.int64)
    return match_in_windows(
        raw.pixels[chosen], thresholds.DECODED_WINDOW_PX * scale_factors[octaves], octaves - 1, octaves + 1,
        raw.descriptors[chosen], decoded, np.ones(len(decoded), np.bool_), thresholds.HAMMING_LOW,
    )  # fmt: skip


def use_decoded(frame: TrackingFrame, scale_factors: NDArray[np.float64]) -> None:
    """Replace the features of `frame` by those of its decoded image, if it has one, and carry its points over."""
    if frame.decode is None:
        return
    raw, frame.features, frame.decode = frame.features, frame.decode(), None
    matched = frame.matched
    matches = match_decoded(raw, frame.features, matched, scale_factors)
    points = np.full(len(frame.features), NONE, np.int64)
    points[matches[matches >= 0]] = frame.points[matched[matches >= 0]]
    frame.points = points
