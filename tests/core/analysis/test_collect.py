"""From a run folder to results: what is left out and said, what is compared, and what is missing with a reason."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import plain_plugins
import pytest

from codecbench.core.analysis.collect import open_run
from codecbench.core.analysis.run_result import RunResult
from codecbench.core.analysis.table import CellResult
from codecbench.core.contracts.errors import PluginError
from codecbench.core.contracts.evaluator import Measurement, Outcome
from codecbench.core.contracts.metric import Metric
from codecbench.core.contracts.view import Drawing
from codecbench.core.engine.planning.model import Cell, Plan, PluginSetting, RunSettings, SequenceEntry
from codecbench.core.engine.plugins.registry import Registry
from codecbench.core.engine.storage.record import Record
from codecbench.core.engine.storage.samples import parquet_from_samples
from codecbench.core.engine.storage.store import Store

DATASET = PluginSetting("dataset", "ramp", "1", {"frames": 3, "channels": 1, "camera": False, "broken": False})
SEQUENCES = tuple(SequenceEntry(name, DATASET, "f00d", 3, 1, False, False) for name in ("room", "hall"))
METRICS = (Metric("max_error", "1", "lower", ""), Metric("ratio", "1", "lower", "over the baseline's"))
EVALUATOR = PluginSetting("evaluator", "error", "1")
DECLARED = {"codecs": {"plain": {"reference": "baseline"}, "shift": {"reference": ""}}, "evaluators": {}}


def cell(number: int, codec: str, sequence: int = 0, repeat: int = 0, evaluator: PluginSetting = EVALUATOR) -> Cell:
    setting = PluginSetting("codec", codec, "1")
    return Cell(f"{number:032x}", SEQUENCES[sequence], setting, evaluator, repeat, 0, False, None)


CELLS = (
    cell(1, "plain"),
    cell(2, "plain", repeat=1),
    cell(3, "shift"),
    cell(4, "plain", sequence=1),
    cell(5, "shift", sequence=1),
)


def record(cell: Cell, value: float, status: Any = "ok") -> Record:
    measured = (Measurement("max_error", value),)
    return Record(
        cell.id, status, "" if status == "ok" else "why", measurements=measured, metrics=("max_error", "ratio")
    )


@pytest.fixture
def registry(monkeypatch: pytest.MonkeyPatch) -> Registry:
    """Its one evaluator compares with the mean of the baseline's repeats, and draws a file that cells leave."""

    def compare(self: Any, outcome: Outcome, baseline: list[Outcome]) -> Iterator[Measurement]:
        if baseline:
            mean = sum(other.measurements[0].value for other in baseline) / len(baseline)
            yield Measurement("ratio", outcome.measurements[0].value / mean)

    def drawing(self: Any, outcome: Outcome) -> Drawing:
        return Drawing((), (outcome.artifacts / "drawn.txt").read_text())

    for name, answer in (("metrics", METRICS), ("compare", compare), ("drawing", drawing)):
        monkeypatch.setattr(plain_plugins.ErrorEvaluator, name, answer, raising=False)
    return Registry([EntryPoint("plain", "plain_plugins", "codecbench")])


def folder_of(tmp_path: Path, *records: Record, cells: tuple[Cell, ...] = CELLS) -> Path:
    run = RunSettings(1, 60.0, 1000, 0, PluginSetting("executor", "local", "1"))
    store = Store(tmp_path / "run")
    with store.locked():
        store.write_plan(Plan("small", "", run, SEQUENCES, (), cells, DECLARED))
        for kept in records:
            store.write_record(kept)
    return store.folder


def ratios(run: RunResult) -> list[tuple[str, list[float]]]:
    return [
        (result.cell.id[-1], [measured.value for measured in result.measurements if measured.metric == "ratio"])
        for result in run.results
    ]


def test_cells_are_compared_with_the_baseline_on_their_sequence(tmp_path: Path, registry: Registry) -> None:
    records = [record(cell, value) for cell, value in zip(CELLS, (2.0, 4.0, 6.0, 8.0, 4.0), strict=True)]
    run = open_run(folder_of(tmp_path, *reversed(records)), registry)
    expected = [("1", [2 / 3]), ("2", [4 / 3]), ("3", [2.0]), ("4", [1.0]), ("5", [0.5])]
    assert ratios(run) == expected
    assert [result.cell for result in run.results] == list(CELLS)
    assert run.missing == 0
    assert run.schema.metrics == {"error": {metric.name: metric for metric in METRICS}}
    assert all(result.metrics == run.schema.metrics["error"] for result in run.results)


