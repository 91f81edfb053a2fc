from __future__ import annotations

import numpy as np
import pytest

from codecbench.slam.thresholds import KEYFRAME_FEW_INLIERS, KEYFRAME_MIN_INTERVAL_S
from codecbench.slam.tracking.keyframe_policy import KeyframeEvidence, wants_keyframe

LONG_AGO_S = 10.0
JUST_NOW_S = 0.03


def evidence(
    inliers: int, reference: int, since_s: float, map_keyframes: int = 20, seldom_seen: int = 0
) -> KeyframeEvidence:
    """`reference` points that three keyframes see, and `seldom_seen` that two do."""
    observations = np.r_[np.full(reference, 3), np.full(seldom_seen, 2)]
    return KeyframeEvidence(inliers, observations, map_keyframes, since_s)


@pytest.mark.parametrize(
    ("inliers", "reference", "since_s", "expected"),
    [
        # a frame that still sees 0.9 of its reference's points waits, however long ago the last keyframe was
        (180, 200, LONG_AGO_S, False),
        (179, 200, LONG_AGO_S, True),
        (250, 200, LONG_AGO_S, False),
        # between 0.6 and 0.9, the shortest interval must have passed; rounded timestamps count as passed
        (179, 200, JUST_NOW_S, False),
        (179, 200, KEYFRAME_MIN_INTERVAL_S, True),
        (179, 200, KEYFRAME_MIN_INTERVAL_S - 0.0009, True),
        (179, 200, KEYFRAME_MIN_INTERVAL_S - 0.0011, False),
        # below 0.6, no wait
        (120, 200, JUST_NOW_S, False),
        (119, 200, JUST_NOW_S, True),
        # where the map is thin, a keyframe even though all of the reference's points are seen, after the interval
        (KEYFRAME_FEW_INLIERS - 1, 100, LONG_AGO_S, True),
        (KEYFRAME_FEW_INLIERS, 100, LONG_AGO_S, False),
        (KEYFRAME_FEW_INLIERS - 1, 100, JUST_NOW_S, False),
        # a reference that has lost its points
        (150, 0, LONG_AGO_S, False),
        (0, 0, JUST_NOW_S, True),
    ],
)
def test_shares_inliers_and_time_decide(inliers: int, reference: int, since_s: float, expected: bool) -> None:
    assert wants_keyframe(evidence(inliers, reference, since_s)) == expected


@pytest.mark.parametrize(("map_keyframes", "expected"), [(2, True), (3, False), (50, False)])
def test_points_that_too_few_keyframes_see_do_not_count_but_in_a_young_map(map_keyframes: int, expected: bool) -> None:
    """190 inliers are all of 190 points, and 0.5 of 380: the 190 that two keyframes see count while there are two."""
    assert wants_keyframe(evidence(190, 190, JUST_NOW_S, map_keyframes, seldom_seen=190)) == expected
