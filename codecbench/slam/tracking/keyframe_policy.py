"""The keyframe policy: which tracked frames become keyframes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from codecbench.slam import thresholds


@dataclass(frozen=True)
class KeyframeEvidence:
    """What is known of a tracked frame when the policy decides whether it becomes a keyframe."""

    inliers: int
    """Map points that support its pose."""
    features: int
    """Number of its features."""
    reference_observations: NDArray[np.int64]
    """How many keyframes see each point of its reference keyframe (N,)."""
    map_keyframes: int
    """Keyframes alive in the map."""
    since_keyframe_frames: int
    """Frames since the last one that became a keyframe, 1 for the next."""
    parallax: float
    """Radians: distance from the reference keyframe over the median depth of the points there."""


def wants_keyframe(evidence: KeyframeEvidence) -> bool:
    """Return whether the frame should become a keyframe: it is needed, or it is welcome and affordable.

    Source: ORB-SLAM V-E, the share of the reference's points. Deviations: a keyframe is needed as soon as that share,
    falling as it has since the last one, would be too small in the next frame. A thin reference counts as a full one if
    the frame has parallax enough to add points. As mapping is in step with tracking, a budget stands for the busy
    mapper if a keyframe is welcome and not needed. Nothing here is in seconds: in a fast turn, or at a low rate, a
    frame just loses more.
    """
    share = _share(evidence)
    loss = max(1.0 - share, 0.0) / evidence.since_keyframe_frames
    if share - loss < thresholds.KEYFRAME_NEXT_SHARE:
        return True
    affordable = evidence.since_keyframe_frames * thresholds.KEYFRAME_BUDGET >= 1.0
    return affordable and share < thresholds.KEYFRAME_MAX_SHARE


def _share(evidence: KeyframeEvidence) -> float:
    """Return the frame's inliers as a share of what its reference, or a full one, would give it."""
    enough = min(thresholds.POINT_MIN_OBSERVATIONS, evidence.map_keyframes)
    reference_points = int((evidence.reference_observations >= enough).sum())
    adds_points = evidence.parallax >= np.arccos(thresholds.TRIANGULATION_MAX_COSINE)
    full = thresholds.KEYFRAME_FULL_SHARE * evidence.features if adds_points else 0.0
    return evidence.inliers / max(reference_points, full, 1.0)
