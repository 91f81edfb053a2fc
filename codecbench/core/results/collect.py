"""From a run folder to results: every record of the plan, with what can be said beside the raw codec."""

from __future__ import annotations

import logging
import math
from collections import defaultdict
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from codecbench.core.contracts.errors import CodecbenchError, StoreError
from codecbench.core.contracts.evaluator import Evaluator, Measurement, Metric, Outcome
from codecbench.core.engine.planning.model import Cell, Plan
from codecbench.core.engine.registry import Registry, installed
from codecbench.core.engine.storage.record import Record
from codecbench.core.engine.storage.samples import parquet_from_samples, table_from_parquet
from codecbench.core.engine.storage.store import Store
from codecbench.core.results.run_result import RunResult
from codecbench.core.results.table import CellResult

if TYPE_CHECKING:
    import pyarrow

BASELINE: Final = "raw"
"""The codec that others are compared with where an evaluator compares."""

log = logging.getLogger("codecbench.results")


def open_run(folder: str | Path, registry: Registry | None = None) -> RunResult:
    """The results in a run folder, also while it is still running.

    Damaged records are left out and reported to the log; the next run computes them again. Raises StoreError
    for a folder that is not a run.
    """
    store = Store(Path(folder))
    plan = store.read_plan()
    found = _records(store, plan)
    evaluators = _evaluators(found, registry or installed())
    baselines: dict[tuple[str, str, str], list[Outcome]] = defaultdict(list)
    for cell, record in found:
        if cell.codec.name == BASELINE and record.status == "ok":
            baselines[_group(cell)].append(_outcome(store, cell, record))
    results = []
    for cell, record in found:
        evaluator = evaluators.get((cell.evaluator.name, cell.evaluator.label))
        results.append(_result(store, cell, record, evaluator, baselines[_group(cell)]))
    return RunResult(Path(folder), plan, tuple(results), store.environments())


def _records(store: Store, plan: Plan) -> list[tuple[Cell, Record]]:
    present = store.entries()
    found = []
    for cell in plan.cells:
        if cell.id in present:
            try:
                found.append((cell, store.read_record(cell.id, present[cell.id])))
            except StoreError as error:
                log.warning("%s; its cell is left out of the tables", error)
    return found


def _evaluators(found: list[tuple[Cell, Record]], registry: Registry) -> dict[tuple[str, str], Evaluator[Any]]:
    """Instances by name and label; one that is no longer installed is left out, and its units with it."""
    instances: dict[tuple[str, str], Evaluator[Any]] = {}
    tried: set[tuple[str, str]] = set()
    for cell, _ in found:
        key = (cell.evaluator.name, cell.evaluator.label)
        if key not in tried:
            tried.add(key)
            try:
                instances[key] = registry.create("evaluator", cell.evaluator.name, cell.evaluator.params)
            except (CodecbenchError, ValueError) as error:
                log.warning("evaluator %s: %s; its units and comparisons are missing", cell.evaluator.name, error)
    return instances


def _group(cell: Cell) -> tuple[str, str, str]:
    return cell.sequence.name, cell.evaluator.name, cell.evaluator.label


def _outcome(store: Store, cell: Cell, record: Record) -> Outcome:
    return Outcome(cell.repeat, record.measurements, store.record_folder(cell.id))


def _result(
    store: Store, cell: Cell, record: Record, evaluator: Evaluator[Any] | None, baseline: list[Outcome]
) -> CellResult:
    measurements: tuple[Measurement, ...] = record.measurements
    outcome = _outcome(store, cell, record)
    metrics: dict[str, Metric] = {}
    if evaluator is not None:
        metrics = {metric.name: metric for metric in evaluator.metrics}
        if record.status == "ok":
            measurements += tuple(evaluator.compare(outcome, baseline))
            measurements += tuple(_declared_later(evaluator, record, measurements))
    return CellResult(
        cell,
        record.status,
        record.reason,
        measurements,
        record.summaries,
        metrics,
        partial(_samples, store, record),
        outcome.artifacts,
        record.duration_s,
    )


def _declared_later(
    evaluator: Evaluator[Any], record: Record, measurements: tuple[Measurement, ...]
) -> Iterator[Measurement]:
    """A missing value for each metric that the evaluator did not have yet when it measured the cell."""
    if not record.metrics:
        return
    known = {*record.metrics, *(measurement.metric for measurement in measurements)}
    reason = f"declared after this cell was measured; `codecbench run --recompute {evaluator.name}` measures it"
    for metric in evaluator.metrics:
        if metric.name not in known:
            yield Measurement(metric.name, math.nan, reason=reason)


def _samples(store: Store, record: Record) -> pyarrow.Table:
    """The per-frame samples of a record; empty where it has none or they are damaged, which is reported."""
    try:
        content = store.samples(record)
    except StoreError as error:
        log.warning("%s", error)
        content = None
    return table_from_parquet(parquet_from_samples([]) if content is None else content)