def test_cells_that_failed_are_neither_compared_nor_a_baseline(tmp_path: Path, registry: Registry) -> None:
    records = [record(CELLS[0], 100.0, "failed"), record(CELLS[1], 4.0), record(CELLS[2], 6.0)]
    records.append(record(CELLS[4], 4.0, "crashed"))
    run = open_run(folder_of(tmp_path, *records), registry)
    assert ratios(run) == [("1", []), ("2", [1.0]), ("3", [1.5]), ("5", [])]
    assert [(result.status, result.reason) for result in run.results] == [
        ("failed", "why"), ("ok", ""), ("ok", ""), ("crashed", "why"),
    ]  # fmt: skip
    assert run.missing == 1
    assert [result.drawing() for result in run.results if result.status != "ok"] == [None, None]


def test_a_comparison_replaces_what_was_measured_of_the_same_metric(
    tmp_path: Path, registry: Registry, monkeypatch: pytest.MonkeyPatch
) -> None:
    why = "the baseline has none"

    def compare(self: Any, outcome: Outcome, baseline: list[Outcome]) -> Iterator[Measurement]:
        yield Measurement("max_error", math.nan, reason=why)

    monkeypatch.setattr(plain_plugins.ErrorEvaluator, "compare", compare)
    run = open_run(folder_of(tmp_path, record(CELLS[0], 2.0)), registry)
    (measured,) = (each for each in run.results[0].measurements if each.metric == "max_error")
    assert (math.isnan(measured.value), measured.reason) == (True, why)


