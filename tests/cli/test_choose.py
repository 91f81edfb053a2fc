"""The command line of `codecbench choose`, and its last line."""

from __future__ import annotations

from pathlib import Path

import click
import pytest
from click.testing import CliRunner

import codecbench
from codecbench.cli.choose import choose, quantity

TIME = quantity({"ms": 1.0, "s": 1000.0})


@pytest.mark.parametrize(("text", "value_ms"), [("100ms", 100.0), ("0.2s", 200.0), (".5 s", 500.0), ("3s", 3000.0)])
def test_a_quantity_is_a_number_with_a_unit(text: str, value_ms: float) -> None:
    assert TIME(text) == pytest.approx(value_ms)


@pytest.mark.parametrize("text", ["100", "ms", "-5ms", "0ms", "5m", "1e3ms", "five ms"])
def test_anything_else_is_refused(text: str) -> None:
    with pytest.raises(click.BadParameter, match="is not a positive number with one of ms, s"):
        TIME(text)


def test_of_a_matrix_a_link_and_something_else_must_be_asked(tmp_path: Path) -> None:
    matrix = tmp_path / "matrix.yaml"
    matrix.write_text("version: 1\n")
    for given, wanted in ((["--error", "5cm"], "--link"), (["--link", "lte"], "--deadline, --error or both")):
        result = CliRunner().invoke(choose, [str(matrix), *given])
        assert result.exit_code == 2
        assert wanted in result.output


def test_the_last_line_says_what_to_use_over_each_link_or_why_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A room over a link that changes nothing, and over one that lets hardly a frame through."""
    monkeypatch.delenv("COLUMNS", raising=False)
    links = {"grid": ["ideal", "underwater_acoustic"]}
    room = {"world": "room", "frames": 60, "width": 320, "height": 240}
    matrix = {
        "version": 1,
        "sequences": [{"use": "synthetic", "params": room}],
        "codecs": [{"use": "jpeg", "params": {"quality": 40}}],
        "evaluators": [
            {"use": "stream", "params": {"joins": 0}},
            {"use": "trajectory", "params": {"link": links, "start_offsets": [0, 1, 2, 3]}},
        ],
    }
    codecbench.run(matrix, out=tmp_path / "run", workers=1)
    result = CliRunner().invoke(choose, [str(tmp_path / "run"), "--error", "50cm"])
    assert result.exit_code == 0, result.output
    *tables, use, nothing = result.stdout.splitlines()
    ideal, slow = "\n".join(tables).rstrip().split("\n\n")
    title, heads, row = ideal.splitlines()
    assert title == "The pick of each codec over ideal, room-0.5, an error of at most 0.5 m"
    assert heads.split()[:4] == ["codec", "setting", "Mbit/s", "error"]
    assert row.split()[:2] == ["jpeg", "quality=40"]
    assert row.split()[-3:] == ["4/4", "none", "tried"]
    assert slow.startswith("The pick of each codec over underwater_acoustic, room-0.5, an error of at most 0.5 m")
    assert " 0/4 " in slow
    assert " fails: " in slow
    assert use.startswith("Over ideal use jpeg quality=40: ")
    assert " Mbit/s at 30 fps (" in use
    assert " GB/h); passes in 4 of 4 runs (at least 51 % at 95 %): error 0." in use
    assert use.endswith(" of capture times (50 % required).")
    assert nothing == (
        "Nothing passes over underwater_acoustic, because 1 of 1 settings have too few fresh poses, such as "
        "jpeg quality=40 (a pose no older than 0.5 s at 0 % of capture times < 50 %)."
    )
