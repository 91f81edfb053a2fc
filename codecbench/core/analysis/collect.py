"""From a run folder to results: every record of the plan, with what can be said beside the baseline codec."""

from __future__ import annotations

import logging
import math
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from codecbench.core.analysis.hosted_evaluator import HostedEvaluator, ResultsEvaluator
from codecbench.core.analysis.plausibility import with_doubts
from codecbench.core.analysis.run_result import RunResult, RunSchema
from codecbench.core.analysis.table import CellResult
from codecbench.core.contracts.errors import CodecbenchError, PluginError, StoreError
from codecbench.core.contracts.evaluator import Measurement, Outcome
from codecbench.core.contracts.metric import Metric
from codecbench.core.contracts.view import Drawing, View
from codecbench.core.engine.planning.declared import offers_of, read_declared
from codecbench.core.engine.planning.description import InvalidParams
from codecbench.core.engine.planning.model import Cell, Plan
from codecbench.core.engine.plugins.registry import Registry, installed
from codecbench.core.engine.storage.record import SAMPLES_FILE, Record
from codecbench.core.engine.storage.samples import parquet_from_samples, table_from_parquet
from codecbench.core.engine.storage.store import Store
from codecbench.core.engine.text import clean_value

if TYPE_CHECKING:
    import pyarrow

log = logging.getLogger("codecbench.results")


def open_run(folder: str | Path, registry: Registry | None = None) -> RunResult:
    """The results in a run folder, also while it is still running.

    Damaged records are left out and reported to the log; the next run computes them again. Raises StoreError
    for a folder that is not a run.
    """
    store = Store(Path(folder))
    return read_run(store, store.read_plan(), registry or installed())


def read_run(store: Store, plan: Plan, registry: Registry) -> RunResult:
    """The results of a plan's cells that a run folder holds, whichever plan it was last run with."""
    found = _records(store, plan)
    evaluators = _evaluators(found, plan, registry)
    meaning = schema_of(plan, evaluators)
    baselines: dict[tuple[str, str], list[Outcome]] = defaultdict(list)
    for cell, record in found:
        if cell.codec.name in meaning.baselines and record.status == "ok":
            baselines[_group(cell)].append(_outcome(store, cell, record))
    measured: dict[str, set[str]] = defaultdict(set)
    for cell, record in found:
        measured[cell.evaluator.title] |= _measured(record)
    results = []
    for cell, record in found:
        title = cell.evaluator.title
        metrics = dict(meaning.metrics[title])
        added = [name for name in metrics if name not in measured[title]]
        results.append(_result(store, cell, record, evaluators.get(title), metrics, baselines[_group(cell)], added))
    return RunResult(store.folder, plan, with_doubts(results, meaning.stateless), store.environments.read(), meaning)


def _records(store: Store, plan: Plan) -> list[tuple[Cell, Record]]:
    present = store.entries()
    found = []
    for cell in plan.cells:
        if cell.id in present:
            try:
                record = store.read_record(cell.id, present[cell.id])
                for name in record.files.keys() - {SAMPLES_FILE}:
                    store.read_file(record, name)  # evaluators read artifacts by their path, unchecked
                found.append((cell, record))
            except StoreError as error:
                log.warning("%s; its cell is left out of the tables", error)
    return found


def _evaluators(found: list[tuple[Cell, Record]], plan: Plan, registry: Registry) -> dict[str, ResultsEvaluator]:
    """Evaluators by title; one that is no longer installed is left out, and its comparisons and drawings with it."""
    instances: dict[str, ResultsEvaluator] = {}
    for setting in dict.fromkeys(cell.evaluator for cell, _ in found):
        try:
            hosted = registry.find("evaluator", setting.name).hosted
            instances[setting.title] = (
                HostedEvaluator(registry, setting, offers_of(plan, setting))
                if hosted
                else registry.create("evaluator", setting.name, setting.params)
            )
        except (CodecbenchError, InvalidParams, ValueError) as error:
            log.warning("evaluator %s: %s; its comparisons and drawings are missing", setting.name, error)
    return instances


def _group(cell: Cell) -> tuple[str, str]:
    return cell.sequence.name, cell.evaluator.title


def _outcome(store: Store, cell: Cell, record: Record) -> Outcome:
    return Outcome(cell.repeat, record.measurements, store.record_folder(cell.id))


def _result(
    store: Store,
    cell: Cell,
    record: Record,
    evaluator: ResultsEvaluator | None,
    metrics: dict[str, Metric],
    baseline: list[Outcome],
    added: list[str],
) -> CellResult:
    """added: the metrics that no cell of this evaluator measured, so that only a comparison can give them."""
    outcome = _outcome(store, cell, record)
    if evaluator is not None and record.status == "ok":
        beside = _compared(evaluator, outcome, baseline, added)
        replaced = {(each.metric, each.stage) for each in beside}
        measured = (*(each for each in record.measurements if (each.metric, each.stage) not in replaced), *beside)
        outcome = replace(outcome, measurements=(*measured, *_declared_later(cell, metrics, record, measured)))
    return CellResult(
        cell, record.status, record.reason, outcome.measurements, record.summaries, metrics,
        partial(_samples, store, record), outcome.artifacts, record.duration_s,
        partial(_drawing, evaluator if record.status == "ok" else None, outcome),
        record.code, clean_value(record.worker), record.notes, record.traceback,
    )  # fmt: skip


