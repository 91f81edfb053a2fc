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
from codecbench.core.engine.running.progress import RunSummary
from codecbench.core.engine.running.run import Listener, run_plan

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
    """Compute the missing cells of a matrix, round by round if its plan grows; parameters as of `run`.

    minutes: rounds of only more repeats begin within that time, and trials of searches if they can be expected to end
    within it.
    """
    plan, folder, growth = plan_matrix(matrix, out)
    rounds = growth if growth is None or minutes is None else _limit_to(minutes, growth)
    return run_plan(
        plan, folder, workers=workers, recompute=recompute, listener=listener, log_level=log_level, growth=rounds
    )


def _limit_to(minutes: float, growth: Growth) -> Callable[[Plan], Plan]:
    """Limit the growth of a plan to so many minutes from now.

    No repeats are added after that time, and no trials of searches that would not finish by then."""
    growth.end_s = end_s = time.monotonic() + 60.0 * minutes

    def grow(plan: Plan) -> Plan:
        larger = growth(plan)
        if time.monotonic() < end_s:
            return larger
        known = {_without_repeat(cell) for cell in plan.cells}
        return (
            larger
            if any(_without_repeat(cell) not in known for cell in larger.cells)
            else replace(plan, searches=larger.searches)
        )

    return grow


def _without_repeat(cell: Cell) -> tuple[str, PluginSetting, str]:
    """What all repeats of a cell have in common."""
    return cell.sequence.name, cell.codec, cell.evaluator.title


def plan_matrix(matrix: Matrix, out: str | Path | None) -> tuple[Plan, Path, Growth | None]:
    """Plan a matrix as far as its run folder allows; return the plan, the folder, and its growth if it can grow."""
    folder = Path(out) if out is not None else Path("runs") / matrix.name
    grows = matrix.searches or matrix.until is not None or any(entry.requires for entry in matrix.evaluators)
    if not grows:
        return make_plan(matrix), folder, None
    from codecbench.core.rounds.growth import Growth  # its tables and statistics take a second to load

    growth = Growth(matrix, folder, installed())
    return growth.first_plan(), folder, growth
