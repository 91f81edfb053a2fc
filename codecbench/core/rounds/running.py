"""Running a matrix from Python: `codecbench.run("matrix.yaml")`."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from codecbench.core.engine.planning.matrix import Matrix
from codecbench.core.engine.planning.model import Cell, Plan, PluginSetting
from codecbench.core.engine.planning.plan import make_plan
from codecbench.core.engine.plugins.registry import installed
from codecbench.core.engine.running.run import Listener, run_plan
from codecbench.core.engine.running.summary import RunSummary

if TYPE_CHECKING:
    from codecbench.core.rounds.growth import Growth


def run_matrix(
    matrix: Matrix,
    out: str | Path | None,
    *,
    workers: int | None = None,
    recompute: Iterable[str] = (),
    listener: Listener | None = None,
    log_level: int = logging.INFO,
    minutes: float | None = None,
) -> RunSummary:
    """Compute what is missing of a matrix, round by round where its plan grows; parameters as of `run`.

    minutes: rounds of nothing but more repeats begin only within that time, and trials of searches if they can be
    expected to end within it.
    """
    plan, folder, growth = planned(matrix, out)
    rounds = growth if growth is None or minutes is None else _repeated_within(minutes, growth)
    return run_plan(
        plan, folder, workers=workers, recompute=recompute, listener=listener, log_level=log_level, growth=rounds
    )


def _repeated_within(minutes: float, growth: Growth) -> Callable[[Plan], Plan]:
    """The growth of a plan that ends within so many minutes from now on: without more repeats once they have passed,
    and without more trials of searches that could not be done by then."""
    growth.end_s = end_s = time.monotonic() + 60.0 * minutes

    def grown(plan: Plan) -> Plan:
        larger = growth(plan)
        if time.monotonic() < end_s:
            return larger
        known = {_repeated(cell) for cell in plan.cells}
        return (
            larger
            if any(_repeated(cell) not in known for cell in larger.cells)
            else replace(plan, searches=larger.searches)
        )

    return grown


def _repeated(cell: Cell) -> tuple[str, PluginSetting, str]:
    """What all repeats of a cell have in common."""
    return cell.sequence.name, cell.codec, cell.evaluator.title


def planned(matrix: Matrix, out: str | Path | None) -> tuple[Plan, Path, Growth | None]:
    """The plan of a matrix as far as its run folder leads, that folder, and how it grows; None where it does not."""
    folder = Path(out) if out is not None else Path("runs") / matrix.name
    grows = matrix.searches or matrix.until is not None or any(entry.requires for entry in matrix.evaluators)
    if not grows:
        return make_plan(matrix), folder, None
    from codecbench.core.rounds.growth import Growth  # tables and statistics take a second to load

    growth = Growth(matrix, folder, installed())
    return growth.planned(), folder, growth
