"""The checks find what is wrong with broken codecs of each shape, and nothing else."""

from __future__ import annotations

from typing import Any

import broken_codecs
import broken_features
import broken_streams
import numpy as np
import pytest
from codecbench_corners.codec import Corners

from codecbench.core.conformance import damage
from codecbench.core.conformance.harness import Check, Shape, shape_of
from codecbench.core.conformance.suite import CHECKS, checks_of, films_of, run_checks
from codecbench.core.contracts.image import LAYOUTS, Layout, layout_of
from codecbench.plugins.codecs.raw import Raw
from codecbench.pytesting import CodecSuite

CHECK = {check.name: check for check in CHECKS}
SOUND: dict[Shape, Any] = {"pictures": Raw, "stream": broken_streams.Delta, "features": Corners}
DEFECTS = {**broken_codecs.BROKEN, **broken_streams.BROKEN, **broken_features.BROKEN}


@pytest.mark.parametrize(
    ("codec_class", "check"),
    [
        pytest.param(
            codec_class,
            check,
            id=f"{codec_class.__name__}-{check}",
            marks=[pytest.mark.thorough] if codec_class is broken_codecs.Hangs else [],
        )
        for codec_class, check in DEFECTS.items()
    ],
)
def test_a_broken_codec_is_caught(codec_class: Any, check: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(damage, "_TIMEOUT_S", 1.0 if codec_class is broken_codecs.Hangs else 300.0)
    setting = {"offset": 3} if shape_of(codec_class) == "pictures" else {}
    results = run_checks(codec_class, codec_class.params_type(**setting), [CHECK[check]])
    assert {result.status for result in results} == {"failed"}, results
    raised = [result.reason for result in results if result.reason.startswith("raised ")]
    assert all(reason.startswith("raised Unsupported") for reason in raised), raised


@pytest.mark.parametrize(
    ("shape", "check"),
    [
        pytest.param(shape, check, id=f"{shape}-{check.name}",
                     marks=[pytest.mark.thorough] if shape == "features" else [])
        for shape in SOUND for check in checks_of(shape)
    ],
)  # fmt: skip
def test_a_sound_codec_passes_every_check(shape: Shape, check: Check) -> None:
    codec_class = SOUND[shape]
    for setting in codec_class.examples:
        results = run_checks(codec_class, codec_class.params_type(**setting), [check])
        unclaimed = {"pictures": "partial", "stream": "", "features": "threads"}[shape]
        expected = "skipped" if check.name == unclaimed else "passed"
        assert [result for result in results if result.status != expected] == []


def test_a_crash_is_told_as_one() -> None:
    (result, *_) = run_checks(broken_codecs.Crashes, broken_codecs.OffsetParams(), [CHECK["foreign"]])
    assert "crashed" in str(result)
    assert str(result).startswith("FAILED foreign (gray)")


@pytest.mark.parametrize("shape", SOUND)
def test_the_shape_of_a_codec_chooses_its_checks_and_the_tests_of_its_suite(shape: Shape) -> None:
    suite: Any = type("Suite", (CodecSuite,), {"codec": SOUND[shape]})
    names = {name for name in dir(suite) if name.startswith("test_") and callable(getattr(suite, name))}
    assert names == {f"test_{check.name}" for check in checks_of(shape)}


@pytest.mark.parametrize(
    ("shape", "layout"),
    [(shape, layout) for shape in SOUND for layout in LAYOUTS if shape != "features" or layout.bits == 8],
)
def test_films_are_the_same_everywhere_and_move(shape: Shape, layout: Layout) -> None:
    for film, again in zip(films_of(shape, layout), films_of(shape, layout), strict=True):
        assert film.name == again.name
        assert len(film.pictures) == {"pictures": 1, "stream": 14, "features": 8}[shape]
        for picture, other in zip(film.pictures, again.pictures, strict=True):
            assert np.array_equal(picture, other)
            assert layout_of(picture) == layout
        assert shape == "pictures" or not np.array_equal(film.pictures[0], film.pictures[1])


def test_films_for_features_have_corners_but_for_the_last_picture() -> None:
    codec = Corners.create()
    counts = [len(codec.extract(picture)) for film in films_of("features", Layout(1)) for picture in film.pictures]
    assert min(counts[:-1]) > 50
    assert counts[-1] == 0
