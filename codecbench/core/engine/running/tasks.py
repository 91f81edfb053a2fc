"""What of a run's work is handed to an executor, a job or cell as a task with what its worker needs, and the answer."""

from __future__ import annotations

from pathlib import Path

from codecbench.core.contracts.executor import Finished, Task
from codecbench.core.engine.hosting.confinement import wanted
from codecbench.core.engine.planning.model import Cell, CodingJob, RunSettings
from codecbench.core.engine.running.frame_cache import cache_limit_bytes
from codecbench.core.engine.running.schedule import Work
from codecbench.core.engine.running.work import WorkItem, perform
from codecbench.core.engine.storage.bitstream_file import BitstreamDamage
from codecbench.core.engine.storage.record import Record
from codecbench.core.engine.storage.store import Store
from codecbench.core.engine.text import clean_line, clean_text


def task_of(work: Work, settings: RunSettings, store: Store, shares_files: bool) -> Task:
    """A job or cell as a task. shares_files: the executor's workers see the run folder."""
    order = WorkItem(work, _bitstreams(work, store, shares_files), cache_limit_bytes(settings.memory_mb), wanted())
    exclusive = isinstance(work, Cell) and work.exclusive
    limits = settings.timeout_s, settings.memory_mb
    return Task(work.id, perform, order, *limits, exclusive)


def _bitstreams(work: Work, store: Store, shares_files: bool) -> Path | bytes | None:
    """Where a job writes its bitstreams or a cell reads them; their content where workers do not see the folder."""
    job_id = work.id if isinstance(work, CodingJob) else work.job_id
    if job_id is None:
        return None
    path = store.coded_path(job_id).absolute()
    if shares_files:
        return path
    return None if isinstance(work, CodingJob) else path.read_bytes()


def outcome_of(work: Work, finished: Finished) -> Record | BitstreamDamage | OSError:
    """The record, the damage or the full disk that a task of this work ended with.

    `worker` of a record is empty where none lived to tell.
    """
    if finished.status == "ok":
        return finished.value  # type: ignore[no-any-return]
    strangers = [plugin.full_name for plugin in work.plugins if plugin.distribution]
    doing = "encoding" if isinstance(work, CodingJob) else "evaluating"
    reason = f"{' or '.join(strangers)} while {doing}: {finished.reason}" if strangers else finished.reason
    return Record(work.id, finished.status, clean_line(reason), clean_text(finished.traceback))
