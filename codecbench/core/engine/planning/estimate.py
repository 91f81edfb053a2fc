"""Estimate a plan's run time from durations measured in the same folder, or from declared typical costs."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from codecbench.core.engine.planning.model import Cell, Plan

TYPICAL_CELL_S: Final = 0.5
"""Cost of an evaluator that looks at a few frames, whatever the length of the sequence."""
TYPICAL_CODING_MS: Final = 25.0
START_S: Final = 5.0
"""Upper bound on what a worker needs before its first work of a kind: imports and loading kernels."""


@dataclass(frozen=True)
class Estimate:
    """Estimated wall time."""

    seconds: float
    measured: int
    """Number of cells estimated from measured durations."""
    typical: int
    """Number of cells estimated from typical costs."""


def estimate(plan: Plan, missing: list[Cell], jobs: int, durations: Mapping[str, float]) -> Estimate:
    """Estimate the wall time of the missing cells and of the coding jobs without a file, spread over the workers.

    durations: seconds of finished cells by id. A cell's estimate is the median cost per frame of finished cells of the
    same codec and evaluator. Without any, it is what the evaluator declares as typical, scaled by how finished cells
    compared with their declarations.
    """
    declared = typical_costs_ms(plan)
    costs: dict[tuple[str, str], list[float]] = defaultdict(list)
    measured_s = declared_s = 0.0
    for cell in plan.cells:
        if cell.id in durations and cell.sequence.frames:
            costs[cell.codec.name, cell.evaluator.name].append(durations[cell.id] / cell.sequence.frames)
            if typical := declared.get(cell.evaluator.title):
                measured_s += durations[cell.id]
                declared_s += typical / 1000 * cell.sequence.frames
    slowness = measured_s / declared_s if declared_s else 1.0
    shared_s = exclusive_s = 0.0
    measured = 0
    for cell in missing:
        costs_per_frame = sorted(costs.get((cell.codec.name, cell.evaluator.name), []))
        typical = declared.get(cell.evaluator.title)
        if costs_per_frame:
            seconds = costs_per_frame[len(costs_per_frame) // 2] * cell.sequence.frames
            measured += 1
        else:
            seconds = TYPICAL_CELL_S if typical is None else slowness * typical / 1000 * cell.sequence.frames
        if cell.exclusive:
            exclusive_s += seconds
        else:
            shared_s += seconds
    frames = max((entry.frames for entry in plan.sequences), default=0)
    shared_s += jobs * slowness * TYPICAL_CODING_MS / 1000 * frames
    total = START_S + shared_s / plan.run.workers + exclusive_s if missing else 0.0
    return Estimate(total, measured, len(missing) - measured)


def typical_costs_ms(plan: Plan) -> dict[str, float]:
    """Return milliseconds per frame by evaluator title, for evaluators that declare a typical cost."""
    costs = {
        title: declared.get("typical_ms_per_frame") for title, declared in plan.declared.get("evaluators", {}).items()
    }
    return {title: float(cost) for title, cost in costs.items() if isinstance(cost, int | float)}
