"""Which kernels a matrix calls, found out by doing all its work in this process."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from codecbench.core.contracts.errors import CodecbenchError
from codecbench.core.engine.planning.matrix import read_matrix
from codecbench.core.engine.planning.plan import make_plan
from codecbench.core.engine.running.work import CellOrder, CodingOrder, perform_cell, perform_coding
from codecbench.core.kernels import manifest


class RecordingError(CodecbenchError):
    """A job or cell failed while kernels were recorded, so that the manifest would lack what comes after."""


def record_kernels(matrix: Path, packages: Iterable[str]) -> list[Path]:
    """Write the manifest of each package from a run of the matrix; returns the files.

    Raises RecordingError where something of the matrix fails, MatrixError and ManifestError as their names say.
    """
    with manifest.recording() as entries:
        plan = make_plan(read_matrix(matrix))
        coded: dict[str | None, bytes | None] = {None: None}
        for job in plan.jobs:
            done = perform_coding(CodingOrder(job, None))
            if done.status != "ok":
                raise RecordingError(f"{job.sequence.name} | {job.codec.name} {job.codec.label}: {done.reason}")
            coded[job.id] = done.content
        for cell in plan.cells:
            record = perform_cell(CellOrder(cell, coded[cell.job_id])).record
            if record.status != "ok":
                raise RecordingError(f"{cell.sequence.name} | {cell.evaluator.name}: {record.reason}")
    return [manifest.write(package, entries) for package in packages]
