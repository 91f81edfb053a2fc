"""Every command, as a user types it, on the smallest plugins."""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread

import pandas as pd
import pytest
from click.testing import CliRunner
from distributions import register
from project import ROOT, SUPPORT
from warm_command import run_warm

import codecbench
from codecbench.cli import COMMANDS, cli
from codecbench.cli.data import data
from codecbench.core.contracts.errors import DatasetError
from codecbench.plugins.datasets import catalog
from codecbench.plugins.datasets.catalog import DATASETS, CatalogEntry

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


def call(place: Path, *words: str, status: int = 0, **variables: str) -> str:
    """Standard output of a command, after checking its exit status."""
    environment = {**os.environ, "PYTHONPATH": str(place / "site"), "COLUMNS": "200", **variables}
    done = run_warm(words, place, environment)
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


@pytest.mark.thorough
def test_a_second_run_keeps_everything(place: Path, run: Path) -> None:
    before = {path: path.stat().st_mtime_ns for path in (run / "records").glob("??/*/record.json")}
    assert re.search(r"\d of them", call(place, "run", "tiny.yaml", "--quiet"))
    kept = {path: path.stat().st_mtime_ns for path in before}
    assert sum(before[path] == kept[path] for path in before) >= 6


@pytest.mark.thorough
def test_plan_says_what_is_there_and_what_cannot_be(place: Path, run: Path) -> None:
    out = call(place, "plan", "tiny.yaml", "--cells")
    assert "cells: 9: 6 done, 0 to do, 3 unsupported" in out
    assert "apt install libabsent" in out


@pytest.mark.thorough
def test_a_plan_elsewhere_says_how_long_it_will_take(place: Path, run: Path) -> None:
    fresh = call(place, "plan", "tiny.yaml", "--out", "elsewhere")
    assert "coding jobs: 2: 0 coded, 2 to do" in fresh
    assert re.search(r"estimated time: about \d+ s", fresh)


@pytest.mark.thorough
def test_adding_an_evaluator_encodes_nothing(place: Path, run: Path) -> None:
    coded = {path: path.stat().st_mtime_ns for path in (run / "coded").iterdir()}
    (place / "more.yaml").write_text(MATRIX.replace("[error,", "[error, camera,"))
    out = call(place, "run", "more.yaml", "--out", "runs/tiny", "--quiet")
    assert "6 ok" in out
    assert {path: path.stat().st_mtime_ns for path in (run / "coded").iterdir()} == coded
    call(place, "run", "tiny.yaml", "--quiet")


@pytest.mark.thorough
@pytest.mark.parametrize("shape", ["--wide", "--tidy"])
@pytest.mark.parametrize("format_", ["csv", "text", "json", "markdown", "latex"])
def test_tables_in_every_format(place: Path, run: Path, shape: str, format_: str) -> None:
    out = call(place, "table", str(run), shape, "--format", format_, *(["--all"] if format_ == "markdown" else []))
    assert "shift" in out
    assert ("max_error" in out) or format_ in ("text", "latex")
    if format_ == "json":
        assert len(json.loads(out)) == (3 if shape == "--wide" else 15)


@pytest.mark.thorough
def test_tables_as_parquet_equal_those_from_python(place: Path, run: Path) -> None:
    call(place, "table", str(run), "--tidy", "--format", "parquet", "--out", "tidy.parquet")
    call(place, "table", str(run), "--format", "parquet", status=2)
    stored = pd.read_parquet(place / "tidy.parquet")
    opened = codecbench.open_run(run)
    assert stored["value"].equals(opened.tidy["value"])
    assert opened.wide["error.max_error.max"].dropna().tolist() == [0.0, 3.0] or opened.missing == 0


@pytest.mark.thorough
def test_the_screen_shows_headlines_and_all_columns_when_asked(place: Path, run: Path) -> None:
    brief, every = call(place, "table", str(run)), call(place, "table", str(run), "--all")
    assert re.search(r"\d+ columns in all: --all", brief)
    assert "error.max_error.max" not in brief.replace("\n", ".")
    assert "max_error" in every
    assert "--all" not in every


