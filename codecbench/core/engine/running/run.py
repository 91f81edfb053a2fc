"""The run loop: submits ready work and records results; `resume` determines what needs no computing."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from codecbench.core.contracts.errors import StoreError
from codecbench.core.contracts.executor import Executor, Finished, Status
from codecbench.core.engine.hosting.confinement import confinement, is_confinement_requested
from codecbench.core.engine.planning.estimate import typical_costs_ms
from codecbench.core.engine.planning.model import Cell, CodingJob, Plan
from codecbench.core.engine.plugins.fingerprint import code_label
from codecbench.core.engine.plugins.registry import Registry, installed
from codecbench.core.engine.running.code_changes import BITSTREAMS_LABEL
from codecbench.core.engine.running.progress import Pace, Progress, RunSummary, headline_words
from codecbench.core.engine.running.resume import Resumption, resume
from codecbench.core.engine.running.run_context import Interruption, log_to
from codecbench.core.engine.running.schedule import Schedule, Work
from codecbench.core.engine.running.warm_up import WarmUp, kernels_to_compile
from codecbench.core.engine.running.work import BITSTREAMS, outcome_of, prepare_worker, task_of
from codecbench.core.engine.storage.bitstream_file import BitstreamDamage
from codecbench.core.engine.storage.record import Record, cell_description
from codecbench.core.engine.storage.store import Store

log = logging.getLogger("codecbench.run")

Listener = Callable[[Progress], None]
Growth = Callable[[Plan], Plan]
"""Returns the plan extended by the cells to compute next, now that all of its cells have ended."""

_POLL_S = 0.2


def run_plan(
    plan: Plan,
    folder: Path,
    *,
    workers: int | None = None,
    recompute: Iterable[str] = (),
    listener: Listener | None = None,
    registry: Registry | None = None,
    log_level: int = logging.INFO,
    growth: Growth | None = None,
) -> RunSummary:
    """Compute what is missing of a plan and record it in `folder`; `growth` is called for more until there is none.

    recompute: names of codecs, evaluators and sequences whose cells are computed again. The listener is called after
    every job and cell. SIGINT, SIGTERM and SIGHUP end the run within seconds; everything recorded is kept.

    Raises StoreError if the folder is in use or cannot be written, and ParamsError for a name in `recompute` that the
    plan does not have. Raises CodecbenchError if plugins are to be confined and cannot be.
    """
    store = Store(folder)
    setting = plan.run.executor
    registry = registry or installed()
    with store.locked(), log_to(store.log_path, log_level), Interruption() as interruption:
        executor: Executor[Any] = registry.create("executor", setting.name, setting.params)
        if is_confinement_requested():
            confinement()
        resumption = resume(plan, store, registry, recompute)
        workers, listener = workers or plan.run.workers, listener or (lambda _: None)
        run = _Run(plan, store, executor, registry, workers, listener, grows=growth is not None)
        try:
            run.enqueue(plan, plan.cells, resumption)
            run.perform(interruption)
            while growth is not None and not interruption.requested and run.grow(growth(run.plan)):
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
        self,
        plan: Plan,
        store: Store,
        executor: Executor[Any],
        registry: Registry,
        workers: int,
        listener: Listener,
        *,
        grows: bool,
    ) -> None:
        self.plan, self.store, self.executor, self.workers, self.listener = plan, store, executor, workers, listener
        self.registry, self.grows, self.warm_up, self.started = registry, grows, WarmUp(), False
        self.resumptions: list[Resumption] = []
        self.kept: dict[str, Status] = {}
        self.statuses: dict[str, Status] = {}
        self.damaged: dict[str, str] = {}
        self.pace = Pace(workers, typical_costs_ms(plan))
        self.jobs_total, self.jobs_done, self.not_ok = 0, 0, 0
        self.under_way: dict[str, Work] = {}
        self.recoded: Counter[str] = Counter()

    def grow(self, plan: Plan) -> bool:
        """Continue with a plan that has grown; return whether it has new cells."""
        more = tuple(cell for cell in plan.cells if cell.id not in self.statuses)
        if more:
            self.enqueue(plan, more, resume(replace(plan, cells=more, jobs=()), self.store, self.registry))
        elif plan != self.plan:
            self.plan = plan
            self.store.write_plan(plan)
        return bool(more)

    def enqueue(self, plan: Plan, cells: Sequence[Cell], resumption: Resumption) -> None:
        """Add cells of a plan to the work, except those that an earlier run computed."""
        self.plan = plan
        self.store.write_plan(plan)
        self.resumptions.append(resumption)
        self.kept |= resumption.kept
        self.statuses |= resumption.kept
        self.damaged |= resumption.damaged
        left = [cell for cell in cells if cell.id not in resumption.kept]
        todo = [cell for cell in left if cell.unsupported is None]
        frames = {job.id: job.sequence.frames for job in plan.jobs}
        job_ids = {cell.job_id for cell in todo if cell.job_id is not None}
        coded = {job_id for job_id in job_ids if self.store.has_coded(job_id, frames[job_id])}
        self.schedule = Schedule(plan, todo, coded)
        self.unsupported = [cell for cell in left if cell.unsupported is not None]
        jobs = [job for job in plan.jobs if job.id in self.schedule.needed_jobs]
        self.pace.expect(jobs, todo)
        self.jobs_total += len(jobs)
        self.not_ok += sum(status != "ok" for status in resumption.kept.values())
        message = "%d cells: %d kept, %d to compute; %d of their coding jobs to encode"
        log.info(message, len(cells), len(resumption.kept), len(todo), len(jobs))
        notes = [f"{entry.name}: {note}" for entry in plan.sequences for note in entry.notes]
        for notice in (*(notes if len(self.resumptions) == 1 else ()), *resumption.notices):
            log.warning("%s", notice)
            self._report(notice=notice)

    def perform(self, interruption: Interruption) -> None:
        for cell in self.unsupported:
            self._record(cell, Record(cell.id, "unsupported", cell.unsupported or ""))
        if not len(self.schedule):
            return
        self._start()
        while len(self.schedule) and not interruption.requested:
            self._submit_ready()
            finished = self.executor.next_finished(_POLL_S)
            while finished is not None:
                if interruption.requested and finished.status == "crashed":
                    break  # the signal may have killed the worker, which says nothing about the cell
                self._handle_finished(finished)
                self._submit_ready()
                finished = self.executor.next_finished(0.0)
        if interruption.requested:
            log.warning("ended by %s; %d jobs and cells were left", interruption.signal_name, len(self.schedule))

    def _start(self) -> None:
        """Determine which kernels the cells will call, and start the workers."""
        if not self.warm_up and self.executor.shares_files:  # otherwise each machine has its own cache
            self.warm_up = kernels_to_compile(self.schedule.cells.values(), self.registry)
        if not self.started:
            waiting = len(self.schedule) + len(self.warm_up)
            self.executor.start(self.workers if self.grows else min(self.workers, waiting), prepare_worker)
            self.started = True

    def summary(self, interrupted: str | None) -> RunSummary:
        computed = len(self.statuses) - len(self.kept)
        if (
            any(resumption.damaged or resumption.outdated or resumption.retried for resumption in self.resumptions)
            or self.damaged
        ):
            self.store.rebuild_index()
        planned = [cell.id for cell in self.plan.cells if cell.id in self.statuses]
        counts: dict[str, int] = dict(Counter(self.statuses[id_] for id_ in planned))
        log.info("%s", ", ".join(f"{count} {status}" for status, count in counts.items()) or "nothing recorded")
        kept_count = sum(id_ in self.kept for id_ in planned)
        jobs, notices = (
            self.jobs_done,
            tuple(notice for resumption in self.resumptions for notice in resumption.notices),
        )
        return RunSummary(self.store.folder, counts, computed, kept_count, jobs, interrupted, self.damaged, notices)

    def _submit_ready(self) -> None:
        """Keep every worker busy, with one task in reserve for each, so that none waits for this process.

        While kernels are compiled, work that needs none of the remaining ones goes first. There is then no reserve,
        because such work would have to wait for it.
        """
        while (busy := len(self.under_way) + self.warm_up.under_way) < 2 * self.workers:
            work = self.schedule.take(self._is_ready if self.warm_up else None)
            if work is not None:
                self.under_way[work.id] = work
                self.executor.submit(task_of(work, self.plan.run, self.store, self.executor.shares_files))
            elif busy < self.workers and (kernel := self.warm_up.take()) is not None:
                self.executor.submit(kernel)
            else:
                return

    def _is_ready(self, work: Work) -> bool:
        """Whether the kernels that the work calls are compiled.

        The first job runs ahead and alone: others find the frames that it has rendered, unpacked or fetched.
        """
        if self.jobs_total and not self.jobs_done:
            return isinstance(work, CodingJob) and not self.under_way
        return self.warm_up.is_ready(work.id)

    def _handle_finished(self, finished: Finished) -> None:
        if self.warm_up.finish(finished):
            self._report()
            return
        work = self.under_way.pop(finished.task_id)
        outcome = outcome_of(work, finished)
        if isinstance(outcome, OSError):
            raise self.store.refusal(outcome) from outcome
        if isinstance(work, CodingJob):
            assert isinstance(outcome, Record)
            self._handle_coded(work, outcome)
        elif isinstance(outcome, BitstreamDamage) and self.recoded[work.id] == 0:
            self._encode_again(work, str(outcome))
        else:
            record = Record(work.id, "failed", str(outcome)) if isinstance(outcome, BitstreamDamage) else outcome
            self._record(work, self._with_encoder(work, record))
            self.schedule.finish(work)

    def _handle_coded(self, job: CodingJob, record: Record) -> None:
        self.pace.finish(job, record.duration_s, _process(record))
        self.jobs_done += 1
        if record.status == "ok":
            if BITSTREAMS in record.contents:
                self.store.write_coded(job.id, record.contents[BITSTREAMS])
            self.store.note_encoder(job.id, record.code.get(code_label("codec", job.codec.name), ""))
            self.schedule.finish(job)
            self._report()
            return
        for cell in self.schedule.fail(job):
            self._record(cell, Record(cell.id, record.status, f"coding failed: {record.reason}", record.traceback))

    def _encode_again(self, cell: Cell, damage: str) -> None:
        """Encode the damaged bitstreams of a cell again, once."""
        assert cell.job_id is not None
        self.recoded[cell.id] += 1
        self.store.drop_coded(cell.job_id, damage)
        self.damaged[cell.id] = damage
        self.jobs_total += self.schedule.encode_again(cell)

    def _record(self, cell: Cell, record: Record) -> None:
        """Record the result of a cell; a record that no worker made gets the cell's description."""
        record = self.store.write_record(record if record.cell else replace(record, cell=cell_description(cell)))
        self.statuses[cell.id] = record.status
        self.not_ok += record.status != "ok"
        if cell.unsupported is None:
            self.pace.finish(cell, record.duration_s or None, _process(record))
        if record.status not in ("ok", "unsupported"):
            name = f"{cell.sequence.name} | {cell.codec.name} {cell.codec.label}".strip()
            where = f"{name} | {cell.evaluator.name} {cell.evaluator.label}".strip()
            log.warning("%s | repeat %d: %s: %s [%s]", where, cell.repeat, record.status, record.reason, cell.id)
        self._report(cell, record)

    def _with_encoder(self, cell: Cell, record: Record) -> Record:
        """Add to a record the code that encoded the cell's bitstreams, if it is known."""
        encoder = self.store.encoders.read(cell.job_id) if cell.job_id is not None else ""
        return replace(record, code=record.code | {BITSTREAMS_LABEL: encoder}) if encoder and record.code else record

    def _report(self, cell: Cell | None = None, record: Record | None = None, notice: str = "") -> None:
        self.listener(
            Progress(
                cells_total=len(self.plan.cells),
                cells_done=len(self.statuses) - len(self.kept),
                cells_kept=len(self.kept),
                jobs_total=self.jobs_total,
                jobs_done=self.jobs_done,
                not_ok=self.not_ok,
                compiling=self.warm_up.progress,
                notice=notice,
                elapsed_s=self.pace.elapsed_s,
                remaining_s=self.pace.remaining_s(),
                cell=cell,
                record=record,
                measured=headline_words(cell, record, self.plan.declared) if cell and record else "",
            )
        )


def _process(record: Record) -> tuple[str, int] | None:
    """Return host and process id of the worker that made a record; None if no worker did."""
    return (record.worker["host"], record.worker["pid"]) if record.worker else None
