"""Plugins that misbehave wherever codecbench runs them cost their own rows, and every other row is there and right."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from distributions import install_source, install_zoo

from codecbench.core.engine.storage.samples import table_from_parquet
from codecbench.core.engine.storage.store import Store

pytestmark = pytest.mark.thorough

OURS = """
version: 1
name: NAME
sequences: [{use: folder, name: drawn, params: {path: pictures}}SEQUENCES]
codecs: [raw, {use: jpeg, params: {quality: {grid: [20, 70]}}}CODECS]
evaluators: [qualityEVALUATORS]
run: {workers: 2, timeout_s: 60}
"""
CODECS = {
    "exits": "codec exits of codecbench-zoo 1.0: SystemExit: 0",
    "leaves": "codec leaves of codecbench-zoo 1.0: it ended its process with status 0",
    "raises": "codec raises of codecbench-zoo 1.0: KeyboardInterrupt: as if somebody had pressed it",
    "hangs": "codec hangs of codecbench-zoo 1.0: no answer within 6 s",
    "vague": "codec vague of codecbench-zoo 1.0: codecbench_zoo.codecs:Vague has no class attribute 'capabilities'",
    "odd": "codec odd of codecbench-zoo 1.0: Odd.version is 2.5; it is a string",
    "gone": "codec gone of codecbench-zoo 1.0: codecbench_zoo.gone does not import",
    "exiting": "codec exiting of codecbench-zoo 1.0: SystemExit: 0",
    "unheard": "no codec is called 'unheard'; it may be of broken-door 1 (entry point codecbench): ",
    "cleans": "",
    "printed": "",
    "rounds": "code of codecbench-zoo 1.0 changed what evaluator",
    "patches": "code of codecbench-zoo 1.0 replaced numpy.mean",
    "shadows": "code of codecbench-zoo 1.0 replaced cv2.GaussianBlur",
}
DATASETS = {
    "broken": "dataset broken of codecbench-zoo 1.0: KeyError: 'not there'",
    "abandoned": "dataset abandoned of codecbench-zoo 1.0: it ended its process with status 3",
    "nameless": "dataset nameless of codecbench-zoo 1.0: AttributeError",
}
EVALUATORS = {
    "comparing": "",
    "quitting": "",
    "uncertain": "evaluator uncertain of codecbench-zoo 1.0: RuntimeError: it depends",
}


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with three pictures, a site with hostile distributions, and a file of the user's."""
    folder = tmp_path_factory.mktemp("zoo")
    site = folder / "site"
    site.mkdir()
    install_zoo(site)
    install_source(site, "broken-door", "1", "import sys\nsys.exit(0)\n")
    install_source(site, "locked-door", "1", "import os\nos._exit(0)\n")
    (folder / "pictures").mkdir()
    rng = np.random.default_rng(3)
    for index in range(3):
        picture = cv2.GaussianBlur(rng.integers(0, 256, (96, 128), np.uint8), (9, 9), 2)
        cv2.imwrite(str(folder / "pictures" / f"{index}.png"), picture)
    (folder / "thesis.tmp").write_text("years of work")
    return folder


def call(place: Path, *words: str, site: bool = True) -> subprocess.CompletedProcess[str]:
    """A command in a process of its own, with or without the hostile distributions."""
    environment = {**os.environ, "COLUMNS": "400", "CODECBENCH_PLUGIN_TIMEOUT_S": "6"}
    if site:
        environment["PYTHONPATH"] = str(place / "site")
    command = [sys.executable, "-m", "codecbench", *words]
    return subprocess.run(command, cwd=place, env=environment, capture_output=True, text=True, timeout=500)


def run(place: Path, name: str, sequences: str = "", codecs: str = "", evaluators: str = "", site: bool = True) -> None:
    text = OURS.replace("NAME", name).replace("SEQUENCES", sequences)
    (place / f"{name}.yaml").write_text(text.replace("CODECS", codecs).replace("EVALUATORS", evaluators))
    done = call(place, "run", f"{name}.yaml", "--quiet", site=site)
    assert "Traceback" not in done.stdout + done.stderr
    assert (place / "runs" / name / "plan.json").exists(), done.stdout + done.stderr


