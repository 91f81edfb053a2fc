"""Record which kernels matrices call, by doing all their work in this process."""

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
    """Raised if something fails while recording: the manifest would lack everything after it."""


def record_kernels(matrices: Iterable[Path], packages: Iterable[str]) -> list[Path]:
    """Write the manifest of each package from the work of the matrices; return the files.

    The first matrix stands for what any work calls; what only a later one calls is compiled later.

    Raises RecordingError if a matrix fails, MatrixError or ManifestError for invalid files, and OSError if a file
    cannot be written, which then is unchanged.
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
    bitstreams: dict[str | None, bytes | None] = {None: None}
    for job in plan.jobs:
        bitstreams[job.id] = _perform_item(WorkItem(job, None, MOST_BYTES), bench).contents[BITSTREAMS]
    for cell in plan.cells:
        _perform_item(WorkItem(cell, bitstreams[cell.job_id], MOST_BYTES), bench)


def _perform_item(item: WorkItem, bench: Workbench) -> Record:
    """Perform work and return its record. Raises RecordingError if it failed."""
    outcome = perform(item, bench)
    if isinstance(outcome, Record) and outcome.status == "ok":
        return outcome
    work, reason = item.work, outcome.reason if isinstance(outcome, Record) else outcome
    evaluator = [] if isinstance(work, CodingJob) else [work.evaluator.name]
    raise RecordingError(f"{' | '.join([work.sequence.name, work.codec.title, *evaluator])}: {reason}")


@contextmanager
def _empty_cache() -> Iterator[None]:
    """Use an empty cache in the block, so that everything is compiled and rendered anew."""
    before = os.environ.get("CODECBENCH_CACHE")
    with tempfile.TemporaryDirectory(prefix="codecbench-recording-") as folder:
        os.environ["CODECBENCH_CACHE"] = folder
        try:
            yield
        finally:
            os.environ.pop("CODECBENCH_CACHE")
            if before is not None:
                os.environ["CODECBENCH_CACHE"] = before
