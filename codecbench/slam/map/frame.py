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
    """The features of an image, the map points matched to them, and the frame's pose once known."""

    index: int
    timestamp_s: float
    features: Features
    points: NDArray[np.int64]
    """Map point of each feature (N,), NONE if there is none."""
    camera_from_world: Array
    """Pose (4, 4)."""
    reference: int = NONE
    """The keyframe that shares most points with the frame; itself once it is a keyframe."""
    decode: Callable[[], Features] | None = None
    """Returns the features of the decoded image, if keyframes are coded."""

    @classmethod
    def of(
        cls, index: int, timestamp_s: float, features: Features, decode: Callable[[], Features] | None = None
    ) -> TrackingFrame:
        """Return a frame that shows no map point yet."""
        return cls(index, timestamp_s, features, np.full(len(features), NONE, np.int64), np.eye(4), decode=decode)

    @property
    def matched_features(self) -> NDArray[np.int64]:
        """The features that show a map point."""
        return np.nonzero(self.points >= 0)[0]

    def synchronize(self, slam_map: Map) -> None:
        """Take pose and points, as they are in the map now, from the keyframe that this frame has become."""
        table = slam_map.keyframes
        self.camera_from_world = table.camera_from_world[self.reference].copy()
        self.points = table.points[self.reference, : len(self.features)].copy()
