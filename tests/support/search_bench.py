"""A bench for searches: the rounds of a matrix, its cells computed by functions of the test instead of by workers."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from importlib.metadata import EntryPoint
from pathlib import Path

from search_plugins import Dial

from codecbench.core.contracts.evaluator import Measurement
from codecbench.core.engine.planning.matrix import Matrix, read_matrix
from codecbench.core.engine.planning.model import Cell, Plan, SearchFinding
from codecbench.core.engine.plugins.registry import Registry
from codecbench.core.engine.storage.record import Record, cell_description
from codecbench.core.engine.storage.store import Store
from codecbench.core.rounds.growth import Growth

Measure = Callable[[Cell], "float | str"]
"""The value of a cell, or why it failed."""


_METRICS = {
    "scales": "weight_bytes", "toss": "caught", "stray": "stray_m", "lag": "lag_ms", "waiter": "paused_ms",
    "sight": "seen",
}  # fmt: skip


def registry_of_searches() -> Registry:
    ours = EntryPoint("executors", "codecbench.plugins.executors", "codecbench")
    return Registry([EntryPoint("search", "search_plugins", "codecbench"), ours])


def size_of(cell: Cell) -> float:
    """What the codec `dial` writes under the setting of a cell."""
    wanted = {name: cell.codec.params[name] for name in ("level", "share", "effort")}
    return float(Dial.size_bytes(**wanted))


@dataclass
class SearchBench:
    """Plans and computes round after round in one folder; `rounds` has the cells computed in each."""

    folder: Path
    registry: Registry = field(default_factory=registry_of_searches)
    rounds: list[list[Cell]] = field(default_factory=list)
    plan: Plan | None = None

    def matrix(self, text: str) -> Matrix:
        path = self.folder / "matrix.yaml"
        path.write_text(text)
        return read_matrix(path, self.registry)

    def run(self, text: str, measure: Measure, *, most_rounds: int = 1000) -> tuple[SearchFinding, ...]:
        """Round after round until nothing is left to compute; what the searches have found then."""
        matrix, store = self.matrix(text), Store(self.folder / "run")
        growth = Growth(matrix, store.folder, self.registry)
        plan = growth.first_plan()
        self.rounds = []
        with store.locked():
            for _ in range(most_rounds):
                store.write_plan(plan)
                known = store.entries()
                left = [cell for cell in plan.cells if cell.id not in known or known[cell.id].status != "ok"]
                left = [cell for cell in left if cell.id not in {done.id for part in self.rounds for done in part}]
                if not left:
                    break
                for cell in left:
                    store.write_record(_record(cell, measure(cell)))
                self.rounds.append(left)
                plan = growth(plan)
        self.plan = store.read_plan()
        return plan.searches

    @property
    def computed(self) -> list[Cell]:
        return [cell for cells in self.rounds for cell in cells]

    def levels(self, evaluator: str) -> list[int]:
        """The levels of the cells of an evaluator that were computed, in order."""
        return [cell.codec.params["level"] for cell in self.computed if cell.evaluator.name == evaluator]


def _record(cell: Cell, value: float | str) -> Record:
    if isinstance(value, str):
        return Record(cell.id, "failed", value, cell=cell_description(cell))
    name = _METRICS[cell.evaluator.name]
    found = Record(cell.id, "ok", metrics=(name,), cell=cell_description(cell))
    if name == "weight_bytes" and not math.isnan(value):
        return replace(found, summaries={(name, "", how): value for how in ("mean", "max")})
    reason = "nothing was weighed" if math.isnan(value) else None
    return replace(found, measurements=(Measurement(name, value, reason=reason),))
