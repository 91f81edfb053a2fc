"""Quantities on the command line of `codecbench choose`."""

from __future__ import annotations

from pathlib import Path

import click
import pytest
from click.testing import CliRunner

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