@pytest.mark.thorough
def test_columns_are_chosen_by_pattern(place: Path, run: Path) -> None:
    out = call(place, "table", str(run), "--format", "csv", "--columns", "error.*")
    assert out.splitlines()[0] == "sequence,codec,setting,error.max_error.max"


@pytest.mark.thorough
def test_columns_that_there_are_not_are_refused(place: Path, run: Path) -> None:
    assert "no column matches" in call(place, "table", str(run), "--columns", "quality.*", status=2)


@pytest.mark.thorough
def test_status_report_plot_and_compare(place: Path, run: Path) -> None:
    assert "not running; 9 cells: 6 ok" in call(place, "status", str(run))
    assert json.loads(call(place, "status", str(run), "--json")) == {
        "name": "tiny", "running": False, "cells": 9, "counts": {"ok": 6, "unsupported": 3},
    }  # fmt: skip
    assert "report.html" in call(place, "report", str(run))
    assert "<html" in (run / "report" / "report.html").read_text()
    assert "| shift |" in Path(place, call(place, "report", str(run), "--format", "md").strip()).read_text()
    call(place, "plot", str(run))
    out = call(place, "compare", str(run), str(run))
    assert "same" in out
    call(place, "compare", str(run), "--save", "baseline.json")
    assert json.loads(call(place, "compare", "baseline.json", str(run), "--format", "json"))["counts"]["same"] >= 2


@pytest.mark.thorough
def test_schema_describes_what_is_installed(place: Path) -> None:
    whole = json.loads(call(place, "schema"))
    assert "shift" in json.dumps(whole["properties"]["codecs"])
    assert json.loads(call(place, "schema", "shift"))["properties"]["bits"]["maximum"] == 7
    assert "'shift'" in call(place, "schema", "shfit", status=2)


def test_data_lists_every_dataset_with_its_state_licence_and_citation(place: Path) -> None:
    (place / "cache" / "data" / "kodak").mkdir(parents=True)
    out = call(place, "data", "list", CODECBENCH_CACHE=str(place / "cache"), COLUMNS="300")
    blocks = re.split(r"^(?=\S)", out, flags=re.MULTILINE)[1:]
    assert [block.split()[0] for block in blocks] == [entry.name for entry in DATASETS]
    states = {}
    for block, entry in zip(blocks, DATASETS, strict=True):
        head, licence, citation = block.splitlines()
        assert licence.strip() == f"{entry.licence}; {entry.homepage}"
        assert citation.strip() == entry.citation
        assert head.endswith(f"sequence: use: {entry.kind}")
        states[entry.name] = re.search(r"\[(.*)\]", head)[1]  # type: ignore[index]
    assert (states["kodak"], states["kitti_odometry"]) == ("there", "by hand")
    sizes = [states[entry.name] for entry in DATASETS if entry.size_bytes and not entry.manual and not entry.is_there]
    assert sizes
    assert all(re.fullmatch(r"[\d,]+ MB", size) for size in sizes if size != "there")


@pytest.mark.thorough
def test_data_path_is_the_folder_of_what_was_fetched_and_says_how_to_fetch_the_rest(place: Path) -> None:
    cache = place / "other-cache"
    missing = call(place, "data", "path", "kodak", status=2, CODECBENCH_CACHE=str(cache))
    assert f"{cache / 'data' / 'kodak'}: " in missing
    assert "data fetch kodak" in missing
    (cache / "data" / "kodak").mkdir(parents=True)
    assert call(place, "data", "path", "kodak", CODECBENCH_CACHE=str(cache)) == f"{cache / 'data' / 'kodak'}\n"
    assert call(place, "data", "fetch", "kodak", CODECBENCH_CACHE=str(cache)) == f"{cache / 'data' / 'kodak'}\n"
    for command in ("path", "fetch"):
        assert re.search(r"'kodack'.* kodak\?", call(place, "data", command, "kodack", status=2))
    manual = call(place, "data", "fetch", "kitti_odometry", status=2, CODECBENCH_CACHE=str(cache))
    assert str(cache / "data" / "kitti_odometry") in manual
    assert "cvlibs.net" in manual


