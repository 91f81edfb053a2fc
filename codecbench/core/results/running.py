"""Running a matrix from Python: `codecbench.run("matrix.yaml")`."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from codecbench.core.engine.planning.matrix import Matrix, matrix_from, read_matrix
from codecbench.core.engine.planning.model import Plan
from codecbench.core.engine.planning.plan import make_plan
from codecbench.core.engine.registry import installed
from codecbench.core.engine.running.run import Listener, run_plan
from codecbench.core.engine.running.summary import RunSummary

if TYPE_CHECKING:
    from codecbench.core.results.rounds.growth import Growth
    from codecbench.core.results.run_result import RunResult


def run(
    matrix: str | Path | Mapping[str, Any],
    *,
    out: str | Path | None = None,
    workers: int | None = None,
    recompute: Iterable[str] = (),
    listener: Listener | None = None,
    log_level: int = logging.INFO,
) -> RunResult:
    """Compute what is missing of a matrix and return its results.

    matrix: a file, or what would stand in one as a dict, whose paths start at the working directory. out: the run
    folder, by default `runs/NAME`. workers: processes, by default what the matrix says. recompute: names of codecs,
    evaluators and sequences whose cells are computed again. listener: called with the progress after every job and
    cell. Cells that fail are rows of the result, not exceptions. Raises MatrixError for a
    wrong matrix, ParamsError for a name to recompute that it does not have, and StoreError for a folder that is in use.

    Workers are processes of their own, so a script that calls this needs no `if __name__ == "__main__"`.
    """
    from codecbench.core.results.collect import open_run

    read = matrix_from(matrix) if isinstance(matrix, Mapping) else read_matrix(matrix)
    summary = run_matrix(read, out, workers=workers, recompute=recompute, listener=listener, log_level=log_level)
    return open_run(summary.folder)


def run_matrix(
    matrix: Matrix,
    out: str | Path | None,
    *,
    workers: int | None = None,
    recompute: Iterable[str] = (),
    listener: Listener | None = None,
    log_level: int = logging.INFO,
) -> RunSummary:
    """Compute what is missing of a matrix, round by round where it searches; parameters as of `run`."""
    plan, folder, growth = planned(matrix, out)
    return run_plan(
        plan, folder, workers=workers, recompute=recompute, listener=listener, log_level=log_level, growth=growth
    )


def planned(matrix: Matrix, out: str | Path | None) -> tuple[Plan, Path, Growth | None]:
    """The plan of a matrix as far as its run folder leads, that folder, and how it grows; None where it does not."""
    folder = Path(out) if out is not None else Path("runs") / matrix.name
    if not matrix.searches and matrix.until is None:
        return make_plan(matrix), folder, None
    from codecbench.core.results.rounds.growth import Growth  # tables and statistics take a second to load

    growth = Growth(matrix, folder, installed())
    return growth.planned(), folder, growth
