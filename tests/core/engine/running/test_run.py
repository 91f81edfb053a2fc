"""Runs: resuming, interrupting, sharing bitstreams, and order."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import psutil
import pytest
from engine_bench import FRAMES, HERE, OURS, Bench, bench_in, bench_without_processes, contents, grid, matrix
from project import SUPPORT

import codecbench
from codecbench.core.contracts.errors import StoreError
from codecbench.core.engine.planning.model import Cell, CodingJob, Plan
from codecbench.core.engine.running.progress import Progress, RunSummary
from codecbench.core.engine.running.schedule import Schedule

STEPS = "{use: faulty, params: {step: {grid: [0, 1]}}}"
MANY = matrix(STEPS, "wandering, whole, slow, {use: slow, params: {fault: again}}, alone")


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with bench_in(tmp_path, workers=1) as made:
        yield made


@pytest.fixture
def bench_here(tmp_path: Path) -> Iterator[Bench]:
    with bench_without_processes(tmp_path) as made:
        yield made


@dataclass(frozen=True)
class Finished:
    """A run of MANY by two workers, what it told meanwhile, and the same run once more."""

    bench: Bench
    plan: Plan
    seen: list[Progress]
    summary: RunSummary
    again: RunSummary


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Finished:
    seen: list[Progress] = []
    with bench_in(tmp_path_factory.mktemp("finished")) as bench:
        plan = bench.plan(MANY)
        return Finished(bench, plan, seen, bench.run(plan, listener=seen.append), bench.run(plan))


def test_a_run_computes_every_cell_once_and_reports_as_it_goes(finished: Finished) -> None:
    plan, seen, summary, again = finished.plan, finished.seen, finished.summary, finished.again
    assert summary.statuses == {"ok": len(plan.cells)} == {"ok": 12}
    assert (summary.computed, summary.kept, summary.encoded, summary.interrupted) == (12, 0, 2, None)
    assert [one.cell.id for one in seen if one.cell] != []
    assert {one.cell.id for one in seen if one.cell} == {cell.id for cell in plan.cells}
    assert (seen[-1].cells_done, seen[-1].jobs_done, seen[-1].not_ok) == (12, 2, 0)
    assert seen[-1].remaining_s == 0.0
    assert all(one.remaining_s is not None for one in seen)
    assert (again.computed, again.kept, again.encoded) == (0, 12, 0)


def test_records_say_what_where_and_when(finished: Finished) -> None:
    store, records = finished.bench.store(), finished.bench.records(finished.plan).values()
    environments = store.environments.read()
    for cell, record in records:
        assert record.environment in environments
        assert record.cell["codec"] == {
            "name": "faulty",
            "version": "1",
            "params": cell.codec.params,
            "label": f"step={cell.codec.params['step']}",
        }
        assert record.cell["sequence"]["fingerprint"] == cell.sequence.fingerprint
        assert record.duration_s > 0
        assert record.worker["pid"] > 0
    size = FRAMES * (3 + 16 * 24)
    for whole in [record for cell, record in records if cell.evaluator.name == "whole"]:
        assert list(whole.files) == ["total.txt"]
        assert store.read_file(whole, "total.txt") == f"{size}\n".encode()
        assert (whole.measurements[0].metric, whole.measurements[0].value) == ("size_bytes", size)


@pytest.mark.thorough
def test_what_a_sequence_notes_is_said_before_anything_is_computed(bench_here: Bench) -> None:
    plan = bench_here.plan(matrix("{use: faulty, params: {step: 1}}", "wandering", HERE))
    told = replace(plan, sequences=tuple(replace(entry, notes=("is cut short",)) for entry in plan.sequences))
    seen: list[Progress] = []
    bench_here.run(told, listener=seen.append)
    assert seen[0].notice == f"{plan.sequences[0].name}: is cut short"
    assert [progress.notice for progress in seen[1:] if progress.notice] == []


@pytest.mark.thorough
def test_what_a_codec_remarks_of_a_setting_is_noted(bench_here: Bench) -> None:
    """Also where the evaluator runs the codec itself, as `alone` does."""
    plan = bench_here.plan(matrix("{use: faulty, params: {step: {grid: [1, 6]}}}", "wandering, alone", HERE))
    bench_here.run(plan)
    noted = {
        (cell.evaluator.name, cell.codec.label): record.notes for cell, record in bench_here.records(plan).values()
    }
    assert noted == {
        (evaluator, label): said
        for evaluator in ("wandering", "alone")
        for label, said in {"step=1": (), "step=6": ("keeps little",)}.items()
    }


@pytest.mark.thorough
def test_results_do_not_depend_on_workers_or_order(bench: Bench) -> None:
    plan = bench.plan(matrix(OURS, "quality, features"))
    bench.run(plan, "one", workers=1)
    bench.run(plan, "three", workers=3)
    assert contents(bench.store("one"), plan) == contents(bench.store("three"), plan)


@pytest.mark.thorough
def test_a_further_evaluator_encodes_nothing(bench_here: Bench) -> None:
    bench_here.run(matrix(STEPS, "wandering", HERE))
    more = bench_here.run(matrix(STEPS, "wandering, whole", HERE))
    assert (more.computed, more.kept, more.encoded) == (2, 2, 0)


@pytest.mark.thorough
def test_python_recomputes_by_name_too(bench_here: Bench) -> None:
    text = matrix("{use: faulty, params: {step: {grid: [0, 1]}}}", "wandering, whole", HERE)
    plan = bench_here.plan(text)
    bench_here.run(plan)
    before = bench_here.records(plan)
    again = codecbench.run(bench_here.folder / "matrix.yaml", out=bench_here.folder / "run", recompute=["whole"])
    assert not again.failed
    after = bench_here.records(plan)
    computed = {
        cell.evaluator.name for cell, record in after.values() if record.started_utc != before[cell.id][1].started_utc
    }
    assert computed == {"whole"}
    assert {record.metrics for cell, record in after.values() if cell.evaluator.name == "whole"} == {
        ("size_bytes", "draw")
    }


def test_exclusive_cells_come_last_alone_pinned_and_interleaved(finished: Finished) -> None:
    order = [one.cell for one in finished.seen if one.cell]
    alone = [cell for cell in order if cell.exclusive]
    assert order[-4:] == alone
    assert [cell.repeat for cell in alone] == [0, 0, 1, 1]
    assert [cell.codec.params["step"] for cell in alone] == [0, 1, 0, 1]
    for cell, record in finished.bench.records(finished.plan).values():
        if cell.exclusive:
            assert {one.metric: one.value for one in record.measurements}["cores"] == 1


def test_two_runs_in_one_folder_are_told(bench: Bench) -> None:
    plan = bench.plan(matrix("faulty", "wandering"))
    with bench.store().locked():
        assert bench.store().in_use()
        with pytest.raises(StoreError, match=f"by process {os.getpid()} on "):
            bench.run(plan)
    assert not bench.store().in_use()
    with bench.store().locked():
        assert bench.store().in_use(), "the next one may have it"


def test_the_schedule_frees_cells_when_their_bitstreams_are_there(bench: Bench) -> None:
    plan = bench.plan(matrix("{use: faulty, params: {step: {grid: [0, 1]}}}", "wandering, alone"))
    schedule = Schedule(plan, list(plan.cells), set())
    first, second = schedule.take(), schedule.take()
    assert isinstance(first, CodingJob)
    assert isinstance(second, CodingJob)
    assert schedule.take() is None
    schedule.finish(first)
    cell = schedule.take()
    assert isinstance(cell, Cell)
    assert cell.job_id == first.id
    assert [one.job_id for one in schedule.fail(second)] == [second.id]
    assert schedule.take() is None, "exclusive cells wait for the last other one"
    schedule.encode_again(cell)
    assert schedule.take() is first
    schedule.finish(first)
    assert schedule.take() is cell
    schedule.finish(cell)
    rest = [schedule.take() for _ in range(4)]
    assert all(isinstance(one, Cell) and one.exclusive for one in rest)
    assert len(schedule) == 4


def test_the_schedule_gives_what_is_ready_in_its_order(bench: Bench) -> None:
    plan = bench.plan(matrix("{use: faulty, params: {step: {grid: [0, 1, 2]}}}", "wandering"))
    schedule, (first, second, third) = Schedule(plan, list(plan.cells), set()), plan.jobs
    assert schedule.take(lambda work: work.id in (second.id, third.id)) is second
    assert schedule.take(lambda work: False) is None
    assert [schedule.take(), schedule.take()] == [first, third]


@pytest.mark.thorough
def test_a_clock_that_goes_backwards_harms_nothing(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = iter(range(2_000_000_000, 0, -3600))
    monkeypatch.setattr(time, "time", lambda: float(next(clock)))
    plan = bench.plan(matrix(OURS, "quality", "workers: 2, timeout_s: 20"))
    seen: list[Progress] = []
    assert bench.run(plan, listener=seen.append).statuses == {"ok": 2}
    assert all(0 <= one.elapsed_s < 60 for one in seen)


def interrupted_run(bench: Bench, name: str, number: signal.Signals, after_s: float) -> float:
    """Start the matrix in a process, send it a signal, and return how long it took to end."""
    driver = SUPPORT / "run_driver.py"
    command = [
        sys.executable,
        str(driver),
        str(bench.folder / "matrix.yaml"),
        str(bench.folder / name),
        str(bench.site),
    ]
    process = subprocess.Popen(command, start_new_session=True)
    time.sleep(after_s)
    children = psutil.Process(process.pid).children(recursive=True) if process.poll() is None else []
    sent = time.monotonic()
    process.send_signal(number)
    process.wait(30)
    took = time.monotonic() - sent
    _, alive = psutil.wait_procs([one for one in children if one.is_running()], timeout=10)
    assert not alive, f"workers outlived {number.name}"
    return took


def check_interruptions(bench: Bench, trials: int, seed: int) -> None:
    plan = bench.plan(matrix(OURS, "quality, whole, slow, alone"))
    bench.run(plan, "undisturbed")
    truth = contents(bench.store("undisturbed"), plan)
    rng = np.random.default_rng(seed)
    midway = 0
    for trial in range(trials):
        name = f"trial-{trial}"
        numbers = [signal.SIGKILL, signal.SIGTERM, signal.SIGINT]
        for number in (numbers[trial % 3], numbers[int(rng.integers(3))])[: 1 + trial % 2]:
            assert interrupted_run(bench, name, number, float(rng.uniform(0.5, 4.5))) < 20
        finished = set(bench.store(name).entries()) if (bench.folder / name).exists() else set()
        midway += 0 < len(finished) < len(plan.cells)
        summary = bench.run(plan, name)
        assert (summary.kept, summary.computed) == (len(finished), len(plan.cells) - len(finished))
        assert summary.statuses == {"ok": len(plan.cells)}
        assert not summary.damaged
        assert contents(bench.store(name), plan) == truth
        assert not list((bench.folder / name).rglob(".new-*"))
    assert midway or trials < 10, "no run was ended midway: the times do not fit this machine"


@pytest.mark.thorough
def test_a_run_killed_at_any_time_resumes_to_the_same_result(bench: Bench) -> None:
    check_interruptions(bench, 3, seed=1)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_fifty_runs_killed_at_random_times_resume_to_the_same_result(bench: Bench) -> None:
    check_interruptions(bench, 50, seed=2)


def test_an_interrupted_run_says_so_and_goes_on_later(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """The third cell hangs until the run ends, so that it is known how many were computed."""
    gate = bench.folder / "gate"
    gate.mkdir()
    monkeypatch.setenv("GATE", str(gate))
    plan = bench.plan(matrix(grid("faulty", "abc"), "gated"))
    for ticket in "12":
        (gate / ticket).touch()

    def stop(progress: Progress) -> None:
        if progress.cells_done == 2:
            signal.raise_signal(signal.SIGTERM)

    summary = bench.run(plan, listener=stop)
    assert (summary.interrupted, summary.computed) == ("SIGTERM", 2)
    assert "ended by SIGTERM" in bench.store().log_path.read_text()
    (gate / "3").touch()
    again = bench.run(plan)
    assert (again.kept, again.computed, again.statuses) == (2, 1, {"ok": 3})