@pytest.fixture
def served(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ThreadingHTTPServer]:
    """A server on this machine whose two files are the only dataset of the catalogue."""
    source = tmp_path / "source"
    source.mkdir()
    (source / "a.png").write_bytes(b"first" * 1000)
    (source / "b.png").write_bytes(b"second")
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(SimpleHTTPRequestHandler, directory=str(source)))
    Thread(target=server.serve_forever, daemon=True).start()
    urls = tuple(f"http://127.0.0.1:{server.server_port}/{name}" for name in ("a.png", "b.png"))
    entry = CatalogEntry("tiny", "folder", "http://nowhere.example", "CC0", "Nobody, 2024", urls)
    monkeypatch.setattr(catalog, "DATASETS", (entry,))
    monkeypatch.setenv("CODECBENCH_CACHE", str(tmp_path / "cache"))
    for name in ("http_proxy", "HTTP_PROXY", "all_proxy", "ALL_PROXY"):
        monkeypatch.delenv(name, raising=False)
    yield server
    server.shutdown()
    server.server_close()


def test_data_fetch_brings_the_files_and_prints_only_their_folder(served: ThreadingHTTPServer, tmp_path: Path) -> None:
    folder = tmp_path / "cache" / "data" / "tiny"
    done = CliRunner().invoke(data, ["fetch", "tiny"])
    assert (done.exit_code, done.stdout) == (0, f"{folder}\n"), done.stderr
    assert "tiny: CC0\nNobody, 2024\n" in done.stderr
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == {"a.png": b"first" * 1000, "b.png": b"second"}
    served.shutdown()
    again = CliRunner().invoke(data, ["fetch", "tiny"])
    assert (again.exit_code, again.stdout) == (0, f"{folder}\n"), "what is there is not asked for again"


def test_data_fetch_refuses_files_that_are_not_those_of_the_first_fetch(
    served: ThreadingHTTPServer, tmp_path: Path
) -> None:
    assert CliRunner().invoke(data, ["fetch", "tiny"]).exit_code == 0
    shutil.rmtree(tmp_path / "cache" / "data" / "tiny")
    (tmp_path / "source" / "b.png").write_bytes(b"forged")
    done = CliRunner().invoke(data, ["fetch", "tiny"])
    assert isinstance(done.exception, DatasetError)
    assert re.search(r"b\.png: .*checksum", str(done.exception))
    assert not (tmp_path / "cache" / "data" / "tiny").exists()


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["run", "nothing.yaml"], "no such file"),
        *(
            pytest.param(words, expected, marks=pytest.mark.thorough)
            for words, expected in (
                (["table", "nowhere"], "not a run folder"),
                (["status", "nowhere"], "not a run folder"),
                (["report", "nowhere"], "not a run folder"),
                (["compare", "nowhere", "nowhere"], "nor a baseline"),
            )
        ),
        (["rnu"], "'run'?"),
    ],
)
def test_bad_input_is_one_clear_message(place: Path, words: list[str], expected: str) -> None:
    assert expected in call(place, *words, status=2)


def test_every_command_is_documented_and_has_help(place: Path) -> None:
    page = (ROOT / "docs" / "commands.md").read_text()
    overview = call(place, "--help")
    for name in COMMANDS:
        done = CliRunner().invoke(cli, [name, "--help"])
        assert done.exit_code == 0, done.output
        text = done.output
        assert f"## {name}" in page, name
        assert name in overview
        for option in set(re.findall(r"^  (--[a-z][a-z-]+)", text, re.MULTILINE)) - {"--help"}:
            assert option in page.split(f"\n## {name}\n")[1].split("\n## ")[0], f"{name} {option}"


@pytest.mark.thorough
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
    (place / "failing.yaml").write_text(MATRIX.replace("  - absent", "  - failing").replace(", stopwatch", ""))
    out = call(place, "run", "failing.yaml", "--out", "runs/failing", status=1)
    assert re.search(
        r"^failed: ramp \| failing \| error #0: .* decode, frame 0: RuntimeError: broken", out, re.MULTILINE
    )
    assert "cells: 1 failed, 2 ok" in out
    record = next((place / "runs" / "failing" / "records").glob("??/*/record.json")).parent.parent.parent
    assert any("Traceback" in path.read_text() for path in record.glob("??/*/record.json"))
