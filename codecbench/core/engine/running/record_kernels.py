"""Which kernels matrices call, found out by doing all their work in this process."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from codecbench.core.contracts.errors import CodecbenchError
from codecbench.core.engine.planning.matrix import read_matrix
from codecbench.core.engine.planning.model import Plan
from codecbench.core.engine.planning.plan import make_plan
from codecbench.core.engine.running.work import CellOrder, CodingOrder, perform_cell, perform_coding
from codecbench.core.kernels import manifest


class RecordingError(CodecbenchError):
    """Something failed while kernels were recorded: the manifest would lack whatever comes after."""


def record_kernels(matrices: Iterable[Path], packages: Iterable[str]) -> list[Path]:
    """Write the manifest of each package from the work of the matrices; returns the files.

    Raises RecordingError where something of a matrix fails, MatrixError and ManifestError as their names say.
    """
    with _empty_cache(), manifest.recording() as entries:
        for matrix in matrices:
            _perform(make_plan(read_matrix(matrix)))
    return [manifest.write(package, entries) for package in packages]


def _perform(plan: Plan) -> None:
    coded: dict[str | None, bytes | None] = {None: None}
    for job in plan.jobs:
        done = perform_coding(CodingOrder(job, None))
        if done.status != "ok":
            raise RecordingError(f"{job.sequence.name} | {job.codec.name} {job.codec.label}: {done.reason}")
        coded[job.id] = done.content
    for cell in plan.cells:
        record = perform_cell(CellOrder(cell, coded[cell.job_id])).record
        if record.status != "ok":
            what = f"{cell.sequence.name} | {cell.codec.name} {cell.codec.label} | {cell.evaluator.name}"
            raise RecordingError(f"{what}: {record.reason}")


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
