"""Searches in whole runs: workers, kills, other executors, and what the commands say."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import distributions
import pytest
from click.testing import CliRunner
from engine_bench import HERE, plugins_in_process
from project import ROOT, SUPPORT
from search_plugins import Dial

import codecbench
from codecbench.cli import cli
from codecbench.core.engine.planning.matrix import read_matrix
from codecbench.core.engine.plugins.registry import installed
from codecbench.core.engine.running.progress import RunSummary
from codecbench.core.engine.storage.store import Store
from codecbench.core.rounds.running import plan_matrix, run_matrix

pytestmark = pytest.mark.thorough

ENTRY = "{use: dial, params: {level: {range: [0, 200]}%s}, at: {weight_bytes: 100}}"


@pytest.fixture
def place(tmp_path: Path) -> Iterator[Path]:
    site = tmp_path / "site"
    site.mkdir()
    distributions.register(site, "search", "1.0", "search_plugins")
    sys.path.insert(0, str(site))
    installed.cache_clear()
    yield tmp_path
    sys.path.remove(str(site))
    installed.cache_clear()


@pytest.fixture
def place_here(place: Path) -> Iterator[Path]:
    with plugins_in_process(place / "site"):
        yield place


def write(place: Path, codecs: str, evaluators: str = "scales", run: str = "workers: 2") -> Path:
    path = place / "matrix.yaml"
    path.write_text(f"version: 1\nsequences: [flat]\ncodecs: [{codecs}]\nevaluators: [{evaluators}]\nrun: {{{run}}}\n")
    return path


def run(path: Path) -> RunSummary:
    return run_matrix(read_matrix(path), path.parent / "run")


def test_times_that_are_measured_again_give_other_cells(tmp_path: Path) -> None:
    path = tmp_path / "matrix.yaml"
    path.write_text("""
version: 1
sequences: [{use: synthetic, params: {frames: 3, width: 64, height: 48}}]
codecs: [jpeg]
evaluators:
  - {use: timing, params: {frames: 1, repeats: 1, warmup: 1, min_ms: 0}}
  - {use: delivery, params: {encode_ms: measured, repeats: 2}}
