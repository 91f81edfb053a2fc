"""Every write, rename and sync of a run folder fails once in turn: nothing finished is lost, the next run mends it."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from engine_bench import HERE, Bench, bench_without_processes, contents, matrix

from codecbench.core.contracts.errors import StoreError
from codecbench.core.engine.planning.model import Plan
from codecbench.core.engine.running.progress import Progress
from codecbench.core.engine.storage import atomic, record_index, store

RENAMING = ("replace", "rename", "fsync", "chmod")
MANY = 500
"""More steps than a run of the matrix takes; a fault at a step that never comes injects nothing."""


@dataclass
class Faults:
    """Stands for `os` and `open` in the modules that write; step number `at` fails, and what it wrote is torn."""

    at: int
    steps: list[str] = field(default_factory=list)

    def step(self, what: str) -> None:
        self.steps.append(what)
        if len(self.steps) == self.at:
            raise OSError(errno.ENOSPC, "No space left on device")

    def __getattr__(self, name: str) -> Any:
        function = getattr(os, name)
        if name in RENAMING:
            return self._failing(name, function)
        return (lambda *words: Stream(function(*words), self)) if name == "fdopen" else function

    def opened(self, *words: Any, **options: Any) -> Any:
        self.step("open")
        return Stream(open(*words, **options), self)

    def _failing(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def called(*words: Any) -> Any:
            self.step(name)
            return function(*words)

        return called


@dataclass
class Stream:
    """A file whose write may stop half way."""

    inner: Any
    faults: Faults

    def write(self, data: bytes) -> int:
        try:
            self.faults.step("write")
        except OSError:
            self.inner.write(data[: len(data) // 2])
            self.inner.flush()
            raise
        return int(self.inner.write(data))

    def __getattr__(self, name: str) -> Any:
        return getattr(self.inner, name)

    def __enter__(self) -> Stream:
        return self

    def __exit__(self, *_: object) -> None:
        self.inner.close()


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with bench_without_processes(tmp_path) as made:
        yield made


@pytest.fixture
def plan(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> Plan:
    """A few cells with samples, computed in this process, each waited for until the disk has it."""
    monkeypatch.setattr(store, "_DURABLE_FROM_S", 0.0)
    text = matrix("{use: faulty, params: {step: {grid: [0, 1]}}}", "wandering", HERE)
    return bench.plan(text)


def run_with(faults: Faults, bench: Bench, plan: Plan, name: str, **options: Any) -> set[str]:
    """The cells that were recorded before the fault, with which a run ends in a sentence and no cell fails."""
    finished: set[str] = set()

    def listen(progress: Progress) -> None:
        if progress.cell is not None and progress.record is not None:
            assert progress.record.status == "ok"
            finished.add(progress.cell.id)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(atomic, "os", faults)
        patch.setattr(atomic, "open", faults.opened, raising=False)
        patch.setattr(record_index, "open", faults.opened, raising=False)
        try:
            bench.run(plan, name, workers=1, listener=listen, **options)
        except StoreError as error:
            told = str(error)
        else:
            told = ""
    if 0 < faults.at <= len(faults.steps):
        assert "No space left on device" in told
        assert "all earlier records are kept" in told
    return finished


def assert_mended(bench: Bench, plan: Plan, name: str, finished: set[str], expected: dict[str, Any]) -> None:
    sound, damaged = bench.store(name).sound_entries(cell.id for cell in plan.cells)
    assert not damaged
    assert finished <= {id_ for id_, entry in sound.items() if entry.status == "ok"}
    summary = bench.run(plan, name, workers=1)
    assert summary.statuses == {"ok": len(plan.cells)}
    assert summary.kept >= len(finished)
    assert contents(bench.store(name), plan) == expected
    assert not list(bench.store(name).folder.rglob(".*"))


@pytest.mark.thorough
def test_every_write_of_a_run_fails_once_and_nothing_finished_is_lost(bench: Bench, plan: Plan) -> None:
    bench.run(plan, "whole", workers=1)
    expected = contents(bench.store("whole"), plan)
    quiet = Faults(0)
    run_with(quiet, bench, plan, "quiet")
    assert {"write", "replace", "rename", "fsync", "chmod", "open"} <= set(quiet.steps)
    assert len(quiet.steps) < MANY
    for at in range(1, len(quiet.steps) + 1):
        finished = run_with(Faults(at), bench, plan, f"run-{at}")
        assert_mended(bench, plan, f"run-{at}", finished, expected)


@pytest.mark.thorough
def test_every_write_of_a_repeated_run_fails_once_and_nothing_is_lost(bench: Bench, plan: Plan) -> None:
    bench.run(plan, "run", workers=1)
    expected = contents(bench.store(), plan)
    everything = {cell.id for cell in plan.cells}
    steps = Faults(0)
    run_with(steps, bench, plan, "run")
    for at in range(1, len(steps.steps) + 1):
        run_with(Faults(at), bench, plan, "run")
        assert_mended(bench, plan, "run", everything, expected)
