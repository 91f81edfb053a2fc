"""Reads a run folder into results: every record of the plan, with comparisons against the baseline codec."""

from __future__ import annotations

import logging
import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from codecbench.core.analysis.hosted_evaluator import HostedEvaluator, ResultsEvaluator
from codecbench.core.analysis.run_result import RunResult, RunSchema
from codecbench.core.analysis.table import CellResult
from codecbench.core.contracts.errors import CodecbenchError, PluginError, StoreError
from codecbench.core.contracts.evaluator import Measurement, Outcome
from codecbench.core.contracts.metric import Metric
from codecbench.core.contracts.view import Drawing, View
from codecbench.core.engine.planning.declared import offers_of, read_declaration
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
    """Read the results in a run folder, also while the run goes on.

    Damaged records are left out and logged; the next run computes them again. Raises StoreError if the folder is no
    run.
    """
    store = Store(Path(folder))
    return read_run(store, store.read_plan(), registry or installed())


def read_run(store: Store, plan: Plan, registry: Registry) -> RunResult:
    """Read the results of a plan's cells from a run folder, whichever plan it was last run with."""
    records = _records(store, plan)
    evaluators = _evaluators(records, plan, registry)
    schema = schema_of(plan, evaluators)
    baselines: dict[tuple[str, str], list[Outcome]] = defaultdict(list)
    for cell, record in records:
        if cell.codec.name in schema.baselines and record.status == "ok":
            baselines[_group(cell)].append(_outcome(store, cell, record))
    measured: dict[str, set[str]] = defaultdict(set)
    for cell, record in records:
        measured[cell.evaluator.title] |= _metric_names(record)
    results = []
    for cell, record in records:
        title = cell.evaluator.title
        metrics = dict(schema.metrics[title])
        added = [name for name in metrics if name not in measured[title]]
        results.append(_result(store, cell, record, evaluators.get(title), metrics, baselines[_group(cell)], added))
    return RunResult(store.folder, plan, add_doubts(results, schema.stateless), store.environments.read(), schema)


def _records(store: Store, plan: Plan) -> list[tuple[Cell, Record]]:
    present = store.entries()
    records = []
    for cell in plan.cells:
        if cell.id in present:
            try:
                record = store.read_record(cell.id, present[cell.id])
                for name in record.files.keys() - {SAMPLES_FILE}:
                    store.read_file(record, name)  # evaluators read artifacts by their path, unchecked
                records.append((cell, record))
            except StoreError as error:
                log.warning("%s; its cell is left out of the tables", error)
    return records


def _evaluators(records: list[tuple[Cell, Record]], plan: Plan, registry: Registry) -> dict[str, ResultsEvaluator]:
    """Create the evaluators, by title; those that are no longer installed are logged and left out."""
    instances: dict[str, ResultsEvaluator] = {}
    for setting in dict.fromkeys(cell.evaluator for cell, _ in records):
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
    """Join a record with its comparison. added: metrics that no cell measured, which only a comparison can give."""
    outcome = _outcome(store, cell, record)
    if evaluator is not None and record.status == "ok":
        compared = _compare(evaluator, outcome, baseline, added)
        replaced = {(new.metric, new.stage) for new in compared}
        measured = (*(old for old in record.measurements if (old.metric, old.stage) not in replaced), *compared)
        outcome = replace(outcome, measurements=(*measured, *_missing_measurements(cell, metrics, record, measured)))
    return CellResult(
        cell, record.status, record.reason, outcome.measurements, record.summaries, metrics,
        partial(_samples, store, record), outcome.artifacts, record.duration_s,
        partial(_drawing, evaluator if record.status == "ok" else None, outcome),
        record.code, clean_value(record.worker), record.notes, record.traceback,
    )  # fmt: skip


def _metric_names(record: Record) -> set[str]:
    """The metrics that a cell measured, per frame or per repeat."""
    return {measurement.metric for measurement in record.measurements} | {name for name, _, _ in record.summaries}


def _compare(
    evaluator: ResultsEvaluator, outcome: Outcome, baseline: list[Outcome], added: list[str]
) -> list[Measurement]:
    """Compare an outcome with the baseline's; if the evaluator fails, return a missing value of each of `added`."""
    try:
        return list(evaluator.compare(outcome, baseline))
    except CodecbenchError as error:
        return [Measurement(name, math.nan, reason=f"not compared: {error}") for name in added]


def _missing_measurements(
    cell: Cell, metrics: dict[str, Metric], record: Record, measured: tuple[Measurement, ...]
) -> Iterator[Measurement]:
    """Yield a missing value for each metric that the evaluator declared only after it measured the cell."""
    if not record.metrics:
        return
    known = {*record.metrics, *(measurement.metric for measurement in measured)}
    name = cell.evaluator.name
    reason = f"declared after this cell was measured; `codecbench run --recompute {name}` measures it"
    for metric in metrics:
        if metric not in known:
            yield Measurement(metric, math.nan, reason=reason)


def _drawing(evaluator: ResultsEvaluator | None, outcome: Outcome) -> Drawing | None:
    """Draw a cell with its evaluator; None, with a line in the log, if its files are damaged."""
    try:
        return None if evaluator is None else evaluator.drawing(outcome)
    except (CodecbenchError, OSError, ValueError, KeyError) as error:
        log.warning("%s: no drawing: %s", outcome.artifacts, error)
        return None


def _samples(store: Store, record: Record) -> pyarrow.Table:
    """The per-frame samples of a record; empty if it has none or they are damaged, which is logged."""
    try:
        content = store.samples(record)
        if content is not None:
            return table_from_parquet(content)
    except (StoreError, OSError, ValueError) as error:
        log.warning("%s: no samples of single frames: %s", store.record_folder(record.cell_id), error)
    return table_from_parquet(parquet_from_samples([]))


