"""Computes a sample of a run's cells again, in a new run folder, and compares the values."""

from __future__ import annotations

import math
import random
import tempfile
from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

from codecbench.core.analysis.replanning import SAME_PLACE, Replanned, replan
from codecbench.core.contracts.errors import ParamsError, StoreError
from codecbench.core.contracts.metric import Metric
from codecbench.core.engine.bundling.packing import unpack_bundle
from codecbench.core.engine.planning.declared import read_declaration
from codecbench.core.engine.planning.model import Cell, Plan
from codecbench.core.engine.plugins.registry import installed
from codecbench.core.engine.running.run import Listener, run_plan
from codecbench.core.engine.storage.plan_file import PlanFile
from codecbench.core.engine.storage.record import Record
from codecbench.core.engine.storage.samples import table_from_parquet
from codecbench.core.engine.storage.store import Store

Verdict = Literal["to the bit", "within tolerance", "differs", "not recomputed"]
VERDICTS: Final[tuple[Verdict, ...]] = ("to the bit", "within tolerance", "differs", "not recomputed")

TOLERANCE: Final = 1e-6
"""Relative difference up to which values agree if libraries have other versions.

More than floats summed in another order differ, and less than any table shows."""

_WITHOUT_NUMBERS: Final = {"distributed", "pandas", "pebble", "pyarrow", "pydantic"}
"""Distributions that do not compute results."""

Values = dict[tuple[str, str, int | None, int], float]
"""Values by metric, stage, frame, and the count of those before with the same metric, stage and frame."""
CELLS: Final = 5
"""Cells that are computed again by default."""


@dataclass(frozen=True)
class Verification:
    """The agreement of a run's cells that were computed again."""

    name: str
    cells: tuple[Agreement, ...]
    of: int
    """Number of cells of the run that have values to compare."""
    left_out: int
    """Number of cells that only have values such as times, which never repeat."""
    tolerance: float

    @property
    def counts(self) -> dict[str, int]:
        """How many cells have which verdict, from the best."""
        counts = Counter(agreement.verdict for agreement in self.cells)
        return {verdict: counts[verdict] for verdict in VERDICTS if counts[verdict]}

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
    """Compute some cells of a bundle or a run folder again and compare the values.

    cells: how many. seed: of their random choice. tolerance: relative difference that still agrees if libraries have
    other versions; if they are equal, values must be. out: a new run folder for the results; without it they are
    removed. sequences_from: where to find sequences that the plan names by path: a folder, or `same` for that path.
    Raises StoreError if the bundle is refused, `path` is no run or `out` exists, and ParamsError for numbers out of
    range.
    """
    if cells < 1 or not tolerance >= 0:
        raise ParamsError(f"cells is {cells} and tolerance {tolerance}; cells must be at least 1, tolerance at least 0")
    path = Path(path)
    if out is not None and Path(out).exists():
        raise StoreError(f"{out} already exists; give a new folder for the results")
    with tempfile.TemporaryDirectory(prefix="codecbench-verify-", ignore_cleanup_errors=True) as temporary:
        folder = path
        if not path.is_dir():
            unpack_bundle(path, folder := Path(temporary) / "bundle")
        elif sequences_from is None and _is_from_here(path):
            sequences_from = SAME_PLACE
        again = Store(Path(out) if out is not None else Path(temporary) / "again")
        there, registry = Store(folder), installed()
        plan, statuses = there.read_plan(), {id_: entry.status for id_, entry in there.entries().items()}
        candidates = verifiable_cells(plan, statuses)
        replanned = replan(plan, sample_cells(candidates, cells, seed), sequences_from, registry)
        if (
            replanned.plan.cells
            and run_plan(replanned.plan, again.folder, workers=workers, listener=listener).interrupted
        ):
            raise KeyboardInterrupt
        agreements = tuple(
            _agreement(there, again, replanned, cell, tolerance) for cell in sample_cells(candidates, cells, seed)
        )
    done = sum(statuses.get(cell.id) == "ok" for cell in plan.cells)
    return Verification(plan.name, agreements, len(candidates), done - len(candidates), tolerance)


def _is_from_here(folder: Path) -> bool:
    """Whether the run was planned on this machine."""
    try:
        return PlanFile(folder).origin_elsewhere() is None
    except (OSError, ValueError, KeyError, TypeError):
        return False  # reading the plan reports what is wrong with it


def _agreement(there: Store, here: Store, replanned: Replanned, cell: Cell, tolerance: float) -> Agreement:
    if cell.id in replanned.reasons:
        return Agreement(cell, "not recomputed", note=replanned.reasons[cell.id])
    metrics = repeatable_metrics(replanned.plan, cell.evaluator.title)
    try:
        known = values_of(there, there.read_record(cell.id), metrics)
    except (StoreError, OSError, ValueError) as error:
        return Agreement(cell, "not recomputed", note=f"its record cannot be read: {error}")
    record = here.read_record(cell.id)
    if record.status != "ok":
        return Agreement(cell, "not recomputed", note=f"{record.status} here: {record.reason}")
    other = other_version(_environment(there, there.read_record(cell.id)), _environment(here, record))
    return compare_values(cell, known, values_of(here, record, metrics), tolerance, other)


def _environment(store: Store, record: Record) -> dict[str, Any]:
    """The environment that computed a record; empty if unknown, which agrees with none."""
    return store.environments.read().get(record.environment or "", {})


