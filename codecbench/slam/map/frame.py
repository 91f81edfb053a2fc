"""A frame on its way through tracking and mapping."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from codecbench.slam.features.extractor import Features
from codecbench.slam.geometry.rotations import Array
from codecbench.slam.map.map import NONE, Map


@dataclass
class TrackingFrame:
    """An image's features, the map points that they show, and its pose once known.

    `points` (N,) index map points by feature, NONE where there is none; `camera_from_world` (4, 4); `reference` is the
    keyframe that shares most points with it, itself once it is a keyframe; `decode` gives the features of the decoded
    image, where keyframes are coded.
    """

    index: int
    timestamp_s: float
    features: Features
    points: NDArray[np.int64]
    camera_from_world: Array
    reference: int = NONE
    decode: Callable[[], Features] | None = None

    @classmethod
    def of(
        cls, index: int, timestamp_s: float, features: Features, decode: Callable[[], Features] | None = None
    ) -> TrackingFrame:
        """A frame that shows no map point yet."""
        return cls(index, timestamp_s, features, np.full(len(features), NONE, np.int64), np.eye(4), decode=decode)

    @property
    def matched(self) -> NDArray[np.int64]:
        """The features that show a map point."""
        return np.nonzero(self.points >= 0)[0]

    def synchronise(self, slam_map: Map) -> None:
        """Take pose and points from the keyframe that this frame has become, as they are in the map now."""
        table = slam_map.keyframes
        self.camera_from_world = table.camera_from_world[self.reference].copy()
        self.points = table.points[self.reference, : len(self.features)].copy()
