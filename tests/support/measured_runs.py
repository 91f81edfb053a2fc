"""Runs put together cell by cell, whose tables are known."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from codecbench.core.analysis.run_result import RunSchema
from codecbench.core.analysis.table import CellResult
from codecbench.core.contracts.evaluator import Measurement
from codecbench.core.contracts.metric import Metric
from codecbench.core.engine.planning.model import Cell, Plan, PluginSetting, RunSettings, SequenceEntry
from codecbench.core.engine.storage.aggregate import summarise
from codecbench.core.engine.storage.samples import parquet_from_samples, table_from_parquet
from codecbench.core.facade import Run

ANCHORS = ("plain",)

BITS = Metric("bits", "bpp", "lower", "", role="rate", headline=True)
SCORE = Metric("score", "dB", "higher", "", role="quality", headline=True)
BLUR = Metric("blur", "px", "lower", "", role="quality", headline=True)
DRIFT = Metric("drift", "m", "lower", "", ("median",), role="task", headline=True, scale="log")
HELD = Metric("held", "1", "higher", "", role="success", headline=True)
WORK = Metric("work", "ops", "lower", "", role="operations", headline=True)
SPEED = Metric("speed", "ms", "lower", "", role="time", headline=True)
SHAPE = Metric("shape", "1", "neither", "", role="task", headline=True)
ENCODING = Metric("encoding", "ms", "lower", "", role="time", quantity="encoding")
DECODING = Metric("decoding", "ms", "lower", "", role="time", quantity="decoding")
METRICS = {metric.name: metric for metric in (SHAPE, BITS, SCORE, BLUR, DRIFT, HELD, WORK, SPEED, ENCODING, DECODING)}
Values = dict[tuple[str, str], Sequence[float]]


def cell_result(
    codec: str,
    q: float,
    evaluator: str,
    frames: Values | None = None,
    own: Values | None = None,
    repeat: int = 0,
    *,
    sequence_name: str = "s",
    status: str = "ok",
    reason: str = "",
    count: int = 5,
) -> CellResult:
    """A cell of `count` frames. frames, own: values of a metric and a stage, "" for none; a NaN is not measured."""
    sequence = SequenceEntry(sequence_name, PluginSetting("dataset", "d", "1"), "f00d", count, 3, True, True)
    setting = PluginSetting("codec", codec, "1", {"q": q}, f"q={q}")
    cell = Cell("id", sequence, setting, PluginSetting("evaluator", evaluator, "1"), repeat, 0, False, None)
    samples = [
        Measurement(name, value, frame, stage or None)
        for (name, stage), values in (frames or {}).items()
        for frame, value in enumerate(values)
        if not np.isnan(value)
    ]
    kept = table_from_parquet(parquet_from_samples(samples))
    single = tuple(
        Measurement(n, value, None, stage or None) for (n, stage), many in (own or {}).items() for value in many
    )
    return CellResult(cell, status, reason, single, summarise(samples, METRICS.values()), METRICS, lambda: kept, Path())


def run_of(*results: CellResult, anchors: tuple[str, ...] = ANCHORS) -> Run:
    """A run of these cells, in which codec `raw` is the baseline."""
    sequences = tuple(dict.fromkeys(result.cell.sequence.name for result in results))
    entries = {result.cell.sequence.name: result.cell.sequence for result in results}
    settings = RunSettings(1, 1.0, 1, 0, PluginSetting("executor", "e", "1"))
    plan = Plan("p", "", settings, tuple(entries[name] for name in sequences), (), tuple(r.cell for r in results))
    return Run(Path(), plan, results, {}, RunSchema({}, {}, frozenset({"raw"}), anchors))
