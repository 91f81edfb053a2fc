"""Plugins that misbehave wherever codecbench runs them cost their own rows, and every other row is there and right.

The plugins, and what each may cost, are in `zoo/codecbench_zoo/cases.py`; distributions that misbehave as soon as they
are imported in `zoo/doors.py`. A few commands meet many of them at once, each command in a process of its own.
"""

from __future__ import annotations

import os
import subprocess
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import psutil
import pytest
from codecbench_zoo.cases import Case, cases
from distributions import install_source, install_zoo
from doors import DOORS, source
from warm_command import run_warm

from codecbench.core.engine.storage.samples import table_from_parquet
from codecbench.core.engine.storage.store import Store

pytestmark = pytest.mark.thorough

Rows = dict[tuple[str, str, str, str], tuple[Any, ...]]

MATRIX = """
version: 1
name: NAME
sequences: [{use: folder, name: drawn, params: {path: pictures, calibration: camera.yaml}}, SEQUENCES]
codecs: [CODECS]
evaluators: [quality, EVALUATORS]
run: {workers: 2, timeout_s: 30, memory_mb: 512}
"""
USUAL = "raw, png, {use: jpeg, params: {quality: {grid: [20, 70]}}}, "
BRIEF = "{use: jpeg, params: {quality: 70}}"
KINDS = {"codecs": "codec", "datasets": "dataset", "evaluators": "evaluator", "backends": "slam_backend"}
"""The runs, and the kind of plugin that each is about."""
OURS = {"codecs": 4, "datasets": 1, "evaluators": 1, "backends": 1}
"""How many rows of each run no plugin of another distribution takes part in."""


def names(kind: str) -> str:
    return ", ".join(case.name for case in cases(kind))


def matrix(name: str) -> str:
    backends = ", ".join(f"{{use: trajectory, params: {{backend: {case.name}}}}}" for case in cases("slam_backend"))
    parts = {
        "alone": ("", USUAL, ""),
        "doors": ("", USUAL, ""),
        "codecs": ("", USUAL + names("codec"), ""),
        "datasets": (names("dataset"), BRIEF, ""),
        "evaluators": ("", BRIEF, names("evaluator")),
        "backends": ("", BRIEF, backends),
    }[name]
    text = MATRIX.replace("NAME", name)
    for section, part in zip(("SEQUENCES", "CODECS", "EVALUATORS"), parts, strict=True):
        text = text.replace(section, part)
    return text


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder with three pictures, a camera, sites with hostile distributions, and a file of the user's."""
    folder = tmp_path_factory.mktemp("zoo")
    for site in ("zoo", "doors"):
        (folder / site).mkdir()
        install_zoo(folder / site)
    for name in DOORS:
        install_source(folder / "doors", f"door-{name.replace('_', '-')}", "1", source(name))
    (folder / "pictures").mkdir()
    rng = np.random.default_rng(3)
    for index in range(3):
        picture = cv2.GaussianBlur(rng.integers(0, 256, (96, 128), np.uint8), (9, 9), 2)
        cv2.imwrite(str(folder / "pictures" / f"{index}.png"), picture)
    (folder / "camera.yaml").write_text("width: 128\nheight: 96\nfx: 100\nfy: 100\ncx: 64\ncy: 48\n")
    (folder / "temporary").mkdir()
    for path in (folder, folder / "temporary"):
        (path / "thesis.tmp").write_text("years of work")
    yield folder
    for process in left_behind(folder):
        process.kill()


def call(place: Path, *words: str, site: str = "", **variables: str) -> subprocess.CompletedProcess[str]:
    """A command in a process of its own, where the distributions of a site are installed."""
    environment = {**os.environ, "COLUMNS": "400", "CODECBENCH_PLUGIN_TIMEOUT_S": "6", **variables}
    environment |= dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(place / "temporary"))
    environment["ZOO_PLACE"] = str(place)
    if site:
        environment["PYTHONPATH"] = str(place / site)
    return run_warm(words, place, environment, 900)


def run(place: Path, name: str, site: str = "", **variables: str) -> subprocess.CompletedProcess[str]:
    (place / f"{name}.yaml").write_text(matrix(name))
    return call(place, "run", f"{name}.yaml", "--quiet", site=site, **variables)


def left_behind(place: Path) -> list[psutil.Process]:
    """Processes that descend from a command of these tests."""
    found = []
    for process in psutil.process_iter():
        try:
            if process.environ().get("ZOO_PLACE") == str(place) and process.status() != psutil.STATUS_ZOMBIE:
                found.append(process)
        except psutil.Error:
            continue
    return found


def rows(place: Path, name: str) -> Rows:
    """What every cell of a run says, but for what differs between two runs of the same matrix."""
    store = Store(place / "runs" / name)
    found = {}
    for cell in store.read_plan().cells:
        record = store.read_record(cell.id)
        samples = store.samples(record)
        values = None if samples is None else str(table_from_parquet(samples).to_pylist())
        key = (cell.sequence.name, f"{cell.codec.name} {cell.codec.label}", cell.evaluator.title)
        plugins = (cell.sequence.dataset.name, cell.codec.name, cell.evaluator.name, *_backend(cell.evaluator.params))
        found[*key, ",".join(plugins)] = (
            record.status,
            record.reason,
            record.measurements,
            sorted(record.summaries.items()),
            values,
            record.traceback,
        )
    return found


def _backend(params: dict[str, Any]) -> list[str]:
    return [params["backend"]] if "backend" in params else []


