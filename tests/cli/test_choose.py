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
    with pytest.raises(click.BadParameter, match="positive number"):
        TIME(text)


def test_a_matrix_needs_a_link_and_a_demand(tmp_path: Path) -> None:
    matrix = tmp_path / "matrix.yaml"
    matrix.write_text("version: 1\n")
    for given, wanted in ((["--error", "5cm"], "--link"), (["--link", "lte"], "--deadline, --error or both")):
        result = CliRunner().invoke(choose, [str(matrix), *given])
        assert result.exit_code == 2
        assert wanted in result.output


def test_the_last_lines_recommend_a_setting_for_each_link_or_give_the_reason(
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
    assert_facts(title, "over ideal", "room-0.5", "0.5 m")
    assert heads.split()[:4] == ["codec", "setting", "Mbit/s", "error"]
    assert row.split()[:2] == ["jpeg", "quality=40"]
    assert row.split()[-3:] == ["4/4", "none", "tried"]
    assert_facts(slow, "over underwater_acoustic", " 0/4 ", " fails: ")
    assert_facts(
        use,
        "ideal use jpeg quality=40: ",
        " Mbit/s at 30 fps (",
        " GB/h)",
        "4 of 4 runs",
        "51 % at 95 %",
        "50 % required",
    )
    assert_facts(
        nothing, "Nothing passes", "underwater_acoustic", "1 of 1 ", "jpeg quality=40", "0.5 s at 0 %", "< 50 %"
    )


def assert_facts(line: str, *facts: str) -> None:
    assert [fact for fact in facts if fact not in line] == [], line
