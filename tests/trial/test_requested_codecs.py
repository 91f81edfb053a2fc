"""Settings of codecs as they are written on a command line."""

from __future__ import annotations

from typing import Any

import pytest

from codecbench.core.contracts.errors import ParamsError, PluginError
from codecbench.core.engine.plugins.registry import installed
from codecbench.trial.requested_codecs import parse_codec


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("raw", {}),
        ("jpeg:10", {"quality": [10]}),
        ("jpeg:10|20|75", {"quality": [10, 20, 75]}),
        ("jpeg:60..80", {"quality": [60, 65, 70, 75, 80]}),
        ("jpeg:60..80/3", {"quality": [60, 70, 80]}),
        ("jpeg:quality=5..80/5,subsampling=444", {"quality": [5, 24, 42, 61, 80], "subsampling": ["444"]}),
        ("jpeg2000:8..128/5", {"ratio": [8, 16, 32, 64, 128]}),
        ("h264:crf=51..15/4", {"crf": [51, 39, 27, 15]}),
        ("jpegxl:0.5..4/4", {"distance": [0.5, 1.0, 2.0, 4.0]}),
        ("multilevel:5|20,levels=2", {"qf": [5, 20], "levels": [2]}),
        ("jpeg:optimize=true", {"optimize": [True]}),
    ],
)
def test_what_is_asked_for(text: str, values: dict[str, Any]) -> None:
    wanted = parse_codec(installed(), text)
    assert (wanted.name, wanted.values) == (text.partition(":")[0], values)


def test_a_range_of_one_parameter_can_be_searched() -> None:
    texts = ("jpeg:5..90", "jpeg:5|10", "jpeg:5", "jpeg:5..90,optimize=true", "jpeg:5..90,subsampling=444|420")
    assert [parse_codec(installed(), text).searched for text in texts] == [True, False, False, True, False]
    assert len(parse_codec(installed(), "jpeg:5..90", steps=15)) == 15


def test_the_settings_are_counted() -> None:
    assert len(parse_codec(installed(), "jpeg:5|10|20,subsampling=444|420")) == 6
    assert len(parse_codec(installed(), "raw")) == 1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("jpeg:", None),
        ("jpeg:,", "is not understood; write NAME"),
        ("jpeg:quality=", "is not understood"),
        ("jpeg:5,10", "is not understood"),
        ("jpeg:5..90/1", "1 steps; 2 to 100"),
        ("jpeg:1.2.3..9", "is no range"),
        ("raw:5", "no parameter that is a number"),
    ],
)
def test_other_spellings_are_answered_with_the_right_one(text: str, words: str | None) -> None:
    if words is None:
        assert parse_codec(installed(), text).values == {}
        return
    with pytest.raises(ParamsError, match=words):
        parse_codec(installed(), text)


def test_an_unknown_codec_is_answered_with_the_nearest() -> None:
    with pytest.raises(PluginError, match="did you mean 'jpeg'"):
        parse_codec(installed(), "jpg:5..90")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("jpeg:quality=500", "quality: Input should be less than or equal to 100; got 500"),
        ("jpeg:5..200", "quality: Input should be less than or equal to 100; got 200"),
        ("jpeg:-5..50", "quality: Input should be greater than or equal to 1; got -5"),
        ("jpeg:5,subsampling=444|433", "subsampling: Input should be '444', '422' or '420'; got '433'"),
        ("jpeg:nosuch=1", "nosuch: unknown; allowed: quality, subsampling, optimize, progressive, restart"),
        ("jpeg2000:ratio=8,psnr_db=30", "exactly one of ratio, psnr_db, lossless and cr_percent sets the rate, got "),
    ],
)
def test_values_that_a_codec_does_not_take_are_told_as_they_were_written(text: str, said: str) -> None:
    """And not by the line of a matrix that is made of them, which nobody has seen."""
    with pytest.raises(ParamsError) as caught:
        parse_codec(installed(), text)
    assert str(caught.value).startswith(f"--codec {text}: {said}")