def test_a_comparison_that_fails_takes_away_nothing_that_was_measured(
    tmp_path: Path, registry: Registry, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whether a cell measured a metric of its frames or of none, and also where another cell of the evaluator did."""

    def compare(self: Any, outcome: Outcome, baseline: list[Outcome]) -> Iterator[Measurement]:
        raise PluginError("torn")

    monkeypatch.setattr(plain_plugins.ErrorEvaluator, "compare", compare)
    of_frames = replace(record(CELLS[0], 0.0), measurements=(), summaries={("max_error", "", "mean"): 3.0})
    nothing = replace(of_frames, cell_id=CELLS[1].id, summaries={})
    run = open_run(folder_of(tmp_path, of_frames, nothing, record(CELLS[2], 2.0)), registry)
    for result in run.results:
        (missing,) = (measured for measured in result.measurements if measured.metric == "ratio")
        assert (math.isnan(missing.value), missing.reason) == (True, "not compared: torn")
    measured = run.wide["error.max_error.mean"]
    assert measured.tolist() == [3.0, 2.0]
    assert run.wide["error.ratio.mean"].isna().all()


def test_everything_of_a_record_is_in_its_result(tmp_path: Path, registry: Registry) -> None:
    samples = parquet_from_samples([Measurement("max_error", 3.0, 1)])
    kept = replace(
        record(CELLS[3], 4.0),
        summaries={("max_error", "", "max"): 3.0},
        duration_s=2.5,
        code={"codec x": "f00d"},
        worker={"host": "he\x1bre", "pid": 3},
        contents={"frames.parquet": samples, "drawn.txt": b"a drawing"},
    )
    folder = folder_of(tmp_path, kept)
    (result,) = open_run(folder, registry).results
    assert (result.duration_s, result.code, result.worker) == (
        2.5,
        {"codec x": "f00d"},
        {"host": "he\\x1bre", "pid": 3},
    )
    assert result.summaries == {("max_error", "", "max"): 3.0}
    assert result.folder == Store(folder).record_folder(CELLS[3].id)
    assert result.frames()[["metric", "frame", "value"]].values.tolist() == [["max_error", 1, 3.0]]
    assert result.drawing() == Drawing((), "a drawing")


def opened(folder: Path, registry: Registry, caplog: pytest.LogCaptureFixture) -> tuple[tuple[CellResult, ...], str]:
    """The results, and what was said while they were read."""
    caplog.clear()
    with caplog.at_level(logging.WARNING, "codecbench.results"):
        return open_run(folder, registry).results, caplog.text


def test_a_damaged_artifact_leaves_its_cell_out_and_damaged_samples_do_not(
    tmp_path: Path, registry: Registry, caplog: pytest.LogCaptureFixture
) -> None:
    """Evaluators read artifacts by their path, unchecked; samples are checked as they are read."""
    contents = {"frames.parquet": parquet_from_samples([Measurement("max_error", 3.0, 1)]), "drawn.txt": b"a"}
    folder = folder_of(tmp_path, *(replace(record(cell, 4.0), contents=contents) for cell in CELLS[:2]))
    place = Store(folder).record_folder
    (place(CELLS[0].id) / "drawn.txt").write_bytes(b"b")
    (place(CELLS[1].id) / "frames.parquet").write_bytes(b"b")
    (result,), said = opened(folder, registry, caplog)
    assert result.cell == CELLS[1]
    for fact in ("drawn.txt", "digest differs", "left out"):
        assert fact in said
    assert "no samples" not in said
    with caplog.at_level(logging.WARNING, "codecbench.results"):
        assert result.frames().empty
        assert list(result.frames().columns) == ["metric", "frame", "stage", "value", "reason"]
    assert "no samples" in caplog.text


def test_samples_that_are_whole_and_no_table_are_none(
    tmp_path: Path, registry: Registry, caplog: pytest.LogCaptureFixture
) -> None:
    folder = folder_of(
        tmp_path, replace(record(CELLS[0], 1.0), contents={"frames.parquet": b"odd"}), record(CELLS[2], 1.0)
    )
    (odd, none), _ = opened(folder, registry, caplog)
    with caplog.at_level(logging.WARNING, "codecbench.results"):
        assert len(none.samples()) == 0
        assert caplog.text == ""
        assert len(odd.samples()) == 0
        assert "no samples" in caplog.text


@pytest.mark.parametrize("error", [PluginError, FileNotFoundError, ValueError, KeyError])
def test_what_cannot_be_drawn_is_none_and_said(
    error: type[Exception], tmp_path: Path, registry: Registry, caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    def drawing(self: Any, outcome: Outcome) -> Drawing:
        raise error("torn")

    monkeypatch.setattr(plain_plugins.ErrorEvaluator, "drawing", drawing)
    (result,), _ = opened(folder_of(tmp_path, record(CELLS[0], 1.0)), registry, caplog)
    with caplog.at_level(logging.WARNING, "codecbench.results"):
        assert result.drawing() is None
    assert "no drawing: " in caplog.text
    assert "torn" in caplog.text


def test_an_evaluator_that_is_gone_takes_its_comparisons_along_and_no_more(
    tmp_path: Path, registry: Registry, caplog: pytest.LogCaptureFixture
) -> None:
    gone = cell(6, "shift", evaluator=PluginSetting("evaluator", "gone", "1"))
    folder = folder_of(tmp_path, record(gone, 5.0), record(CELLS[0], 2.0), cells=(gone, *CELLS))
    (of_gone, other), said = opened(folder, registry, caplog)
    assert [measured.value for measured in of_gone.measurements] == [5.0]
    assert of_gone.drawing() is None
    assert [measured.value for measured in other.measurements] == [2.0, 1.0]
    assert "evaluator gone: " in said
    assert "comparisons and drawings" in said
    assert "evaluator error" not in said


def test_a_metric_that_was_declared_later_is_missing_with_what_to_do(tmp_path: Path, registry: Registry) -> None:
    """Not where it is measured or compared anyhow, and not of records that do not say what was declared."""
    alone = replace(record(CELLS[4], 1.0), metrics=("ratio",), measurements=(Measurement("ratio", 1.0),))
    early = replace(record(CELLS[2], 1.0), metrics=("max_error",))
    silent = replace(alone, cell_id=CELLS[0].id, metrics=())
    run = open_run(folder_of(tmp_path, alone, early, silent), registry)
    found = {
        result.cell.id[-1]: [(m.metric, m.value, m.reason) for m in result.measurements if m.reason]
        for result in run.results
    }
    assert found["1"] == []
    ((metric, value, reason),) = found["5"]
    assert (metric, math.isnan(value)) == ("max_error", True)
    assert reason.startswith("declared after")
    assert "--recompute error`" in reason
    assert found["3"] == []
