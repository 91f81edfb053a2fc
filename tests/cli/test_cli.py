"""Every command, as a user types it, on the smallest plugins."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest
from distributions import register
from project import ROOT, SUPPORT

import codecbench
from codecbench.cli import COMMANDS

MATRIX = """
version: 1
name: tiny
sequences: [{use: ramp, params: {frames: 4}}]
codecs:
  - {use: shift, params: {bits: {grid: [0, 3]}}}
  - absent
evaluators: [error, stopwatch]
run: {workers: 1}
"""


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a matrix, and a site with the smallest plugins."""
    folder = tmp_path_factory.mktemp("cli")
    (folder / "site").mkdir()
    shutil.copy(SUPPORT / "plain_plugins.py", folder / "site")
    register(folder / "site", "plain", "1", "plain_plugins")
    (folder / "tiny.yaml").write_text(MATRIX)
    return folder


def call(place: Path, *words: str, status: int = 0) -> str:
    """Standard output of a command, after checking its exit status."""
    environment = {**os.environ, "PYTHONPATH": str(place / "site"), "COLUMNS": "200"}
    command = [sys.executable, "-m", "codecbench", *words]
    done = subprocess.run(command, cwd=place, env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == status, done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    return done.stdout if status == 0 else done.stdout + done.stderr


@pytest.fixture(scope="module")
def run(place: Path) -> Path:
    """A finished run."""
    out = call(place, "run", "tiny.yaml")
    assert "cells: 6 ok, 3 unsupported" in out
    assert "run folder: runs/tiny" in out
    return place / "runs" / "tiny"


def test_a_second_run_keeps_everything(place: Path, run: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in (run / "records").glob("??/*/record.json")}
    assert "of them from before" in call(place, "run", "tiny.yaml", "--quiet")
    kept = {path: path.stat().st_mtime_ns for path in before}
    assert sum(before[path] == kept[path] for path in before) >= 6


def test_plan_says_what_is_there_and_what_cannot_be(place: Path, run: Path) -> None:
    out = call(place, "plan", "tiny.yaml", "--cells")
    assert "cells: 9: 6 done, 0 to do, 3 unsupported" in out
    assert "apt install libabsent" in out
    fresh = call(place, "plan", "tiny.yaml", "--out", "elsewhere")
    assert "coding jobs: 2, of which 0 are coded and 2 are to do" in fresh
    assert re.search(r"estimated time: about \d+ s", fresh)


def test_adding_an_evaluator_encodes_nothing(place: Path, run: Path) -> None:
    coded = {path: path.stat().st_mtime_ns for path in (run / "coded").iterdir()}
    (place / "more.yaml").write_text(MATRIX.replace("[error,", "[error, camera,"))
    out = call(place, "run", "more.yaml", "--out", "runs/tiny", "--quiet")
    assert "6 ok" in out
    assert {path: path.stat().st_mtime_ns for path in (run / "coded").iterdir()} == coded
    call(place, "run", "tiny.yaml", "--quiet")


@pytest.mark.parametrize("format_", ["text", "csv", "json", "markdown", "latex"])
@pytest.mark.parametrize("shape", ["--wide", "--tidy"])
def test_tables_in_every_format(place: Path, run: Path, shape: str, format_: str) -> None:
    out = call(place, "table", str(run), shape, "--format", format_)
    assert "shift" in out
    assert ("max_error" in out) or format_ in ("text", "latex")
    if format_ == "json":
        assert len(json.loads(out)) == (3 if shape == "--wide" else 15)


def test_tables_as_parquet_equal_those_from_python(place: Path, run: Path) -> None:
    call(place, "table", str(run), "--tidy", "--format", "parquet", "--out", "tidy.parquet")
    call(place, "table", str(run), "--format", "parquet", status=2)
    stored = pd.read_parquet(place / "tidy.parquet")
    opened = codecbench.open_run(run)
    assert stored["value"].equals(opened.tidy["value"])
    assert opened.wide["error.max_error.max"].dropna().tolist() == [0.0, 3.0] or opened.missing == 0


def test_columns_are_chosen_by_pattern(place: Path, run: Path) -> None:
    out = call(place, "table", str(run), "--format", "csv", "--columns", "error.*")
    assert out.splitlines()[0] == "sequence,codec,setting,error.max_error.max"
    assert "no column matches" in call(place, "table", str(run), "--columns", "quality.*", status=2)


@pytest.mark.thorough
def test_status_report_plot_and_compare(place: Path, run: Path) -> None:
    assert "tiny: not running; 9 cells: 6 ok, 3 unsupported" in call(place, "status", str(run))
    assert json.loads(call(place, "status", str(run), "--json"))["counts"]["ok"] == 6
    assert "report.html" in call(place, "report", str(run))
    assert "<html" in (run / "report" / "report.html").read_text()
    assert "| shift |" in Path(place, call(place, "report", str(run), "--format", "md").strip()).read_text()
    call(place, "plot", str(run))
    out = call(place, "compare", str(run), str(run))
    assert "same" in out
    call(place, "compare", str(run), "--save", "baseline.json")
    assert json.loads(call(place, "compare", "baseline.json", str(run), "--format", "json"))["counts"]["same"] >= 2


def test_schema_describes_what_is_installed(place: Path) -> None:
    whole = json.loads(call(place, "schema"))
    assert "shift" in json.dumps(whole["properties"]["codecs"])
    assert json.loads(call(place, "schema", "shift"))["properties"]["bits"]["maximum"] == 7
    assert "did you mean 'shift'" in call(place, "schema", "shfit", status=2)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["run", "nothing.yaml"], "no such file"),
        (["table", "nowhere"], "is not a run folder"),
        (["status", "nowhere"], "is not a run folder"),
        (["report", "nowhere"], "is not a run folder"),
        (["compare", "nowhere", "nowhere"], "neither a run folder nor a baseline"),
        (["rnu"], "Did you mean 'run'?"),
    ],
)
def test_bad_input_is_one_clear_message(place: Path, words: list[str], expected: str) -> None:
    assert expected in call(place, *words, status=2)