def rows(place: Path, name: str) -> dict[tuple[str, ...], tuple[Any, ...]]:
    """What every cell of a run says, but for what differs between two runs of the same matrix."""
    store = Store(place / "runs" / name)
    found = {}
    for cell in store.read_plan().cells:
        record = store.read_record(cell.id)
        samples = store.samples(record)
        values = None if samples is None else str(table_from_parquet(samples).to_pylist())
        key = (cell.sequence.name, cell.codec.name, cell.codec.label, cell.evaluator.name)
        found[key] = (record.status, record.reason, record.measurements, sorted(record.summaries.items()), values)
    return found


@pytest.fixture(scope="module")
def alone(place: Path) -> dict[tuple[str, ...], tuple[Any, ...]]:
    """The rows of a run where no hostile distribution is installed."""
    run(place, "alone", site=False)
    return rows(place, "alone")


@pytest.fixture(scope="module")
def beside(place: Path) -> dict[tuple[str, ...], tuple[Any, ...]]:
    """The rows of a run with everything hostile in it."""
    run(place, "beside", *(", " + ", ".join(names) for names in (DATASETS, CODECS, EVALUATORS)))
    return rows(place, "beside")


def test_listing_names_what_is_broken_and_goes_on(place: Path) -> None:
    done = call(place, "list")
    assert done.returncode == 0
    assert re.search(r"problem: broken-door 1 \(entry point codecbench\): .*SystemExit: 0", done.stderr)
    assert re.search(
        r"problem: locked-door 1 \(entry point codecbench\): .*ended its process with status 0", done.stderr
    )
    assert "  jpeg " in done.stdout
    assert "  patches " in done.stdout


def test_other_rows_are_identical_to_a_run_without_it(alone: dict[Any, Any], beside: dict[Any, Any]) -> None:
    assert len(alone) == 3
    assert {status for status, *_ in alone.values()} == {"ok"}
    assert {key: beside[key] for key in alone} == alone


@pytest.mark.parametrize("codec", CODECS)
def test_a_codec_costs_its_rows(beside: dict[Any, Any], codec: str) -> None:
    status, reason, *_ = beside["drawn", codec, "", "quality"]
    assert CODECS[codec] in reason
    assert (status == "ok") == (not CODECS[codec])


@pytest.mark.parametrize("dataset", DATASETS)
def test_a_dataset_costs_its_rows(beside: dict[Any, Any], dataset: str) -> None:
    status, reason, *_ = beside[dataset, "raw", "", "quality"]
    assert status == "unsupported"
    assert DATASETS[dataset] in reason


@pytest.mark.parametrize("evaluator", EVALUATORS)
def test_an_evaluator_costs_its_rows(beside: dict[Any, Any], evaluator: str) -> None:
    status, reason, *_ = beside["drawn", "raw", "", evaluator]
    assert EVALUATORS[evaluator] in reason
    assert (status == "ok") == (not EVALUATORS[evaluator])


def test_files_of_the_user_are_there(place: Path, beside: dict[Any, Any]) -> None:
    assert (place / "thesis.tmp").read_text() == "years of work"


def test_records_say_in_whose_company_they_were_made(place: Path, beside: dict[Any, Any]) -> None:
    store = Store(place / "runs" / "beside")
    for cell in store.read_plan().cells:
        record = store.read_record(cell.id)
        if record.status == "ok":
            hostile = cell.codec.name in CODECS or cell.evaluator.name in EVALUATORS
            assert record.worker["company"] == (["codecbench-zoo 1.0"] if hostile else [])


@pytest.mark.parametrize("words", [("table",), ("report",), ("plan",)], ids=lambda words: words[0])
def test_tables_and_reports_are_made_without_the_comparisons(place: Path, beside: dict[Any, Any], words: Any) -> None:
    done = call(place, *words, "beside.yaml" if words == ("plan",) else "runs/beside")
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stdout + done.stderr
    assert "hello from a codec" not in done.stdout + done.stderr
