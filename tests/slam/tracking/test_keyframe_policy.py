from __future__ import annotations

import numpy as np
import pytest

from codecbench.slam.thresholds import KEYFRAME_BUDGET_S
from codecbench.slam.tracking.keyframe_policy import KeyframeEvidence, wants_keyframe

FEATURES = 1000
LONG_AGO_S = 10.0
JUST_NOW_S = 0.03


def evidence(
    inliers: int,
    reference: int,
    frames: int,
    seconds: float,
    features: int = FEATURES,
    map_keyframes: int = 20,
    seldom_seen: int = 0,
) -> KeyframeEvidence:
    """`reference` points that three keyframes see, and `seldom_seen` that two do; `frames`, `seconds` ago: the last."""
    observations = np.r_[np.full(reference, 3), np.full(seldom_seen, 2)]
    return KeyframeEvidence(inliers, features, observations, map_keyframes, frames, seconds)


@pytest.mark.parametrize(
    ("inliers", "reference", "frames", "seconds", "expected"),
    [
        # a frame that still sees 0.9 of its reference's points is not welcome, however long ago the last keyframe was
        (180, 200, 100, LONG_AGO_S, False),
        (179, 200, 100, LONG_AGO_S, True),
        (250, 200, 100, LONG_AGO_S, False),
        # a welcome one waits for the budget; rounded timestamps count as passed
        (179, 200, 3, JUST_NOW_S, False),
        (179, 200, 3, KEYFRAME_BUDGET_S, True),
        (179, 200, 3, KEYFRAME_BUDGET_S - 0.0009, True),
        (179, 200, 3, KEYFRAME_BUDGET_S - 0.0011, False),
        # a needed one does not: 0.195 lost in a frame leaves the next one 0.61, 0.205 leave it 0.59
        (161, 200, 1, JUST_NOW_S, False),
        (159, 200, 1, JUST_NOW_S, True),
        # the same loss in three frames is slower: there, 0.3 is the most
        (159, 200, 3, JUST_NOW_S, False),
        (141, 200, 3, JUST_NOW_S, False),
        (139, 200, 3, JUST_NOW_S, True),
        # a reference that has lost its points
        (150, 0, 100, LONG_AGO_S, False),
        (0, 0, 1, JUST_NOW_S, True),
    ],
)
def test_what_the_next_frame_would_see_and_the_budget_decide(
    inliers: int, reference: int, frames: int, seconds: float, expected: bool
) -> None:
    assert wants_keyframe(evidence(inliers, reference, frames, seconds)) == expected


@pytest.mark.parametrize("features", [500, 1000, 2000])
def test_a_thin_reference_counts_as_a_full_one_for_the_features_there_are(features: int) -> None:
    """A full reference has 2/15 of the features; of these, 0.122 are 0.91 of it, 0.118 are 0.885, 0.104 are 0.78."""
    enough, few, too_few = (int(share * features) for share in (0.122, 0.118, 0.104))
    assert not wants_keyframe(evidence(enough, enough // 2, 100, LONG_AGO_S, features))
    assert wants_keyframe(evidence(few, few // 2, 100, LONG_AGO_S, features))
    assert not wants_keyframe(evidence(few, few // 2, 1, JUST_NOW_S, features))
    assert wants_keyframe(evidence(too_few, too_few // 2, 1, JUST_NOW_S, features))


@pytest.mark.parametrize(("map_keyframes", "expected"), [(2, True), (3, False), (50, False)])
def test_points_that_too_few_keyframes_see_do_not_count_but_in_a_young_map(map_keyframes: int, expected: bool) -> None:
    """190 inliers are all of 190 points, and 0.5 of 380: the 190 that two keyframes see count while there are two."""
    seen = evidence(190, 190, 1, JUST_NOW_S, map_keyframes=map_keyframes, seldom_seen=190)
    assert wants_keyframe(seen) == expected


@pytest.mark.parametrize("rate_hz", [5.0, 10.0, 30.0, 120.0])
@pytest.mark.parametrize(("loss", "expected"), [(0.05, 8), (0.09, 4), (0.14, 2), (0.19, 2), (0.21, 1), (0.5, 1)])
def test_needed_keyframes_come_as_fast_as_the_view_changes_at_any_rate(
    loss: float, expected: int, rate_hz: float
) -> None:
    """Frames to the first keyframe where every frame loses an equal share: as many, at most, at every rate."""
    gap = next(
        n for n in range(1, 100) if wants_keyframe(evidence(round(1e4 * (1.0 - loss * n)), 10_000, n, n / rate_hz))
    )
    assert gap == expected if rate_hz == 120.0 else gap <= expected