@dataclass(frozen=True)
class Agreement:
    """How a cell agrees with its record."""

    cell: Cell
    verdict: Verdict
    values: int = 0
    """How many were compared."""
    note: str = ""
    """The first that differs, or why none was compared."""


def values_of(store: Store, record: Record, metrics: Collection[str] | None) -> Values:
    """What a record measured of these metrics, or of all for None. Raises StoreError, ValueError or OSError."""
    rows = [(measured.metric, measured.stage or "", None, measured.value) for measured in record.measurements]
    content = store.samples(record)
    if content is not None:
        columns = table_from_parquet(content).to_pydict()
        names = ("metric", "stage", "frame", "value")
        samples = zip(*(columns[name] for name in names), strict=True)
        rows += [(metric, stage or "", frame, math.nan if value is None else value)
                 for metric, stage, frame, value in samples]  # fmt: skip
    values: Values = {}
    for metric, stage, frame, value in rows:
        if metrics is not None and metric not in metrics:
            continue
        place = 0
        while (metric, stage, frame, place) in values:
            place += 1
        values[metric, stage, frame, place] = value
    return values


def other_version(there: dict[str, Any], here: dict[str, Any]) -> str:
    """Say the first difference of two environments that may change a result; empty if there is none.

    It may be a version or `simd`: OpenBLAS, OpenCV, NumPy and the C library choose their code by the processor's AVX2
    and AVX-512, and round differently. A library that one side lacks was not used by the cell. A description from
    elsewhere may have anything in any place.
    """
    versions = [
        {**_part(side, "machine", "architecture", "simd"), **_part(side, "system", "libc"), **_part(side, "libraries"),
         **_part(side, "distributions")}
        for side in (there, here)
    ]  # fmt: skip
    for name in sorted(versions[0].keys() & versions[1].keys() - _WITHOUT_NUMBERS):
        if versions[0][name] != versions[1][name]:
            return f"{name} is {versions[0][name]} there, {versions[1][name]} here"
    return "" if "numpy" in versions[0].keys() & versions[1].keys() else "versions are unknown"


def _part(environment: dict[str, Any], part: str, *names: str) -> dict[str, Any]:
    values = environment.get(part)
    values = values if isinstance(values, dict) else {}
    return {name: value for name, value in values.items() if not names or name in names}


def compare_values(cell: Cell, there: Values, here: Values, tolerance: float, other: str = "") -> Agreement:
    """Compare the values of a cell with those computed here.

    other: what has another version here. If all versions are equal, only equal values agree.
    """
    if there.keys() != here.keys():
        key = min(there.keys() ^ here.keys(), key=str)
        side = "not measured here" if key in there else "measured here only"
        return Agreement(cell, "differs", len(there), f"{_label(key)}: {side}")
    apart = {key: _distance(value, here[key]) for key, value in there.items()}
    if not apart:
        return Agreement(cell, "not recomputed", 0, "it measured nothing repeatable")
    unequal = [key for key, distance in apart.items() if distance > 0.0]
    if not unequal:
        return Agreement(cell, "to the bit", len(there))
    beyond = [key for key in unequal if not other or apart[key] > tolerance]
    first = (beyond or unequal)[0]
    verdict: Verdict = "differs" if beyond else "within tolerance"
    note = (
        f"{_label(first)}: {there[first]!r} there, {here[first]!r} here; {len(unequal)} of {len(there)} values differ"
    )
    return Agreement(cell, verdict, len(there), f"{note}; {other or 'versions and instructions are equal'}")


def _distance(first: float, second: float) -> float:
    """The relative difference; 0 for equal values, also if missing or infinite."""
    if first == second or (math.isnan(first) and math.isnan(second)):
        return 0.0
    distance = abs(first - second) / max(abs(first), abs(second))
    return distance if math.isfinite(distance) else math.inf


def _label(key: tuple[str, str, int | None, int]) -> str:
    metric, stage, frame, _ = key
    name = f"{metric}/{stage}" if stage else metric
    return name if frame is None else f"{name} of frame {frame}"


def repeatable_metrics(plan: Plan, title: str) -> set[str] | None:
    """The repeatable metrics of an evaluator, by its title; None if the plan does not declare them."""
    declared = plan.declared.get("evaluators", {}).get(title, {}).get("metrics")
    if not isinstance(declared, list):
        return None
    metrics = [read_declaration(Metric, value) for value in declared if isinstance(value, dict)]
    return {metric.name for metric in metrics if metric is not None and metric.repeatable}


def verifiable_cells(plan: Plan, statuses: Mapping[str, str]) -> list[Cell]:
    """The cells with a result that has values to compare; times and the like never repeat."""
    titles = dict.fromkeys(cell.evaluator.title for cell in plan.cells)
    nothing = {title for title in titles if repeatable_metrics(plan, title) == set()}
    return [cell for cell in plan.cells if statuses.get(cell.id) == "ok" and cell.evaluator.title not in nothing]


def sample_cells(cells: list[Cell], count: int, seed: int) -> list[Cell]:
    """Choose `count` of the cells at random, in their order; equal seeds choose equal cells."""
    ids = sorted(cell.id for cell in cells)
    chosen = set(random.Random(seed).sample(ids, min(count, len(ids))))
    return [cell for cell in cells if cell.id in chosen]
