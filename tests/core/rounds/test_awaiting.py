"""Evaluators that await what others measure: when their cells are computed, with which values, under which identity."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

import pytest
from search_bench import SearchBench, size_of

from codecbench.core.contracts.errors import MatrixError
from codecbench.core.engine.planning.model import Cell, plan_from_json
from codecbench.core.engine.planning.plan import make_plan
from codecbench.core.engine.storage.record import cell_description
from codecbench.core.engine.storage.store import Store


def matrix(evaluators: str, codecs: str = "{use: dial, params: {level: {grid: [1, 2]}}}") -> str:
    return f"""
version: 1
name: awaited
sequences: [flat]
codecs: [{codecs}]
evaluators: [{evaluators}]
run: {{workers: 1}}
"""


WAITING = "waiter, {use: lag, params: {runs: 3}}"


def timed(cell: Cell) -> float | str:
    """Times grow with the level, and scatter over repeats."""
    if cell.evaluator.name == "lag":
        return float(cell.codec.params["level"]) + (0.0, 0.5, 9.0)[cell.repeat]
    return size_of(cell) if cell.evaluator.name == "scales" else cell.inputs["pause_ms"]


@pytest.fixture
def bench(tmp_path: Path) -> SearchBench:
    return SearchBench(tmp_path)


def waiters(bench: SearchBench) -> list[Cell]:
    return [cell for cell in bench.computed if cell.evaluator.name == "waiter"]


def test_cells_come_after_what_they_await_and_get_its_median(bench: SearchBench) -> None:
    bench.run(matrix(WAITING), timed)
    assert [{cell.evaluator.name for cell in cells} for cells in bench.rounds] == [{"lag"}, {"waiter"}]
    assert [cell.inputs for cell in waiters(bench)] == [{"pause_ms": 1.5}, {"pause_ms": 2.5}]
    assert cell_description(waiters(bench)[0])["inputs"] == {"pause_ms": 1.5}
    assert bench.plan is not None
    assert plan_from_json(bench.plan.as_json()).cells == bench.plan.cells


def test_the_record_decides_and_not_the_machine(bench: SearchBench, tmp_path: Path) -> None:
    """With the stored times nothing is computed anew; with others the cells that awaited them are other cells."""
    bench.run(matrix(WAITING), timed)
    first = waiters(bench)
    bench.run(matrix(WAITING), lambda _: pytest.fail("computed again"))
    assert bench.computed == []
    for cell in first:
        shutil.rmtree(Store(tmp_path / "run").record_folder(cell.id))
    bench.run(matrix(WAITING), timed)
    assert [cell.id for cell in bench.computed] == [cell.id for cell in first]
    other = SearchBench(tmp_path / "other")
    other.folder.mkdir()
    other.run(matrix(WAITING), lambda cell: 8.0 if cell.evaluator.name == "lag" else cell.inputs["pause_ms"])
    assert {cell.inputs["pause_ms"] for cell in waiters(other)} == {8.0}
    assert not {cell.id for cell in waiters(other)} & {cell.id for cell in first}


def test_more_repeats_of_what_awaits_compute_only_those(bench: SearchBench) -> None:
    bench.run(matrix(WAITING), timed)
    bench.run(matrix("{use: waiter, params: {runs: 2}}, {use: lag, params: {runs: 3}}"), timed)
    assert [(cell.evaluator.name, cell.repeat) for cell in bench.computed] == [("waiter", 1)] * 2


@pytest.mark.parametrize(
    ("measured", "words"),
    [("stuck", "lag failed: stuck"), (math.nan, "no lag_ms")],
)
def test_what_never_comes_is_the_reason(bench: SearchBench, measured: float | str, words: str) -> None:
    bench.run(matrix(WAITING), lambda cell: measured if cell.evaluator.name == "lag" else 0.0, most_rounds=2)
    assert bench.plan is not None
    reasons = [cell.unsupported for cell in bench.plan.cells if cell.evaluator.name == "waiter"]
    assert len(reasons) == 2
    assert all(words in str(reason) for reason in reasons)


def test_what_a_search_finds_and_tries_is_awaited_too(bench: SearchBench) -> None:
    dial = "{use: dial, params: {level: {range: [0, 20]}}, search: {metric: %s}}"
    bench.run(matrix(f"scales, {WAITING}", dial % "weight_bytes, max: 40"), timed)
    assert [cell.inputs for cell in waiters(bench)] == [{"pause_ms": 10.5}]
    bench.run(matrix(f"scales, {WAITING}", dial % "paused_ms, max: 5"), timed)
    assert bench.plan is not None
    (found,) = bench.plan.searches
    assert (found.state, found.setting, found.reached) == ("found", "level=4", 4.5)


def test_a_number_awaits_nothing(bench: SearchBench) -> None:
    plan = make_plan(bench.matrix(matrix("{use: waiter, params: {pause_ms: 3}}")), bench.registry)
    assert [cell.inputs for cell in plan.cells] == [{}, {}]


@pytest.mark.parametrize(
    ("evaluators", "words"),
    [
        ("{use: waiter, params: {pause_ms: measured}}", ("evaluators[0].params.pause_ms: 'measured'", "; add lag")),
        ("waiter, {use: lag, params: {runs: {grid: [1, 2]}}}", ("lag(runs=1), lag(runs=2); keep one",)),
    ],
)  # fmt: skip
def test_what_cannot_be_awaited_is_refused_before_anything_runs(
    bench: SearchBench, evaluators: str, words: tuple[str, ...]
) -> None:
    with pytest.raises(MatrixError) as refused:
        bench.matrix(matrix(evaluators))
    assert [word for word in words if word not in str(refused.value)] == []
