"""Many cells and many samples. The short forms check that all is there; the long forms (--slow) hold times and memory.

They log what they measure:
pytest tests/core/engine/running/test_scale.py --slow -n 0 -o log_cli=true -o log_cli_level=INFO
"""

from __future__ import annotations

import logging
import os
import statistics
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import distributions
import numpy as np
import pandas as pd
import psutil
import pyarrow.parquet as pq
import pytest
from dask_cluster import cluster_elsewhere
from engine_bench import Bench, bench_in, write_stack
from project import SUPPORT

from codecbench.core.analysis.collect import open_run
from codecbench.core.contracts.evaluator import Measurement
from codecbench.core.contracts.metric import Metric
from codecbench.core.engine.plugins.registry import installed
from codecbench.core.engine.running.progress import Progress
from codecbench.core.engine.storage.aggregate import summarise
from codecbench.core.engine.storage.record import Record, cell_description
from codecbench.core.engine.storage.samples import parquet_from_samples

pytestmark = pytest.mark.thorough

log = logging.getLogger("scale")
LONG = [pytest.mark.slow, pytest.mark.timeout(3 * 3600)]


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with bench_in(tmp_path) as made:
        distributions.register(made.site, "scale", "1.0", "scale_plugins")
        installed.cache_clear()
        yield made


def many(bench: Bench, sequences: int, codecs: int, evaluators: int, evaluator: str = "noop", run: str = "") -> str:
    """A matrix with that many of each."""
    for number in range(sequences):
        write_stack(bench.folder / f"s{number}.npy", frames=1, seed=number)
    entries = ", ".join(f"{{use: stack, params: {{path: s{number}.npy}}}}" for number in range(sequences))

    def numbered(use: str, count: int) -> str:
        return f"{{use: {use}, params: {{number: {{range: [0, {count - 1}]}}}}}}"

    return f"""
version: 1
name: scale
sequences: [{entries}]
codecs: [{numbered("idle", codecs)}]
evaluators: [{numbered(evaluator, evaluators)}]
run: {{workers: 2{run}}}
"""


@dataclass
class Load:
    """What a run costs, by process: CPU seconds, and memory as it grew."""

    scheduler: psutil.Process
    every: int
    memory_mb: list[int] = field(default_factory=list)
    begun_s: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.begun_s = self.cpu_s()

    def cpu_s(self) -> dict[str, float]:
        both = {"coordinator": psutil.Process(), "scheduler": self.scheduler}
        return {name: sum(process.cpu_times()[:2]) for name, process in both.items()}

    def heard(self, progress: Progress) -> None:
        if progress.cells_done % self.every == 1:
            self.memory_mb.append(self.scheduler.memory_info().rss >> 20)

    def per_cell_ms(self, cells: int) -> dict[str, float]:
        return {name: round(1e3 * (end - self.begun_s[name]) / cells, 2) for name, end in self.cpu_s().items()}


@dataclass(frozen=True)
class Process:
    """What a process took. cpu_s: what wall_s would be on an idle machine, for these processes compute all the time."""

    wall_s: float
    cpu_s: float
    memory_mb: float
    output: bytes

    def __str__(self) -> str:
        return f"{self.wall_s:.1f} s ({self.cpu_s:.1f} s CPU), {self.memory_mb:.0f} MB"


def whole_process(*words: str | Path, site: Path) -> Process:
    """`codecbench WORDS` in a process of its own."""
    path = os.pathsep.join([str(site), str(SUPPORT)])
    command = [sys.executable, "-m", "codecbench", *map(str, words)]
    begun = time.monotonic()
    process = subprocess.Popen(command, stdout=subprocess.PIPE, env={**os.environ, "PYTHONPATH": path})
    assert process.stdout is not None
    output = process.stdout.read()
    process.stdout.close()
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    assert process.returncode == 0, output[-2000:]
    return Process(time.monotonic() - begun, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024, output)


