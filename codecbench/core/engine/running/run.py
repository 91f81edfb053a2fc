"""The run loop: hands out what is ready, records what comes back, and starts where an earlier run stopped.

Records with status `ok` are kept for ever. Cells that failed, crashed, timed out or were unsupported are tried
again by the next run, because a run is repeated after mending what was wrong.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from codecbench.core.contracts.errors import StoreError
from codecbench.core.contracts.executor import Executor, Finished, Status, Task
from codecbench.core.engine.planning.model import Cell, CodingJob, Plan
from codecbench.core.engine.registry import Registry, installed
from codecbench.core.engine.running.frame_cache import cache_limit_bytes
from codecbench.core.engine.running.interruption import Interruption
from codecbench.core.engine.running.progress import Pace, Progress
from codecbench.core.engine.running.run_log import logging_to
from codecbench.core.engine.running.schedule import Schedule, Work
from codecbench.core.engine.running.warm_up import WarmUp, kernels_to_compile
from codecbench.core.engine.running.work import (
    CellDone,
    CellOrder,
    CodingDone,
    CodingOrder,
    perform_cell,
    perform_coding,
    prepare_worker,
)
from codecbench.core.engine.storage.record import Record, cell_description
from codecbench.core.engine.storage.record_index import IndexEntry
from codecbench.core.engine.storage.store import Store

log = logging.getLogger("codecbench.run")

Listener = Callable[[Progress], None]

_POLL_S = 0.2


@dataclass(frozen=True)
class RunSummary:
    """How a run ended.

    statuses: how many cells of the plan have which status now. computed: cells computed by this run. kept:
    cells that an earlier run had computed. encoded: coding jobs done. interrupted: the signal that ended the
    run early, or None. damaged: what was found damaged and why, by cell.
    """

    folder: Path
    statuses: dict[str, int]
    computed: int
    kept: int
    encoded: int
    interrupted: str | None = None
    damaged: dict[str, str] = field(default_factory=dict)


def run_plan(
    plan: Plan,
    folder: Path,
    *,
    workers: int | None = None,
    listener: Listener | None = None,
    registry: Registry | None = None,
    log_level: int = logging.INFO,
) -> RunSummary:
    """Compute what is missing of a plan and record it in `folder`.

    Listener is told after every job and cell. SIGINT and SIGTERM end the run within seconds; everything
    recorded is kept. Raises StoreError where the folder is in use or cannot be written.
    """
    store = Store(folder)
    setting = plan.run.executor
    with store.locked(), logging_to(store.log_path, log_level), Interruption() as interruption:
        registry = registry or installed()
        executor: Executor[Any] = registry.create("executor", setting.name, setting.params)
        run = _Run(plan, store, executor, workers or plan.run.workers, listener or (lambda _: None), registry)
        try:
            run.perform(interruption)
        except StoreError as error:
            log.error("%s", error)
            raise
        finally:
            executor.stop()
        return run.summary(interruption.signal_name)


class _Run:
    """The state of one run."""

    def __init__(
        self, plan: Plan, store: Store, executor: Executor[Any], workers: int, listener: Listener, registry: Registry
    ) -> None:
        self.plan, self.store, self.executor, self.workers, self.listener = plan, store, executor, workers, listener
        self.registry, self.warm_up = registry, WarmUp()
        store.write_plan(plan)
        sound, self.damaged = store.sound_entries(cell.id for cell in plan.cells)
        for cell_id, reason in self.damaged.items():
            log.warning("record %s will be computed again: %s", cell_id, reason)
            store.drop_record(cell_id)
        ok = {cell_id for cell_id, entry in sound.items() if entry.status == "ok"}
        self.kept = ok | {cell.id for cell in plan.cells if _still_unsupported(cell, sound.get(cell.id))}
        self.stale = set(sound) - self.kept
        self.statuses: dict[str, Status] = {cell_id: "ok" if cell_id in ok else "unsupported" for cell_id in self.kept}
        left = [cell for cell in plan.cells if cell.id not in self.kept]
        todo = [cell for cell in left if cell.unsupported is None]
        frames = {job.id: job.sequence.frames for job in plan.jobs}
        wanted = {cell.job_id for cell in todo if cell.job_id is not None}
        coded = {job_id for job_id in wanted if store.has_coded(job_id, frames[job_id])}
        self.schedule = Schedule(plan, todo, coded)
        jobs = [job for job in plan.jobs if job.id in self.schedule.needed_jobs]
        self.pace = Pace(workers, jobs, todo)
        self.jobs_total, self.jobs_done = len(jobs), 0
        self.not_ok = len(self.kept) - len(ok)
        self.under_way: dict[str, Work] = {}
        self.recoded: Counter[str] = Counter()
        message = "%d cells: %d kept, %d to compute; %d of their coding jobs to encode"
        log.info(message, len(plan.cells), len(self.kept), len(todo), len(jobs))

    def perform(self, interruption: Interruption) -> None:
        for cell in self.plan.cells:
            if cell.unsupported is not None and cell.id not in self.kept:
                self._record(cell, "unsupported", cell.unsupported)
        if not len(self.schedule):
            return
        if self.executor.shares_files:  # elsewhere each machine has a cache of its own, and any worker may be on any
            self.warm_up = kernels_to_compile(self.schedule.cells.values(), self.registry)
        self.executor.start(min(self.workers, len(self.schedule) + len(self.warm_up)), prepare_worker)
        self.warm_up.begin(self.executor, meanwhile=self._hand_out)
        while len(self.schedule) and not interruption.requested:
            self._hand_out()
            finished = self.executor.next_finished(_POLL_S)
            while finished is not None:
                self._take_back(finished)
                self._hand_out()
                finished = self.executor.next_finished(0.0)
        if interruption.requested:
            log.warning("ended by %s; %d jobs and cells were left", interruption.signal_name, len(self.schedule))

    def summary(self, interrupted: str | None) -> RunSummary:
        computed = len(self.statuses) - len(self.kept)
        if self.damaged or self.stale:
            self.store.rebuild_index()
        counts: dict[str, int] = dict(Counter(self.statuses.values()))
        log.info("%s", ", ".join(f"{count} {status}" for status, count in counts.items()) or "nothing recorded")
        kept = len(self.kept)
        return RunSummary(self.store.folder, counts, computed, kept, self.jobs_done, interrupted, self.damaged)

    def _hand_out(self) -> None:
        """Keep every worker busy and one task in reserve for each, so that none waits for this process."""
        while len(self.under_way) < 2 * self.workers and (work := self.schedule.take()) is not None:
            self.under_way[work.id] = work
            self.executor.submit(self._task(work))

    def _task(self, work: Work) -> Task:
        cache_bytes = cache_limit_bytes(self.plan.run.memory_mb)
        limits = {"timeout_s": self.plan.run.timeout_s, "memory_mb": self.plan.run.memory_mb}
        shared = self.executor.shares_files
        if isinstance(work, CodingJob):
            target = self.store.coded_path(work.id).absolute() if shared else None
            return Task(work.id, perform_coding, CodingOrder(work, target, cache_bytes), **limits)  # type: ignore[arg-type]
        coded: Path | bytes | None = None
        if work.job_id is not None:
            path = self.store.coded_path(work.job_id).absolute()
            coded = path if shared else path.read_bytes()
        return Task(work.id, perform_cell, CellOrder(work, coded, cache_bytes), exclusive=work.exclusive, **limits)  # type: ignore[arg-type]

    def _take_back(self, finished: Finished) -> None:
        if self.warm_up.took(finished):
            self._tell()
            return
        work = self.under_way.pop(finished.task_id)
        if isinstance(work, CodingJob):
            self._coded(work, finished)
        else:
            self._computed(work, finished)

    def _coded(self, job: CodingJob, finished: Finished) -> None:
        done: CodingDone = finished.value or CodingDone(finished.status, finished.reason, finished.traceback)
        self.pace.ended(job, done.duration_s)
        self.jobs_done += 1
        if done.status == "ok":
            if done.content is not None:
                self.store.write_coded(job.id, done.content)
            self.schedule.ended(job)
            self._tell()
            return
        for cell in self.schedule.failed(job):
            self._record(cell, done.status, f"coding failed: {done.reason}", done.traceback)

    def _computed(self, cell: Cell, finished: Finished) -> None:
        done: CellDone | None = finished.value
        if done is None:
            self._record(cell, finished.status, finished.reason, finished.traceback)
        elif done.damage is not None and self.recoded[cell.id] == 0:
            assert cell.job_id is not None
            self.recoded[cell.id] += 1
            self.store.drop_coded(cell.job_id, done.damage)
            self.damaged[cell.id] = done.damage
            self.jobs_total += 1
            self.schedule.encode_again(cell)
            return
        else:
            self._keep(cell, done)
        self.schedule.ended(cell)

    def _record(self, cell: Cell, status: Status, reason: str, traceback: str = "") -> None:
        """Record a cell that no worker gave a result for."""
        record = Record(cell.id, status, reason, traceback, cell=cell_description(cell))
        self._write(cell, record, {})

    def _keep(self, cell: Cell, done: CellDone) -> None:
        environment = self.store.write_environment(done.environment)
        self._write(cell, done.record.in_environment(environment), done.files)

    def _write(self, cell: Cell, record: Record, files: dict[str, bytes]) -> None:
        record = self.store.write_record(record, files)
        self.statuses[cell.id] = record.status
        self.not_ok += record.status != "ok"
        if cell.unsupported is None:
            self.pace.ended(cell, record.duration_s or None)
        if record.status not in ("ok", "unsupported"):
            name = f"{cell.sequence.name} | {cell.codec.name} {cell.codec.label}".strip()
            where = f"{name} | {cell.evaluator.name} {cell.evaluator.label}".strip()
            log.warning("%s | repeat %d: %s: %s [%s]", where, cell.repeat, record.status, record.reason, cell.id)
        self._tell(cell, record)

    def _tell(self, cell: Cell | None = None, record: Record | None = None) -> None:
        self.listener(
            Progress(
                cells_total=len(self.plan.cells),
                cells_done=len(self.statuses) - len(self.kept),
                cells_kept=len(self.kept),
                jobs_total=self.jobs_total,
                jobs_done=self.jobs_done,
                not_ok=self.not_ok,
                compiling=self.warm_up.progress,
                elapsed_s=self.pace.elapsed_s,
                remaining_s=self.pace.remaining_s(),
                cell=cell,
                record=record,
            )
        )


def _still_unsupported(cell: Cell, entry: IndexEntry | None) -> bool:
    """Whether what the plan says of a cell is what its record says already."""
    return entry is not None and entry.status == "unsupported" and entry.reason == cell.unsupported
