"""The checks find what is wrong with broken codecs with memory, and nothing else."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import broken_streams
import numpy as np
import pytest

from codecbench.core.conformance.moving_pictures import long_sequence, moving_pictures
from codecbench.core.conformance.suite import CHECKS, STREAM_CHECKS, run_checks
from codecbench.plugins.codecs.raw import Raw
from codecbench.pytesting import CodecSuite

CHECK = {check.name: check for check in STREAM_CHECKS}


@pytest.mark.parametrize(
    ("codec_class", "check"), broken_streams.BROKEN.items(), ids=lambda value: getattr(value, "__name__", value)
)
def test_a_broken_stream_is_caught(codec_class: Any, check: str) -> None:
    results = run_checks(codec_class, codec_class.params_type(), [CHECK[check]])
    assert {result.status for result in results} == {"failed"}, results
    assert not any(": raised" in str(result) for result in results), results


@pytest.mark.parametrize("check", STREAM_CHECKS, ids=lambda check: check.name)
def test_a_sound_stream_passes_every_check(check: Any) -> None:
    failures = [result for result in run_checks(broken_streams.Delta, broken_streams.Delta.params_type(), [check])
                if result.status != "passed"]  # fmt: skip
    assert failures == []


def test_the_shape_of_a_codec_chooses_its_checks() -> None:
    streams = run_checks(broken_streams.StartsWhereNoneIs, broken_streams.Delta.params_type())
    assert [result.check.name for result in streams] == [check.name for check in STREAM_CHECKS for _ in (1, 3)]
    assert [result.check.name for result in run_checks(Raw, Raw.params_type(), CHECKS[:1])] == ["params", "params"]


def test_the_suite_of_a_stream_has_its_tests_and_no_others() -> None:
    suite: Any = type("Suite", (CodecSuite,), {"codec": broken_streams.Delta})
    assert {name for name in dir(suite) if name.startswith("test_") and callable(getattr(suite, name))} == {
        f"test_{check.name}" for check in STREAM_CHECKS
    }
    still: Any = type("Suite", (CodecSuite,), {"codec": Raw})
    assert {name for name in dir(still) if name.startswith("test_") and callable(getattr(still, name))} == {
        f"test_{check.name}" for check in CHECKS
    }


def test_moving_pictures_are_the_same_everywhere_and_move() -> None:
    for channels in (1, 3):
        for sequence, again in zip(moving_pictures(channels), moving_pictures(channels), strict=True):
            assert sequence.name == again.name
            assert 12 <= len(sequence.pictures) <= 16
            for picture, other in zip(sequence.pictures, again.pictures, strict=True):
                assert np.array_equal(picture, other)
                assert picture.ndim == (2 if channels == 1 else 3)
                assert picture.flags.c_contiguous
            assert not np.array_equal(sequence.pictures[0], sequence.pictures[1])


@pytest.mark.parametrize("channels", [1, 3])
def test_the_long_sequence_moves_to_its_end(channels: int) -> None:
    pictures = long_sequence(channels).pictures
    assert len(pictures) > 100, "SVT-AV1 holds back 78 pictures"
    assert not any(np.array_equal(*pair) for pair in pairwise(pictures))
    assert pictures[0].shape == moving_pictures(channels)[-1].pictures[0].shape
