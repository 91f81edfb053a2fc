"""Which cells of a run are computed again."""

from __future__ import annotations

import random
from collections.abc import Mapping

from codecbench.core.contracts.metric import Metric
from codecbench.core.engine.planning.declared import read_declared
from codecbench.core.engine.planning.model import Cell, Plan


def repeatable_metrics(plan: Plan, title: str) -> set[str] | None:
    """The metrics of an evaluator, by its title, that equal code gives again; None where the plan does not tell."""
    declared = plan.declared.get("evaluators", {}).get(title, {}).get("metrics")
    if not isinstance(declared, list):
        return None
    metrics = [read_declared(Metric, value) for value in declared if isinstance(value, dict)]
    return {metric.name for metric in metrics if metric is not None and metric.repeatable}


def verifiable_cells(plan: Plan, statuses: Mapping[str, str]) -> list[Cell]:
    """Cells that have a result of which something can be compared: times and the like never come out the same."""
    titles = dict.fromkeys(cell.evaluator.title for cell in plan.cells)
    nothing = {title for title in titles if repeatable_metrics(plan, title) == set()}
    return [cell for cell in plan.cells if statuses.get(cell.id) == "ok" and cell.evaluator.title not in nothing]


def sampled(cells: list[Cell], count: int, seed: int) -> list[Cell]:
    """`count` of the cells, each equally likely, in their order; equal seeds choose equal cells."""
    ids = sorted(cell.id for cell in cells)
    chosen = set(random.Random(seed).sample(ids, min(count, len(ids))))
    return [cell for cell in cells if cell.id in chosen]
