"""How long a plan may take: from durations measured in the same folder, else from typical costs."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from codecbench.core.engine.planning.model import Cell, Plan

TYPICAL_CELL_S: Final = 0.5
"""Evaluators that look at a few frames, whatever the length of the sequence."""
TYPICAL_CODING_MS: Final = 25.0
START_S: Final = 5.0
"""What a worker takes at most for the first work of a kind: to import what it needs and to load its kernels."""


@dataclass(frozen=True)
class Estimate:
    """Seconds of wall time, and how many of the cells were estimated from measured durations."""

    seconds: float
    measured: int
    typical: int


def estimate(plan: Plan, missing: list[Cell], jobs: int, durations: Mapping[str, float]) -> Estimate:
    """The time for the missing cells and the coding jobs that have no file yet, spread over the workers.

    durations: seconds of finished cells by id. A cell is estimated from the median cost per frame of finished
    cells of the same codec and evaluator, where there are any, else from what its evaluator declares as typical, as
    many times as finished cells took what theirs declare.
    """
    declared = typical_costs_ms(plan)
    costs: dict[tuple[str, str], list[float]] = defaultdict(list)
    taken = expected = 0.0
    for cell in plan.cells:
        if cell.id in durations and cell.sequence.frames:
            costs[cell.codec.name, cell.evaluator.name].append(durations[cell.id] / cell.sequence.frames)
            if typical := declared.get(cell.evaluator.title):
                taken += durations[cell.id]
                expected += typical / 1000 * cell.sequence.frames
    slowness = taken / expected if expected else 1.0
    shared = alone = 0.0
    measured = 0
    for cell in missing:
        known = sorted(costs.get((cell.codec.name, cell.evaluator.name), []))
        typical = declared.get(cell.evaluator.title)
        if known:
            seconds = known[len(known) // 2] * cell.sequence.frames
            measured += 1
        else:
            seconds = TYPICAL_CELL_S if typical is None else slowness * typical / 1000 * cell.sequence.frames
        if cell.exclusive:
            alone += seconds
        else:
            shared += seconds
    frames = max((entry.frames for entry in plan.sequences), default=0)
    shared += jobs * slowness * TYPICAL_CODING_MS / 1000 * frames
    total = START_S + shared / plan.run.workers + alone if missing else 0.0
    return Estimate(total, measured, len(missing) - measured)


def typical_costs_ms(plan: Plan) -> dict[str, float]:
    """Milliseconds a frame by the title of an evaluator's setting, of those that declare them."""
    told = {title: of.get("typical_ms_per_frame") for title, of in plan.declared.get("evaluators", {}).items()}
    return {title: float(cost) for title, cost in told.items() if isinstance(cost, int | float)}
