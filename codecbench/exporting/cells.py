"""Selects the cells of a run whose results are exported."""

from __future__ import annotations

from dataclasses import replace

from codecbench.core.analysis import collect
from codecbench.core.analysis.table import CellResult
from codecbench.core.contracts.errors import SlamError
from codecbench.core.engine.planning.model import CodingJob, Plan
from codecbench.core.engine.plugins import registry
from codecbench.core.engine.storage.store import Store
from codecbench.plugins.evaluators.trajectory import TrajectoryEvaluator


def results_of(store: Store, plan: Plan, job: CodingJob) -> tuple[CellResult, ...]:
    """The results of the cells that read the bitstreams of a job, without comparisons with the baseline."""
    cells = tuple(cell for cell in plan.cells if cell.job_id == job.id)
    return collect.read_run(store, replace(plan, cells=cells), registry.installed()).results


def slam_result(results: tuple[CellResult, ...], title: str | None, repeat: int) -> CellResult:
    """Return a computed cell of the evaluator `trajectory`.

    title: of the evaluator's setting, as in tables; None for the first. Raises SlamError if there is none.
    """
    slam = [result for result in results if result.cell.evaluator.name == TrajectoryEvaluator.name]
    titles = list(dict.fromkeys(result.cell.evaluator.title for result in slam))
    if not slam:
        raise SlamError("the run has no trajectory of this setting; add `trajectory` to its evaluators and run again")
    if title is not None and title not in titles:
        raise SlamError(f"the run has no trajectory of evaluator {title}; it has {', '.join(titles)}")
    of_title = {result.cell.repeat: result for result in slam if result.cell.evaluator.title == (title or titles[0])}
    if repeat not in of_title:
        raise SlamError(f"{title or titles[0]} has no repeat {repeat}; it has {', '.join(map(str, of_title))}")
    result = of_title[repeat]
    if result.status != "ok":
        raise SlamError(f"{title or titles[0]} has no trajectory of repeat {repeat}: {result.status}, {result.reason}")
    return result