def schema_of(plan: Plan, evaluators: Mapping[str, ResultsEvaluator]) -> RunSchema:
    """What the plugins of a run declared. evaluators: instances by title, as far as they are installed.

    The plan's declarations come first, so that a run folder reads the same wherever it is opened.
    """
    metrics: dict[str, dict[str, Metric]] = {}
    views: dict[str, tuple[View, ...]] = {}
    for title in dict.fromkeys(cell.evaluator.title for cell in plan.cells):
        stored = plan.declared.get("evaluators", {}).get(title, {})
        here = evaluators.get(title)
        known = [read_declaration(Metric, value) for value in _dicts(stored, "metrics")]
        known += list(here.metrics if here else ())
        metrics[title] = {}
        for metric in filter(None, known):
            metrics[title].setdefault(metric.name, metric)
        stored_views = [view for value in _dicts(stored, "views") if (view := read_declaration(View, value))]
        views[title] = tuple(stored_views) if stored else tuple(here.views if here else ())
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


def _dicts(stored: dict[str, Any], name: str) -> list[dict[str, Any]]:
    values = stored.get(name)
    return [value for value in values if isinstance(value, dict)] if isinstance(values, list) else []


def open_nonempty_run(folder: Path) -> RunResult:
    """Read the results in a run folder. Raises StoreError if it is no run folder or no cell has a record yet."""
    run = open_run(folder)
    if not run.results:
        message = f"{folder} has no results yet: none of its {len(run.plan.cells)} cells has a record that can be read"
        raise StoreError(f"{message}; `codecbench run` computes them, `codecbench status {folder}` shows the progress")
    return run


def absent_plugins(plan: Plan, registry: Registry) -> list[str]:
    """The plugins of a plan that are not installed, each with its distribution."""
    used = {(setting.kind, setting.name): setting for cell in plan.cells for setting in cell.plugins}
    names = []
    for (kind, name), setting in used.items():
        try:
            registry.find(kind, name)
        except PluginError:
            names.append(setting.full_name)
    return names


OF_A_CODEC: Final = 0.5
"""Share of another lossless codec's bytes below which a row is implausible; codecbench's own differ by less."""

OF_PNG: Final = 0.25
"""Share of PNG's bytes below which a row is implausible; good codecs need half of them on camera frames."""

_PLAIN: Final = 1 / 3
"""Share of the raw bytes below which PNG shows drawn or empty frames, on which honest codecs differ widely."""

_MEAN: Final = ("", "mean")


class _Lossless(NamedTuple):
    """A cell whose frames were all decoded exactly."""

    result: CellResult
    bpp: float
    """Bits per pixel."""
    of_png: float
    """Its bytes over those of PNG."""


def add_doubts(results: Iterable[CellResult], stateless: Mapping[str, bool]) -> tuple[CellResult, ...]:
    """Add a note to the results that are lossless at implausibly few bytes.

    stateless: by codec, whether it codes each frame on its own; codecs that are not in it get no note. A codec is
    compared with codecbench's others of its kind, because inter-frame codecs honestly save far more than half on a
    still scene. A stateless codec is compared with PNG if no other in the run is smaller than PNG.
    """
    results = tuple(results)
    groups: dict[tuple[str, str, bool], list[_Lossless]] = defaultdict(list)
    for lossless in _lossless_cells(results):
        cell = lossless.result.cell
        if cell.codec.name in stateless:
            groups[cell.sequence.name, cell.evaluator.title, stateless[cell.codec.name]].append(lossless)
    doubts = {
        id(lossless.result): doubt
        for (_, _, is_stateless), group in groups.items()
        for lossless in group
        if (doubt := _doubt(lossless, group, beside_png=is_stateless))
    }
    return tuple(
        replace(result, notes=(*result.notes, doubts[id(result)])) if id(result) in doubts else result
        for result in results
    )


def _lossless_cells(results: Iterable[CellResult]) -> Iterator[_Lossless]:
    """Yield the cells with infinite PSNR whose size is known."""
    for result in results:
        means = {name: value for (name, stage, how), value in result.summaries.items() if (stage, how) == _MEAN}
        known = [metric for metric in result.metrics.values() if metric.name in means]
        psnrs = [means[metric.name] for metric in known if metric.role == "quality" and metric.unit == "dB"]
        sizes = {metric.quantity: means[metric.name] for metric in known if metric.quantity}
        if psnrs and all(map(math.isinf, psnrs)) and {"per_pixel", "below_png"} <= sizes.keys():
            yield _Lossless(result, sizes["per_pixel"], 1 - sizes["below_png"] / 100)


def _doubt(cell: _Lossless, group: Iterable[_Lossless], *, beside_png: bool) -> str:
    """Say why a cell is implausibly small; empty if it is not."""
    codec, sequence = cell.result.cell.codec, cell.result.cell.sequence
    if cell.bpp < _PLAIN * sequence.bits * sequence.channels * cell.of_png:
        return ""
    known = [other for other in group if other.of_png < 1 and not other.result.cell.codec.distribution]
    others = [other for other in known if other.result.cell.codec.name != codec.name]
    best = min(others, key=lambda other: other.bpp, default=None)
    if best is not None and cell.bpp < OF_A_CODEC * best.bpp:
        share = f"{100 * cell.bpp / best.bpp:.2g} % of the bytes of {best.result.cell.codec.name}"
        return f"implausible: lossless at {share}, the smallest other lossless codec of its kind on {sequence.name}"
    if best is None and beside_png and cell.of_png < OF_PNG:
        return f"implausible: lossless at {100 * cell.of_png:.2g} % of the bytes of PNG on {sequence.name}"
    return ""
