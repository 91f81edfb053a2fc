"""Computing a sample of a run's cells again, in a fresh run folder, and saying which agree."""

from __future__ import annotations

import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from codecbench.core.contracts.errors import ParamsError, StoreError
from codecbench.core.engine.bundling.unpacking import unpack_bundle
from codecbench.core.engine.planning.model import Cell
from codecbench.core.engine.registry import installed
from codecbench.core.engine.running.run import Listener, run_plan
from codecbench.core.engine.storage.plan_file import PlanFile
from codecbench.core.engine.storage.record import Record
from codecbench.core.engine.storage.store import Store
from codecbench.core.results.relocation import SAME_PLACE
from codecbench.core.results.verification.agreement import (
    TOLERANCE,
    VERDICTS,
    Agreement,
    compared,
    other_version,
    values_of,
)  # fmt: skip
from codecbench.core.results.verification.replanning import Replanned, replanned
from codecbench.core.results.verification.sample import repeatable_metrics, sampled, verifiable_cells

CELLS: Final = 5


@dataclass(frozen=True)
class Verification:
    """How a sample of a run's cells came out.

    of: how many cells have something to compare. left_out: how many have a result, but times and the like alone.
    """

    name: str
    cells: tuple[Agreement, ...]
    of: int
    left_out: int
    tolerance: float

    @property
    def counts(self) -> dict[str, int]:
        """How many cells have which verdict, from the best."""
        found = Counter(agreement.verdict for agreement in self.cells)
        return {verdict: found[verdict] for verdict in VERDICTS if found[verdict]}

    @property
    def holds(self) -> bool:
        """Whether some cells were computed again and all of them agree."""
        return "differs" not in self.counts and any(verdict in self.counts for verdict in VERDICTS[:2])


def verify_run(
    path: str | Path,
    *,
    cells: int = CELLS,
    seed: int = 0,
    tolerance: float = TOLERANCE,
    out: str | Path | None = None,
    sequences_from: str | None = None,
    workers: int | None = None,
    listener: Listener | None = None,
) -> Verification:
    """Compute some cells of a bundle, or of a run folder, again and compare them with what it says.

    cells, seed: how many, and which by chance. tolerance: relative difference that still agrees where libraries
    have other versions; where they are equal, values must be. out: a fresh run
    folder to keep what was computed; without it that is removed. sequences_from: where sequences are that the plan
    names by path, a folder or `same` for where it says. Raises StoreError for a bundle that is refused, for what is no
    run, and for a folder `out` that is there already, and ParamsError for numbers out of their range.
    """
    if cells < 1 or not tolerance >= 0:
        raise ParamsError(f"cells is {cells} and tolerance {tolerance}; at least 1 cell, and a tolerance from 0")
    path = Path(path)
    if out is not None and Path(out).exists():
        raise StoreError(f"{out} is there already; what is computed again goes into a fresh folder")
    with tempfile.TemporaryDirectory(prefix="codecbench-verify-", ignore_cleanup_errors=True) as place:
        folder = path
        if not path.is_dir():
            unpack_bundle(path, folder := Path(place) / "bundle")
        elif sequences_from is None and _is_from_here(path):
            sequences_from = SAME_PLACE
        again = Store(Path(out) if out is not None else Path(place) / "again")
        there, registry = Store(folder), installed()
        found, statuses = there.read_plan(), {id_: entry.status for id_, entry in there.entries().items()}
        candidates = verifiable_cells(found, statuses)
        made = replanned(found, sampled(candidates, cells, seed), sequences_from, registry)
        if made.plan.cells and run_plan(made.plan, again.folder, workers=workers, listener=listener).interrupted:
            raise KeyboardInterrupt
        agreements = tuple(_agreement(there, again, made, cell, tolerance) for cell in sampled(candidates, cells, seed))
    done = sum(statuses.get(cell.id) == "ok" for cell in found.cells)
    return Verification(found.name, agreements, len(candidates), done - len(candidates), tolerance)


def _is_from_here(folder: Path) -> bool:
    try:
        return PlanFile(folder).origin_elsewhere() is None
    except (OSError, ValueError, KeyError, TypeError):
        return False  # reading the plan says what is wrong with it


def _agreement(there: Store, here: Store, made: Replanned, cell: Cell, tolerance: float) -> Agreement:
    if cell.id in made.reasons:
        return Agreement(cell, "not recomputed", note=made.reasons[cell.id])
    metrics = repeatable_metrics(made.plan, cell.evaluator.title)
    try:
        known = values_of(there, there.read_record(cell.id), metrics)
    except (StoreError, OSError, ValueError) as error:
        return Agreement(cell, "not recomputed", note=f"its record cannot be read: {error}")
    record = here.read_record(cell.id)
    if record.status != "ok":
        return Agreement(cell, "not recomputed", note=f"{record.status} here: {record.reason}")
    other = other_version(_environment(there, there.read_record(cell.id)), _environment(here, record))
    return compared(cell, known, values_of(here, record, metrics), tolerance, other)


def _environment(store: Store, record: Record) -> dict[str, Any]:
    """Where a record was computed; empty where nothing is known of it, which agrees with nowhere."""
    return store.environments.read().get(record.environment or "", {})
