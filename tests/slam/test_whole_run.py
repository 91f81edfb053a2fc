"""The SLAM as its users meet it: through the installed command, the embedded sequence and a real one."""

from __future__ import annotations

import csv
import io
import os
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


def medians(folder: Path, *sequences: str) -> list[dict[str, float]]:
    """Medians of the trajectory's metrics on each sequence of a run, of those that are not missing."""
    (folder / "matrix.yaml").write_text(MATRIX.replace("synthetic", ", ".join(sequences)))
    assert f"cells: {len(sequences)} ok" in command(folder, "run", "matrix.yaml", "--quiet")
    rows = csv.DictReader(io.StringIO(command(folder, "table", "runs/whole", "--format", "csv")))
    known = [{name.removeprefix("trajectory."): value for name, value in row.items() if value} for row in rows]
    return [{name: float(value) for name, value in row.items() if name.endswith(".median")} for row in known]


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, float]]:
    """Two seconds of the room and, where there are real sequences, four of a street, in one run."""
    sequences = {"room": "{use: synthetic, params: {stop: 60}}"}
    if data := os.environ.get("CODECBENCH_DATA"):
        sequences["street"] = f"{{use: tum, params: {{path: '{data}/kitti00_half', start: 80, stop: 120}}}}"
    found = medians(tmp_path_factory.mktemp("short"), *sequences.values())
    return dict(zip(sequences, found, strict=True))


def test_two_seconds_of_the_room_are_tracked_to_two_millimetres(short: dict[str, dict[str, float]]) -> None:
    found = short["room"]
    assert found["tracked_fraction.median"] > 0.95
    assert found["times_lost.median"] == 0
    assert found["maps.median"] == 1
    assert found["ate_rmse_m.median"] < 0.002  # of a path of 1.35 m, of which a straight line is 0.074 m off


def test_four_seconds_of_a_street_are_tracked_to_half_a_percent(
    short: dict[str, dict[str, float]], request: pytest.FixtureRequest
) -> None:
    """18.3 m through a bend, of which a straight line is 1.28 m off.

    It asks for `data_folder` late: a test that names it is thorough, and this one is quick.
    """
    request.getfixturevalue("data_folder")
    found = short["street"]
    assert found["tracked_fraction.median"] > 0.9
    assert found["times_lost.median"] == 0
    assert found["ate_rmse_m.median"] < 0.005 * 18.3


@pytest.mark.thorough
def test_the_room_is_tracked_whole_and_its_loop_closed(tmp_path: Path) -> None:
    (found,) = medians(tmp_path, "synthetic")
    assert found["tracked_fraction.median"] > 0.95
    assert found["loops_closed.median"] >= 1
    assert found["maps.median"] == 1
    assert found["ate_rmse_m.median"] == pytest.approx(0.002, abs=0.002)
    assert found["ate_before_loops_m.median"] > found["ate_rmse_m.median"]


@pytest.mark.thorough
@pytest.mark.parametrize("stride", [2, 3])
def test_so_it_is_at_half_and_a_third_of_the_rate(tmp_path: Path, stride: int) -> None:
    sequence = f"{{use: synthetic, params: {{stride: {stride}}}}}"
    (found,) = medians(tmp_path, sequence)
    assert found["tracked_fraction.median"] > 0.95
    assert found["loops_closed.median"] >= 1
    assert found["maps.median"] == 1
    assert found["ate_rmse_m.median"] < 0.006
    assert found["ate_before_loops_m.median"] > found["ate_rmse_m.median"]