def test_every_command_is_documented_and_has_help(place: Path) -> None:
    page = (ROOT / "docs" / "commands.md").read_text()
    overview = call(place, "--help")
    for name in COMMANDS:
        text = call(place, name, "--help")
        assert f"## {name}" in page, name
        assert name in overview
        for option in set(re.findall(r"^  (--[a-z][a-z-]+)", text, re.MULTILINE)) - {"--help"}:
            assert option in page.split(f"## {name}")[1].split("\n## ")[0], f"{name} {option}"


def test_a_failing_cell_is_a_row_and_an_exit_status(place: Path) -> None:
    """The codec of this matrix cannot code frames that are wider than a byte can say."""
    (place / "site" / "failing.py").write_text(
        "from plain_plugins import *\n"
        "class Failing(Shift):\n"
        "    name = 'failing'\n"
        "    def decode(self, bitstream, *, trace=NULL_TRACE):\n"
        "        raise RuntimeError('broken on purpose')\n"
        "@hookimpl\n"
        "def codecbench_codecs():\n"
        "    return [PluginSpec('failing', 'failing:Failing', 'raises')]\n"
        "del codecbench_evaluators, codecbench_datasets\n"
    )
    register(place / "site", "failing", "1", "failing")
    (place / "failing.yaml").write_text(MATRIX.replace("  - absent", "  - failing"))
    out = call(place, "run", "failing.yaml", "--out", "runs/failing", status=1)
    assert "failed: ramp | failing | error #0: decode, frame 0: RuntimeError: broken on purpose" in out
    assert "cells: 1 failed, 8 ok" in out
    record = next((place / "runs" / "failing" / "records").glob("??/*/record.json")).parent.parent.parent
    assert any("Traceback" in path.read_text() for path in record.glob("??/*/record.json"))
