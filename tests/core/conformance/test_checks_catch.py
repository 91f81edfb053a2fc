"""The checks find what is wrong with broken codecs, and nothing else."""

from __future__ import annotations

from typing import Any

import broken_codecs
import pytest

from codecbench.core.conformance import robustness
from codecbench.core.conformance.images import conformance_images
from codecbench.core.conformance.suite import CHECKS, run_checks
from codecbench.plugins.codecs.raw import Raw

CAUGHT_BY = {
    "KeepsTheImage": "self_contained",
    "DecodesByItsParams": "self_contained",
    "Random": "stateless",
    "DiffersByProcess": "deterministic",
    "WritesIntoItsInput": "untouched",
    "LosesARow": "shape",
    "WrapsRound": "range",
    "ReturnsFloats": "shape",
    "PreparesAnotherSetting": "prepared",
    "IsChangedByPreparing": "prepared",
    "NotLossless": "lossless",
    "FillsWhatIsCut": "cut",
    "TripsOverForeignBytes": "foreign",
    "Crashes": "foreign",
    "Hangs": "bombs",
    "Allocates": "bombs",
    "SharesABuffer": "threads",
    "AcceptsAnything": "bad_images",
    "ClaimsToCount": "counting",
    "ForgetsAParameter": "params",
    "ClaimsTooMuchOfParts": "partial",
    "ClaimsPartsAndHasNone": "partial",
}
CHECK = {check.name: check for check in CHECKS}


@pytest.mark.parametrize(("codec", "check"), CAUGHT_BY.items())
def test_a_broken_codec_is_caught(codec: str, check: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(robustness, "_TIMEOUT_S", 2.0)
    codec_class: Any = getattr(broken_codecs, codec)
    results = run_checks(codec_class, codec_class.params_type(offset=3), [CHECK[check]])
    assert {result.status for result in results} == {"failed"}, results
    assert not any("raised NotImplementedError" in str(result) for result in results)


def test_a_sound_codec_passes_every_check() -> None:
    results = run_checks(Raw, Raw.params_type())
    assert [result for result in results if result.status == "failed"] == []
    assert {result.check.name for result in results if result.status == "skipped"} == {"partial"}


def test_a_crash_is_told_as_one() -> None:
    (result, *_) = run_checks(broken_codecs.Crashes, broken_codecs.OffsetParams(), [CHECK["foreign"]])
    assert "crashed" in str(result)
    assert str(result).startswith("FAILED foreign (gray)")


def test_conformance_images_are_the_same_everywhere() -> None:
    for channels in (1, 3):
        for image, again in zip(conformance_images(channels), conformance_images(channels), strict=True):
            assert image.name == again.name
            assert (image.pixels == again.pixels).all()
            assert image.pixels.ndim == (2 if channels == 1 else 3)