def _measured(record: Record) -> set[str]:
    """The metrics that a cell measured, of frames or of none."""
    return {measurement.metric for measurement in record.measurements} | {name for name, _, _ in record.summaries}


def _compared(
    evaluator: ResultsEvaluator, outcome: Outcome, baseline: list[Outcome], added: list[str]
) -> list[Measurement]:
    """What the evaluator says beside the baseline; where it fails, a missing value of each of `added`."""
    try:
        return list(evaluator.compare(outcome, baseline))
    except CodecbenchError as error:
        return [Measurement(name, math.nan, reason=f"not compared: {error}") for name in added]


def _declared_later(
    cell: Cell, metrics: dict[str, Metric], record: Record, measured: tuple[Measurement, ...]
) -> Iterator[Measurement]:
    """A missing value for each metric that the evaluator did not have yet when it measured the cell."""
    if not record.metrics:
        return
    known = {*record.metrics, *(measurement.metric for measurement in measured)}
    name = cell.evaluator.name
    reason = f"declared after this cell was measured; `codecbench run --recompute {name}` measures it"
    for metric in metrics:
        if metric not in known:
            yield Measurement(metric, math.nan, reason=reason)


def _drawing(evaluator: ResultsEvaluator | None, outcome: Outcome) -> Drawing | None:
    """What a cell left, as its evaluator draws it; None, with a line in the log, where its files are damaged."""
    try:
        return None if evaluator is None else evaluator.drawing(outcome)
    except (CodecbenchError, OSError, ValueError, KeyError) as error:
        log.warning("%s: no drawing: %s", outcome.artifacts, error)
        return None


def _samples(store: Store, record: Record) -> pyarrow.Table:
    """The per-frame samples of a record; empty where it has none or they are damaged, which is reported."""
    try:
        content = store.samples(record)
        if content is not None:
            return table_from_parquet(content)
    except (StoreError, OSError, ValueError) as error:
        log.warning("%s: no samples of single frames: %s", store.record_folder(record.cell_id), error)
    return table_from_parquet(parquet_from_samples([]))


def schema_of(plan: Plan, evaluators: Mapping[str, ResultsEvaluator]) -> RunSchema:
    """The meaning of a run. evaluators: instances by title, as far as they are installed.

    What the plan says comes first, so that a run folder reads the same wherever it is opened.
    """
    metrics: dict[str, dict[str, Metric]] = {}
    views: dict[str, tuple[View, ...]] = {}
    for title in dict.fromkeys(cell.evaluator.title for cell in plan.cells):
        stored = plan.declared.get("evaluators", {}).get(title, {})
        here = evaluators.get(title)
        known = [read_declared(Metric, value) for value in _listed(stored, "metrics")]
        known += list(here.metrics if here else ())
        metrics[title] = {}
        for metric in filter(None, known):
            metrics[title].setdefault(metric.name, metric)
        drawn = [view for value in _listed(stored, "views") if (view := read_declared(View, value))]
        views[title] = tuple(drawn) if stored else tuple(here.views if here else ())
    codecs = plan.declared.get("codecs", {})
    names = dict.fromkeys(cell.codec.name for cell in plan.cells)
    references = {name: codecs[name].get("reference") for name in names if name in codecs}
    return RunSchema(
        metrics,
        views,
        frozenset(name for name, reference in references.items() if reference == "baseline"),
        tuple(name for name, reference in references.items() if reference == "anchor"),
        {name: bool(stored["stateless"]) for name, stored in codecs.items() if "stateless" in stored},
    )


def _listed(stored: dict[str, Any], name: str) -> list[dict[str, Any]]:
    found = stored.get(name)
    return [value for value in found if isinstance(value, dict)] if isinstance(found, list) else []


def open_nonempty_run(folder: Path) -> RunResult:
    """The results in a run folder. Raises StoreError where it is no run folder, or no cell has a record yet."""
    run = open_run(folder)
    if not run.results:
        message = f"{folder} has no results yet: none of its {len(run.plan.cells)} cells has a record that can be read"
        raise StoreError(f"{message}; `codecbench run` computes them, `codecbench status {folder}` says how far it is")
    return run


def absent_plugins(plan: Plan, registry: Registry) -> list[str]:
    """The plugins of a plan that are not installed, each with the distribution that it was of."""
    used = {(setting.kind, setting.name): setting for cell in plan.cells for setting in cell.plugins}
    found = []
    for (kind, name), setting in used.items():
        try:
            registry.find(kind, name)
        except PluginError:
            found.append(setting.full_name)
    return found
