"""The keyframe policy: which tracked frames become keyframes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from codecbench.slam import thresholds

_TIME_SLACK_S = 1e-3  # timestamps are rounded


@dataclass(frozen=True)
class KeyframeEvidence:
    """What is known of a tracked frame when it is decided whether it becomes a keyframe.

    `inliers`: map points that its pose rests on; `reference_observations` (N,): how many keyframes see each point of
    its reference keyframe; `map_keyframes`: keyframes alive in the map; `since_keyframe_s`: seconds since the last
    frame that became one.
    """

    inliers: int
    reference_observations: NDArray[np.int64]
    map_keyframes: int
    since_keyframe_s: float


def wants_keyframe(evidence: KeyframeEvidence) -> bool:
    """Whether the frame should become a keyframe: it sees much less than its reference does, or the map is thin here.

    Source: ORB-SLAM V-E. Deviation: mapping is in step with tracking, so a shortest interval stands for the busy
    mapper, and a frame that has lost most of its reference's points does not wait for it.
    """
    enough = min(thresholds.KEYFRAME_REFERENCE_OBSERVATIONS, evidence.map_keyframes)
    reference_points = int((evidence.reference_observations >= enough).sum())
    share = evidence.inliers / max(reference_points, 1)
    if share < thresholds.KEYFRAME_URGENT_SHARE:
        return True
    waited = evidence.since_keyframe_s >= thresholds.KEYFRAME_MIN_INTERVAL_S - _TIME_SLACK_S
    return waited and (share < thresholds.KEYFRAME_MAX_SHARE or evidence.inliers < thresholds.KEYFRAME_FEW_INLIERS)
