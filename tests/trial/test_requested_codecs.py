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
        ("jpeg:,", "write NAME"),
        ("jpeg:quality=", "'quality='"),
        ("jpeg:5,10", "'10'"),
        ("jpeg:5..90/1", "1 steps; 2 to 100"),
        ("jpeg:1.2.3..9", "not a range"),
        ("raw:5", "no numeric parameter"),
    ],
)
def test_other_spellings_are_errors(text: str, words: str | None) -> None:
    if words is None:
        assert parse_codec(installed(), text).values == {}
        return
    with pytest.raises(ParamsError, match=words):
        parse_codec(installed(), text)


def test_an_unknown_codec_gets_the_nearest_as_a_suggestion() -> None:
    with pytest.raises(PluginError, match="'jpeg'"):
        parse_codec(installed(), "jpg:5..90")


@pytest.mark.parametrize(
    ("text", "facts"),
    [
        ("jpeg:quality=500", ["quality: ", " 100; got 500"]),
        ("jpeg:5..200", ["quality: ", " 100; got 200"]),
        ("jpeg:-5..50", ["quality: ", " 1; got -5"]),
        ("jpeg:5,subsampling=444|433", ["subsampling: ", "'422'", "; got '433'"]),
        ("jpeg:nosuch=1", ["nosuch: ", "quality, subsampling, optimize"]),
        ("jpeg2000:ratio=8,psnr_db=30", ["ratio, psnr_db, lossless"]),
    ],
)
def test_an_error_quotes_the_option_and_not_the_matrix_made_from_it(text: str, facts: list[str]) -> None:
    with pytest.raises(ParamsError) as caught:
        parse_codec(installed(), text)
    message = str(caught.value)
    assert message.startswith(f"--codec {text}: ")
    assert [fact for fact in facts if fact not in message] == []