@pytest.mark.parametrize(
    ("sequences", "codecs", "evaluators"),
    [pytest.param(2, 5, 20, id="short", marks=pytest.mark.slow), pytest.param(10, 100, 100, id="long", marks=LONG)],
)
def test_no_op_cells_are_planned_scheduled_and_tabulated(
    bench: Bench, sequences: int, codecs: int, evaluators: int
) -> None:
    count = sequences * codecs * evaluators
    with cluster_elsewhere(bench.folder / "cluster", bench.site) as cluster:
        where = f'{{use: dask, params: {{address: "{cluster.address}", shared_files: true}}}}'
        text = many(bench, sequences, codecs, evaluators, run=f", executor: {where}")
        begun = time.monotonic()
        plan = bench.plan(text)
        planned = time.monotonic()
        assert len(plan.cells) == count
        load = Load(psutil.Process(cluster.scheduler), every=max(1, count // 10))
        summary = bench.run(plan, listener=load.heard)
        ran = time.monotonic()
        per_cell_ms = load.per_cell_ms(count)
    assert summary.statuses == {"ok": count}
    assert load.memory_mb[-1] - load.memory_mb[0] < 200, "the scheduler forgets cells that are done"
    log.info("| %d no-op cells planned | %.1f s |", count, planned - begun)
    log.info("| run by dask on this machine, a cell by the clock | %.1f ms |", 1e3 * (ran - planned) / count)
    for process, each_ms in per_cell_ms.items():
        log.info("| CPU time of the %s, a cell | %.1f ms |", process, each_ms)
    memory_mb = f"{load.memory_mb[0]} and {load.memory_mb[-1]} MB"
    log.info("| memory of the scheduler, first and last tenth | %s |", memory_mb)
    check_tables(bench, sequences * codecs, evaluators)
    check_resume(bench, count)


def check_tables(bench: Bench, rows: int, evaluators: int) -> None:
    took = whole_process("table", "--wide", "--format", "csv", bench.folder / "run", site=bench.site)
    lines = took.output.decode().splitlines()
    assert len(lines) == 1 + rows
    values = lines[-1].split(",")
    assert [float(value) for value in values[3 : 3 + evaluators]] == list(range(evaluators))
    log.info("| the wide table of %d rows and %d columns, as CSV | %s |", rows, len(values), took)


def check_resume(bench: Bench, count: int) -> None:
    listing = whole_process("status", bench.folder / "run", site=bench.site)
    assert f"{count} cells: {count} ok".encode() in listing.output
    resume = whole_process("run", bench.folder / "matrix.yaml", "--out", bench.folder / "run", site=bench.site)
    log.info("| `codecbench status` of %d cells | %s |", count, listing)
    log.info("| `codecbench run` once more, every record checked by its digest | %s |", resume)


def fill(bench: Bench, sequences: int, codecs: int, evaluators: int, frames: int) -> int:
    """A run folder whose cells have 5 samples a frame, without computing any; how many samples there are."""
    plan = bench.plan(many(bench, sequences, codecs, evaluators, "sampled"))
    metrics = tuple(Metric(f"m{n}", "1", "lower", "", ("mean", "median", "p95")) for n in range(5))
    rng = np.random.default_rng(0)
    stock: list[tuple[bytes, Any]] = []
    for _ in range(20):
        values = rng.normal(size=(frames, 5))
        samples = [Measurement(f"m{n}", float(values[at, n]), at) for at in range(frames) for n in range(5)]
        stock.append((parquet_from_samples(samples), summarise(samples, metrics)))
    store = bench.store()
    with store.locked():
        store.write_plan(plan)
        for number, cell in enumerate(plan.cells):
            content, summaries = stock[number % len(stock)]
            described, contents = cell_description(cell), {"frames.parquet": content}
            record = Record(cell.id, "ok", summaries=summaries, cell=described, duration_s=0.1, contents=contents)
            store.write_record(record)
    return len(plan.cells) * frames * 5


@pytest.mark.parametrize(
    ("sequences", "codecs", "evaluators", "frames"),
    [pytest.param(2, 5, 4, 10, id="short"), pytest.param(10, 500, 4, 100, id="long", marks=LONG)],
)
def test_a_wide_table_of_many_samples(bench: Bench, sequences: int, codecs: int, evaluators: int, frames: int) -> None:
    samples = fill(bench, sequences, codecs, evaluators, frames)
    rows = sequences * codecs
    wide, tidy = bench.folder / "wide.parquet", bench.folder / "tidy.parquet"
    for words in (
        ("table", "--wide"),
        ("table", "--wide", "--format", "parquet", "--out", wide),
        ("table", "--tidy", "--format", "parquet", "--out", tidy),
    ):
        took = whole_process(*words, bench.folder / "run", site=bench.site)
        shape = " ".join(map(str, words[:4]))
        log.info("| `codecbench %s` of %d cells with %d samples | %s |", shape, rows * evaluators, samples, took)
        assert took.memory_mb < 2000
        assert took.cpu_s < 10 or "--tidy" in words
    table = open_run(bench.folder / "run").wide
    assert table.shape == (rows, 5 + evaluators * 15)
    assert table.equals(pd.read_parquet(wide))
    assert pq.ParquetFile(tidy).metadata.num_rows == samples


def bare_s(processes: int, cpu_s: float) -> float:
    """How long so many processes without codecbench take to use so much of the cores together."""
    program = f"from scale_plugins import burn; burn({cpu_s / processes})"
    environment = {**os.environ, "PYTHONPATH": str(SUPPORT)}
    begun = time.monotonic()
    started = [subprocess.Popen([sys.executable, "-c", program], env=environment) for _ in range(processes)]
    assert [process.wait() for process in started] == [0] * processes
    return time.monotonic() - begun


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_two_workers_gain_what_the_machine_has_to_give(bench: Bench) -> None:
    """Whole processes, interleaved; the machine's gain is that of bare processes between them."""
    bench.plan(many(bench, 1, 1, 40, "burn"))
    text = (bench.folder / "matrix.yaml").read_text()
    took_s: dict[tuple[str, int], list[float]] = defaultdict(list)
    for round_ in range(3):
        for workers in (1, 2):
            took_s["bare", workers].append(bare_s(workers, 20.0))
            for executor in ("local", "dask"):
                path = bench.folder / "matrix.yaml"
                path.write_text(text.replace("workers: 2", f"workers: {workers}, executor: {executor}"))
                out = bench.folder / f"{executor}-{workers}-{round_}"
                took_s[executor, workers].append(whole_process("run", path, "--out", out, site=bench.site).wall_s)
    median_s = {what: statistics.median(times) for what, times in took_s.items()}
    gain = {what: median_s[what, 1] / median_s[what, 2] for what in ("bare", "local", "dask")}
    for name, value in gain.items():
        both_s = f"{median_s[name, 1]:.1f} and {median_s[name, 2]:.1f} s"
        log.info("| 40 cells of 0.5 s with 1 and 2 workers, %s | %s: %.2f times as fast |", name, both_s, value)
    assert gain["local"] > 0.75 * gain["bare"]
    assert gain["dask"] > 0.7 * gain["bare"]