run: {workers: 1}
""")
    summaries, inputs = [], []
    for recompute in ((), (), ("timing",)):
        summaries.append(run_matrix(read_matrix(path), tmp_path / "run", recompute=recompute))
        cells = Store(tmp_path / "run").read_plan().cells
        inputs.append({cell.id: cell.inputs["encode_ms"] for cell in cells if cell.inputs})
    assert [summary.statuses for summary in summaries] == [{"ok": 3}] * 3
    assert summaries[1].computed == 0
    assert inputs[0] == inputs[1]
    assert not inputs[0].keys() & inputs[2].keys()
    record = Store(tmp_path / "run").read_record(next(iter(inputs[2])))
    assert record.cell["inputs"] == {"encode_ms": next(iter(inputs[2].values()))}


def test_a_run_finds_what_is_sought_and_a_grid_takes_its_cells(place_here: Path) -> None:
    path = write(place_here, f"still, {ENTRY % ''}", "scales, {use: toss, params: {runs: 2}}", HERE)
    summary = run(path)
    result = codecbench.open_run(summary.folder)
    (found,) = result.plan.searches
    assert (found.setting, found.reached, found.state) == ("level=30", 100.0, "found")
    assert result.missing == 0
    assert summary.statuses == {"ok": len(result.plan.cells)}
    looked = {cell.codec.label for cell in result.plan.cells if cell.evaluator.name == "toss"}
    assert looked == {"", "level=30"}
    for row in result.wide.to_dict("records"):
        level = int(row["setting"].removeprefix("level=") or 0)
        assert row["scales.weight_bytes.mean"] == Dial.size_bytes(level)
    again = run(path)
    assert (again.computed, again.encoded, again.kept) == (0, 0, len(result.plan.cells))
    sweep = "still, {use: dial, params: {level: {grid: [30, 77]}}}"
    grid = run(write(place_here, sweep, "scales, {use: toss, params: {runs: 2}}", HERE))
    assert (grid.computed, grid.kept, grid.encoded) == (3, 6, 1)


def test_a_broken_trial_is_reported_and_nothing_else_is_lost(place_here: Path) -> None:
    path = write(place_here, f"{ENTRY % ', broken_from: 150'}, {ENTRY % ''}", run=HERE)
    printed = CliRunner().invoke(cli, ["run", str(path), "--out", str(place_here / "run")])
    assert printed.exit_code == 1
    text = " ".join(printed.output.split())
    assert "dial came off" in text
    assert re.search(r"^dial +flat0 +weight_bytes = 100 +stopped", printed.output, re.MULTILINE)
    broken, sound = codecbench.open_run(place_here / "run").plan.searches
    assert (broken.state, sound.setting) == ("stopped", "level=30")


def test_a_killed_search_goes_on_and_computes_nothing_twice(place: Path) -> None:
    path = write(place, ENTRY % ", pause_s: 0.1")
    folder, records = place / "run", place / "run" / "records"  # those being written have a dot before their name
    words = [sys.executable, str(SUPPORT / "run_driver.py"), str(path), str(folder), str(place / "site")]
    before: dict[str, str] = {}
    for wanted in (2, 4, 6):
        driver = subprocess.Popen(words, start_new_session=True)
        limit = time.monotonic() + 120
        while len(list(records.glob("??/[!.]*/record.json"))) < wanted:
            assert time.monotonic() < limit
            assert driver.poll() is None, "the run is over before it could be killed"
            time.sleep(0.01)
        os.killpg(driver.pid, signal.SIGKILL)
        driver.wait()
        status = CliRunner().invoke(cli, ["status", str(folder), "--json"])
        assert json.loads(status.output)["counts"]["ok"] >= wanted, "the plan of the folder has all that was tried"
        now = {record.parent.name: record.read_text() for record in records.glob("??/[!.]*/record.json")}
        assert before.items() <= now.items()
        before = now
    summary = run(path)
    assert summary.kept == len(before)
    (found,) = codecbench.open_run(folder).plan.searches
    assert found.setting == "level=30"
    assert found.trials == len(Store(folder).entries()) == summary.kept + summary.computed


def test_repeats_are_added_in_a_run(place_here: Path) -> None:
    toss = "{use: toss, params: {runs: 30, even_at_bytes: 100, steep: 0.2}}"
    sweep = "{use: dial, params: {level: {grid: [10, 30, 60]}}}"
    path = write(place_here, f"still, {sweep}", f"scales, {toss}", f"{HERE}, until: {{decided: caught}}")
    run(path)
    result = codecbench.open_run(place_here / "run")
    counts = {
        label: sum(cell.evaluator.name == "toss" for cell in result.plan.cells if cell.codec.label == label)
        for label in ("level=10", "level=30", "level=60")
    }
    assert counts["level=60"] == 8
    assert counts["level=10"] == 8
    assert counts["level=30"] > 8
    assert run(path).computed == 0


def test_clusters_search_too(place: Path) -> None:
    pytest.importorskip("distributed", reason="the extra codecbench[dask] is not installed")
    path = write(place, ENTRY % "", run="workers: 2, executor: dask")
    run(path)
    (found,) = codecbench.open_run(place / "run").plan.searches
    assert found.setting == "level=30"


def test_plan_and_rank_say_how_far_a_search_is(place_here: Path) -> None:
    path = write(place_here, ENTRY % "", run=HERE)
    call = CliRunner().invoke
    before = call(cli, ["plan", str(path), "--out", str(place_here / "run")])
    assert "cells: 2: 0 done" in before.output
    assert "weight_bytes = 100: 0 settings" in before.output
    run(path)
    assert "level=30 gives 100" in call(cli, ["plan", str(path), "--out", str(place_here / "run")]).output
    ranked = call(cli, ["rank", str(place_here / "run")])
    assert ranked.exit_code == 0
    assert re.search(r"^dial +flat0 +weight_bytes = 100 +found +level=30 +100\b", ranked.output, re.MULTILINE)
    assert "searches" in call(cli, ["rank", str(place_here / "run"), "--format", "markdown"]).output
    powered = call(cli, ["power", str(place_here / "run")])
    assert powered.exit_code == 0
    for words in (["report", str(place_here / "run")], ["table", str(place_here / "run")]):
        assert call(cli, words).exit_code == 0


def test_the_example_reaches_one_rate_with_every_codec(tmp_path: Path) -> None:
    matrix = read_matrix(ROOT / "examples" / "search.yaml")
    run_matrix(matrix, tmp_path / "run")
    plan, _, _ = plan_matrix(matrix, tmp_path / "run")
    for found in plan.searches:
        assert found.state in ("nearest", "found"), found
        if found.objective.startswith("rate_bpp"):
            assert found.reached == pytest.approx(0.5, rel=0.1)
        assert found.trials <= 9


def test_the_example_with_slam_finds_how_far_it_holds(tmp_path: Path) -> None:
    matrix = read_matrix(ROOT / "examples" / "search_slam.yaml")
    run_matrix(matrix, tmp_path / "run")
    result = codecbench.open_run(tmp_path / "run")
    holds, located = result.plan.searches
    assert (holds.state, holds.reached) == ("found", 1.0), holds
    assert located.state == "found", located
    assert located.reached is not None
    assert located.reached <= 5.0
    assert holds.trials <= 6, "two ends, and halves of ten settings"
    assert located.trials <= 9, "two ends, and halves of 95 settings"
    rows = {row["setting"]: row for row in result.wide.to_dict("records") if row["codec"] == "jpeg"}
    assert rows["quality=1"]["trajectory.success.mean"] < 1.0, "a setting breaks where raw frames do not"
    assert rows[holds.setting]["trajectory.success.mean"] == 1.0
    beside = f"quality={int(located.setting.removeprefix('quality=')) - 1}"
    assert rows[beside]["localization.tracked_position_to_raw_mm.median"] > 5.0
