"""The checks find what is wrong with broken codecs of features, and nothing else."""

from __future__ import annotations

from typing import Any

import broken_features
import pytest
from codecbench_corners.codec import Corners

from codecbench.core.conformance.moving_pictures import pictures_with_corners
from codecbench.core.conformance.suite import FEATURE_CHECKS, run_checks
from codecbench.pytesting import CodecSuite

CHECK = {check.name: check for check in FEATURE_CHECKS}
SLOW = ("bombs", "damaged")


@pytest.mark.parametrize(
    ("codec_class", "check"), broken_features.BROKEN.items(), ids=lambda value: getattr(value, "__name__", value)
)
def test_a_broken_codec_is_caught(codec_class: Any, check: str) -> None:
    results = run_checks(codec_class, codec_class.params_type(), [CHECK[check]])
    assert {result.status for result in results} == {"failed"}, results
    assert not any(": raised" in str(result) for result in results), results


@pytest.mark.parametrize(
    "check",
    [pytest.param(check, id=check.name, marks=[pytest.mark.thorough] if check.name in SLOW else [])
     for check in FEATURE_CHECKS],
)  # fmt: skip
@pytest.mark.parametrize("setting", Corners.examples, ids=str)
def test_a_sound_codec_passes_every_check(check: Any, setting: dict[str, Any]) -> None:
    results = run_checks(Corners, Corners.params_type(**setting), [check])
    expected = "skipped" if check.name == "threads" else "passed"
    assert [result for result in results if result.status != expected] == []


def test_the_suite_of_a_codec_of_features_has_its_tests_and_no_others() -> None:
    suite: Any = type("Suite", (CodecSuite,), {"codec": Corners})
    assert {name for name in dir(suite) if name.startswith("test_") and callable(getattr(suite, name))} == {
        f"test_{check.name}" for check in FEATURE_CHECKS
    }


def test_the_pictures_have_corners_but_for_the_last() -> None:
    codec = Corners.create()
    for channels in (1, 3):
        first, second = pictures_with_corners(channels)
        counts = [len(codec.extract(picture)) for picture in (*first.pictures, *second.pictures)]
        assert min(counts[:-1]) > 50
        assert counts[-1] == 0
