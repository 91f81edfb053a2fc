from __future__ import annotations

import numpy as np
import pytest

from codecbench.slam.tracking.keyframe_policy import KeyframeEvidence, wants_keyframe

FEATURES = 1000


def evidence(
    inliers: int,
    reference: int,
    since: int,
    features: int = FEATURES,
    map_keyframes: int = 20,
    seldom_seen: int = 0,
    parallax: float = 0.1,
) -> KeyframeEvidence:
    """`reference` points that three keyframes see, and `seldom_seen` that two do."""
    observations = np.r_[np.full(reference, 3), np.full(seldom_seen, 2)]
    return KeyframeEvidence(inliers, features, observations, map_keyframes, since, parallax)


@pytest.mark.parametrize(
    ("inliers", "reference", "since", "expected"),
    [
        # a frame that still sees 0.9 of its reference's points is not welcome, however long ago the last keyframe was
        (180, 200, 100, False),
        (179, 200, 100, True),
        (250, 200, 100, False),
        # below that, four frames pay for a keyframe
        (179, 200, 3, False),
        (179, 200, 4, True),
        # 0.145 lost in a frame leaves the next one 0.71; 0.155 leaves it less than 0.7
        (171, 200, 1, False),
        (169, 200, 1, True),
        # the same loss in three frames is slower: there, 0.225 is the most
        (169, 200, 3, False),
        (156, 200, 3, False),
        (154, 200, 3, True),
        # a reference that has lost its points
        (150, 0, 100, False),
        (0, 0, 1, True),
    ],
)
def test_what_the_next_frame_would_see_decides(inliers: int, reference: int, since: int, expected: bool) -> None:
    assert wants_keyframe(evidence(inliers, reference, since)) == expected


@pytest.mark.parametrize("features", [500, 1000, 2000])
def test_a_thin_reference_counts_as_a_full_one_for_the_features_there_are(features: int) -> None:
    """A full reference has 2/15 of the features; of these, 0.121 are 0.91 of it, 0.118 are 0.885, 0.11 are 0.825."""
    enough, few, too_few = (int(share * features) for share in (0.121, 0.118, 0.11))
    assert not wants_keyframe(evidence(enough + 1, enough // 2, 100, features))
    assert wants_keyframe(evidence(few, few // 2, 100, features))
    assert not wants_keyframe(evidence(few, few // 2, 1, features))
    assert wants_keyframe(evidence(too_few, too_few // 2, 1, features))


@pytest.mark.parametrize(("parallax", "expected"), [(0.0, False), (0.0199, False), (0.0201, True), (6.28, True)])
def test_a_thin_reference_asks_for_keyframes_only_where_they_could_add_points(parallax: float, expected: bool) -> None:
    """100 inliers are all of the reference's 100 points, and three quarters of a full one; a point at the median depth
    becomes a new one from 0.02 rad on, whose cosine is 0.9998."""
    assert wants_keyframe(evidence(100, 100, 1, parallax=parallax)) == expected


@pytest.mark.parametrize(("map_keyframes", "expected"), [(2, True), (3, False), (50, False)])
def test_points_that_too_few_keyframes_see_do_not_count_but_in_a_young_map(map_keyframes: int, expected: bool) -> None:
    """190 inliers are all of 190 points, and 0.5 of 380: the 190 that two keyframes see count while there are two."""
    assert wants_keyframe(evidence(190, 190, 1, map_keyframes=map_keyframes, seldom_seen=190)) == expected


@pytest.mark.parametrize(
    ("loss", "expected"),
    [(0.003, 34), (0.021, 5), (0.05, 4), (0.07, 4), (0.08, 3), (0.11, 2), (0.14, 2), (0.16, 1), (0.3, 1)],
)
def test_keyframes_come_as_fast_as_the_view_changes(loss: float, expected: int) -> None:
    """Frames between two keyframes where every frame loses an equal share: 0.1 is lost where the view changes slowly,
    and a frame is passed over only if the next will have lost at most 0.3."""
    gap = next(n for n in range(1, 100) if wants_keyframe(evidence(round(10_000 * (1.0 - loss * n)), 10_000, n)))
    assert gap == expected