@pytest.fixture(scope="module")
def alone(place: Path) -> Rows:
    """The rows of a run where no hostile distribution is installed."""
    done = run(place, "alone")
    assert done.returncode == 0, done.stderr
    found = rows(place, "alone")
    assert [row[0] for row in found.values()] == ["ok"] * 4
    return found


@pytest.fixture(scope="module")
def done(place: Path, alone: Rows) -> dict[str, subprocess.CompletedProcess[str]]:
    """What became of the commands that ran every plugin of the zoo, by the name of the run."""
    fingerprint = Store(place / "runs/alone").read_plan().sequences[0].fingerprint
    with ThreadPoolExecutor(2) as pool:
        waiting = {name: pool.submit(run, place, name, "zoo", ZOO_FINGERPRINT=fingerprint) for name in KINDS}
        return {name: future.result() for name, future in waiting.items()}


@pytest.fixture(scope="module")
def beside(place: Path, done: dict[str, Any]) -> dict[str, Rows]:
    """The rows of each run."""
    for name, command in done.items():
        assert (place / "runs" / name / "plan.json").exists(), command.stderr
    return {name: rows(place, name) for name in KINDS}


@pytest.mark.parametrize("name", KINDS)
def test_other_rows_are_identical_to_a_run_without_them(alone: Rows, beside: dict[str, Rows], name: str) -> None:
    ours = {key: row for key, row in beside[name].items() if key in alone}
    assert len(ours) == OURS[name]
    assert ours == {key: alone[key] for key in ours}


@pytest.mark.parametrize("name", KINDS)
def test_the_exit_status_says_that_cells_failed(done: dict[str, Any], name: str) -> None:
    assert done[name].returncode == 1
    assert "Traceback" not in done[name].stdout + done[name].stderr
    assert "\x1b[2J" not in done[name].stdout + done[name].stderr
    assert "hello from a codec" not in done[name].stdout + done[name].stderr


@pytest.mark.parametrize(
    ("name", "case"),
    [pytest.param(name, case, id=f"{kind}-{case.name}") for name, kind in KINDS.items() for case in cases(kind)],
)
def test_a_plugin_costs_its_own_rows(beside: dict[str, Rows], name: str, case: Case) -> None:
    found = [row for key, row in beside[name].items() if case.name in key[-1].split(",")]
    assert len(found) == 1
    status, reason, *_, traceback = found[0]
    assert (status, case.words in reason) == (case.status, True), reason
    assert status == "ok" or case.title in reason
    assert status != "failed" or traceback


def test_a_crash_says_where_it_was(beside: dict[str, Rows]) -> None:
    (traceback,) = (row[-1] for key, row in beside["codecs"].items() if key[-1].split(",")[1] == "segfaults")
    assert "zoo/encoding.py" in traceback


@pytest.mark.parametrize("name", KINDS)
def test_tables_are_made(place: Path, done: dict[str, Any], name: str) -> None:
    table = call(place, "table", f"runs/{name}", "--all", site="zoo")
    assert table.returncode == 0, table.stderr
    assert "Traceback" not in table.stdout + table.stderr
    assert "\x1b[2J" not in table.stdout + table.stderr
    assert "drawn" in table.stdout


@pytest.mark.parametrize("name", ["codecs", "evaluators"])
def test_reports_are_made(place: Path, done: dict[str, Any], name: str) -> None:
    report = call(place, "report", f"runs/{name}", site="zoo")
    assert report.returncode == 0, report.stderr
    assert "Traceback" not in report.stdout + report.stderr
    page = (place / "runs" / name / "report" / "report.html").read_text()
    assert "\x1b" not in page
    assert len(page) < 6_000_000


def test_an_executor_that_is_none_is_refused_by_name(place: Path) -> None:
    (place / "executor.yaml").write_text(matrix("alone").replace("workers: 2", "executor: unexecuted, workers: 2"))
    refused = call(place, "run", "executor.yaml", site="zoo")
    assert refused.returncode == 2
    (case,) = cases("executor")
    assert case.title in refused.stderr
    assert case.words in refused.stderr


@pytest.fixture(scope="module")
def listed(place: Path) -> subprocess.CompletedProcess[str]:
    return call(place, "list", site="doors")


def test_listing_goes_on(listed: subprocess.CompletedProcess[str]) -> None:
    assert listed.returncode == 0
    assert "  jpeg " in listed.stdout
    assert "hello from a door" not in listed.stdout + listed.stderr
    assert "\x1b" not in listed.stdout + listed.stderr


@pytest.mark.parametrize("name", DOORS)
def test_a_door_that_does_not_open_is_named_with_the_reason(listed: Any, name: str) -> None:
    said = [
        line for line in listed.stderr.splitlines() if line.startswith(f"problem: door-{name.replace('_', '-')} 1 ")
    ]
    words = DOORS[name][1]
    assert [words in line for line in said] == ([True] if words else [])
    assert (f"  door_{name} " in listed.stdout) == (not words)


def test_doors_change_no_row(place: Path, alone: Rows) -> None:
    opened = run(place, "doors", site="doors")
    assert opened.returncode == 0
    assert "out: door-exits 1" in opened.stderr
    assert rows(place, "doors") == alone


def test_files_of_the_user_are_there(place: Path, done: dict[str, Any]) -> None:
    """By now tables, reports and listings were made, too."""
    for path in (place, place / "temporary"):
        assert (path / "thesis.tmp").read_text() == "years of work"


def test_no_process_is_left(place: Path, done: dict[str, Any], listed: Any) -> None:
    deadline = time.monotonic() + 20
    while (left := left_behind(place)) and time.monotonic() < deadline:
        time.sleep(0.5)
    assert left == []
