"""A bench for tests of the engine: plugins that go wrong, a small sequence, runs in a temporary folder."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import distributions
import numpy as np
import pytest
from project import THIRD_PARTY

from codecbench.core.engine.planning.matrix import read_matrix
from codecbench.core.engine.planning.model import Cell, Plan
from codecbench.core.engine.planning.plan import make_plan
from codecbench.core.engine.plugins.registry import everything, installed
from codecbench.core.engine.running import work
from codecbench.core.engine.running.progress import RunSummary
from codecbench.core.engine.running.run import run_plan
from codecbench.core.engine.running.workbench import Workbench
from codecbench.core.engine.storage.record import SAMPLES_FILE, Record
from codecbench.core.engine.storage.samples import table_from_parquet
from codecbench.core.engine.storage.store import Store

FRAMES = 5
HERE = "workers: 1, executor: inline"
"""Part `run` of a matrix whose plugins are created in the test's process, see `plugins_in_process`."""
OURS = "{use: jpeg, params: {quality: {grid: [20, 80]}}}"
"""Two codec settings that need no hosts, of which each takes most of a second of processor time to begin."""


def write_stack(path: Path, frames: int = FRAMES, seed: int = 0) -> Path:
    """Noise with the frame's index in pixel (0, 0)."""
    stack = np.random.default_rng(seed).integers(0, 256, (frames, 16, 24), np.uint8)
    stack[:, 0, 0] = np.arange(frames)
    np.save(path, stack)
    return path


@dataclass
class Bench:
    """Runs matrices in one folder. workers: of a run that does not say how many; each costs a second to begin."""

    folder: Path
    site: Path
    workers: int = 2

    def plan(self, text: str) -> Plan:
        path = self.folder / "matrix.yaml"
        path.write_text(text)
        return make_plan(read_matrix(path, installed()), installed())

    def run(self, plan: Plan | str, name: str = "run", **options: Any) -> RunSummary:
        plan = self.plan(plan) if isinstance(plan, str) else plan
        options.setdefault("workers", self.workers)
        return run_plan(plan, self.folder / name, **options)

    def store(self, name: str = "run") -> Store:
        return Store(self.folder / name)

    def records(self, plan: Plan, name: str = "run") -> dict[str, tuple[Cell, Record]]:
        store = self.store(name)
        return {cell.id: (cell, store.read_record(cell.id)) for cell in plan.cells}


def contents(store: Store, plan: Plan) -> dict[str, Any]:
    """What a run found, without what may differ between two runs of the same plan."""
    found = {}
    for cell in plan.cells:
        if cell.exclusive:
            continue
        record = store.read_record(cell.id)
        samples = store.samples(record)
        rows = None if samples is None else str(table_from_parquet(samples).to_pylist())
        artifacts = {name: store.read_file(record, name) for name in record.files if name != SAMPLES_FILE}
        key = (record.status, record.reason, record.measurements, tuple(sorted(record.summaries.items())), rows)
        found[cell.id] = (key, artifacts)
    return found


@contextmanager
def bench_in(folder: Path, workers: int = 2) -> Iterator[Bench]:
    """A bench in an empty folder, with the plugins that go wrong installed."""
    site = folder / "site"
    site.mkdir()
    distributions.register(site, "faults", "1.0", "fault_plugins")
    sys.path.insert(0, str(site))
    installed.cache_clear()
    write_stack(folder / "stack.npy")
    try:
        yield Bench(folder, site, workers)
    finally:
        sys.path.remove(str(site))
        installed.cache_clear()


@contextmanager
def plugins_in_process(site: Path) -> Iterator[None]:
    """Meanwhile the executor `inline` creates the plugins of all distributions in this process."""
    (site / "codecbench_inline").symlink_to(THIRD_PARTY / "inline" / "codecbench_inline")
    distributions.register(site, "codecbench-inline", "1", "codecbench_inline")
    installed.cache_clear()
    workbench = Workbench(registry=everything())
    workbench.hosts_none = True
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(work, "_workbench", lambda: workbench)
        yield
    sys.modules.pop("codecbench_inline", None)


@contextmanager
def bench_without_processes(folder: Path) -> Iterator[Bench]:
    """A bench for runs without workers and hosts: for tests of folders and schedules.

    A run of it takes some 50 ms, and with workers and hosts seconds.
    """
    with bench_in(folder) as bench, plugins_in_process(bench.site):
        yield bench


def matrix(codecs: str, evaluators: str, run: str = "workers: 2") -> str:
    """A matrix over the stack of frames."""
    return f"""
version: 1
sequences: [{{use: stack, params: {{path: stack.npy}}}}]
codecs: [{codecs}]
evaluators: [{evaluators}]
run: {{{run}}}
"""


def grid(use: str, faults: Iterable[str]) -> str:
    """A plugin with each of these faults."""
    return f"{{use: {use}, params: {{fault: {{grid: [{', '.join(faults)}]}}}}}}"
