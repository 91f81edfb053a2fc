"""The keyframe policy: which tracked frames become keyframes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from codecbench.slam import thresholds


@dataclass(frozen=True)
class KeyframeEvidence:
    """What is known of a tracked frame when it is decided whether it becomes a keyframe.

    `inliers`: map points that its pose rests on; `features`: those of its image; `reference_observations` (N,): how
    many keyframes see each point of its reference keyframe; `map_keyframes`: keyframes alive in the map;
    `since_keyframe_frames`: frames since the last one that became a keyframe, 1 for the next; `parallax`: radians, its
    distance from the reference keyframe over the median depth of the points there.
    """

    inliers: int
    features: int
    reference_observations: NDArray[np.int64]
    map_keyframes: int
    since_keyframe_frames: int
    parallax: float


def wants_keyframe(evidence: KeyframeEvidence) -> bool:
    """Whether the frame should become a keyframe: the next one would see too little, or it is welcome and affordable.

    Source: ORB-SLAM V-E, the share of the reference's points. Deviations: a keyframe is needed as soon as that share,
    falling on as it has since the last one, would be too small in the next frame; a thin reference counts as a full one
    where the frame has parallax enough to add points; and, as mapping is in step with tracking, a budget stands for the
    busy mapper where a keyframe is welcome and not needed. Nothing here is in seconds: in a fast turn, or at a low
    rate, a frame just loses more.
    """
    share = _share(evidence)
    loss = max(1.0 - share, 0.0) / evidence.since_keyframe_frames
    if share - loss < thresholds.KEYFRAME_NEXT_SHARE:
        return True
    affordable = evidence.since_keyframe_frames * thresholds.KEYFRAME_BUDGET >= 1.0
    return affordable and share < thresholds.KEYFRAME_MAX_SHARE


def _share(evidence: KeyframeEvidence) -> float:
    """The frame's inliers as a share of what its reference, or a full one, would give it."""
    enough = min(thresholds.POINT_MIN_OBSERVATIONS, evidence.map_keyframes)
    reference_points = int((evidence.reference_observations >= enough).sum())
    adds_points = evidence.parallax >= np.arccos(thresholds.TRIANGULATION_MAX_COSINE)
    full = thresholds.KEYFRAME_FULL_SHARE * evidence.features if adds_points else 0.0
    return evidence.inliers / max(reference_points, full, 1.0)
