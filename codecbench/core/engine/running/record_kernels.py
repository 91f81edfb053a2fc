"""Which kernels matrices call, found out by doing all their work in this process."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from codecbench.core.contracts.errors import CodecbenchError
from codecbench.core.engine.planning.matrix import read_matrix
from codecbench.core.engine.planning.model import CodingJob, Plan
from codecbench.core.engine.planning.plan import make_sampled_plan
from codecbench.core.engine.plugins.registry import everything
from codecbench.core.engine.running.frame_cache import MOST_BYTES
from codecbench.core.engine.running.work import BITSTREAMS, WorkItem, perform
from codecbench.core.engine.running.workbench import Workbench
from codecbench.core.engine.storage.atomic import write_file
from codecbench.core.engine.storage.record import Record
from codecbench.core.kernels import manifest


class RecordingError(CodecbenchError):
    """Something failed while kernels were recorded: the manifest would lack whatever comes after."""


def record_kernels(matrices: Iterable[Path], packages: Iterable[str]) -> list[Path]:
    """Write the manifest of each package from the work of the matrices; returns the files.

    The first matrix stands for what any work calls; what only a later one calls is compiled later.

    Raises RecordingError where something of a matrix fails, MatrixError and ManifestError as their names say, and
    OSError where a file cannot be written, which then is as it was.
    """
    bench = Workbench(registry=everything())
    bench.hosts_none = True
    with _empty_cache(), manifest.record_compilations() as recorder:
        for recorder.stage, matrix in enumerate(matrices):
            _perform(make_sampled_plan(read_matrix(matrix)), bench)
    files = dict(manifest.manifest_file(package, recorder.entries) for package in packages)
    for path, content in files.items():
        write_file(path, content)
    return list(files)


def _perform(plan: Plan, bench: Workbench) -> None:
    coded: dict[str | None, bytes | None] = {None: None}
    for job in plan.jobs:
        coded[job.id] = _perform_item(WorkItem(job, None, MOST_BYTES), bench).contents[BITSTREAMS]
    for cell in plan.cells:
        _perform_item(WorkItem(cell, coded[cell.job_id], MOST_BYTES), bench)


def _perform_item(order: WorkItem, bench: Workbench) -> Record:
    """The record of work that was done. Raises RecordingError where it failed."""
    outcome = perform(order, bench)
    if isinstance(outcome, Record) and outcome.status == "ok":
        return outcome
    work, reason = order.work, outcome.reason if isinstance(outcome, Record) else outcome
    evaluator = [] if isinstance(work, CodingJob) else [work.evaluator.name]
    raise RecordingError(f"{' | '.join([work.sequence.name, work.codec.title, *evaluator])}: {reason}")


@contextmanager
def _empty_cache() -> Iterator[None]:
    """Meanwhile nothing that was compiled or rendered before is found."""
    before = os.environ.get("CODECBENCH_CACHE")
    with tempfile.TemporaryDirectory(prefix="codecbench-recording-") as folder:
        os.environ["CODECBENCH_CACHE"] = folder
        try:
            yield
        finally:
            os.environ.pop("CODECBENCH_CACHE")
            if before is not None:
                os.environ["CODECBENCH_CACHE"] = before
