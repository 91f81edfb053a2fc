"""The SLAM as its users meet it: the whole embedded sequence, through the installed command."""

from __future__ import annotations

import csv
import io
import subprocess
import sys
from pathlib import Path

import pytest

MATRIX = """
version: 1
name: whole
sequences: [synthetic]
codecs: [raw]
evaluators: [trajectory]
run: {workers: 2}
"""


def command(folder: Path, *words: str) -> str:
    """Standard output of codecbench, after checking that it went well."""
    whole = [sys.executable, "-m", "codecbench", *words]
    done = subprocess.run(whole, cwd=folder, capture_output=True, text=True, timeout=500, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def medians(folder: Path, matrix: str) -> dict[str, float]:
    """Medians of the trajectory's metrics in the only row of a run, of those that are not missing."""
    (folder / "matrix.yaml").write_text(matrix)
    assert "cells: 1 ok" in command(folder, "run", "matrix.yaml", "--quiet")
    (row,) = csv.DictReader(io.StringIO(command(folder, "table", "runs/whole", "--format", "csv")))
    known = {name.removeprefix("trajectory."): value for name, value in row.items() if value}
    return {name: float(value) for name, value in known.items() if name.endswith(".median")}


@pytest.mark.thorough
def test_the_room_is_tracked_whole_and_its_loop_closed(tmp_path: Path) -> None:
    found = medians(tmp_path, MATRIX)
    assert found["tracked_fraction.median"] > 0.95
    assert found["loops_closed.median"] >= 1
    assert found["maps.median"] == 1
    assert found["ate_rmse_m.median"] == pytest.approx(0.002, abs=0.002)
    assert found["ate_before_loops_m.median"] > found["ate_rmse_m.median"]


@pytest.mark.parametrize("stride", [pytest.param(2, marks=pytest.mark.thorough), 3])
def test_so_it_is_at_half_and_a_third_of_the_rate(tmp_path: Path, stride: int) -> None:
    sequence = f"{{use: synthetic, params: {{stride: {stride}}}}}"
    found = medians(tmp_path, MATRIX.replace("synthetic", sequence))
    assert found["tracked_fraction.median"] > 0.95
    assert found["loops_closed.median"] >= 1
    assert found["maps.median"] == 1
    assert found["ate_rmse_m.median"] < 0.006
    assert found["ate_before_loops_m.median"] > found["ate_rmse_m.median"]
