"""Run folders that are written by hand, without running anything."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path

from codecbench.core.contracts.evaluator import Measurement
from codecbench.core.contracts.metric import Metric
from codecbench.core.engine.identity import digest
from codecbench.core.engine.planning.model import Cell, CodingJob, Plan, PluginSetting, RunSettings, SequenceEntry
from codecbench.core.engine.storage.aggregate import summarise
from codecbench.core.engine.storage.atomic import write_file
from codecbench.core.engine.storage.bitstream_file import write_bitstreams
from codecbench.core.engine.storage.environment import environment_id
from codecbench.core.engine.storage.record import Record, cell_description
from codecbench.core.engine.storage.samples import parquet_from_samples
from codecbench.core.engine.storage.store import Store

RATE = Metric("rate_bpp", "bpp", "lower", "bits", role="rate", headline=True)
ERROR = Metric("error", "1", "lower", "an error", role="quality", headline=True)
TICKS = Metric("ticks_ms", "ms", "lower", "a time", repeatable=False, role="time")
FRAMES = 3


def write_kept_run(
    folder: Path,
    *,
    name: str = "kept",
    sequence: str = "ramp",
    label: str = "q=2",
    note: str = "a note",
    cells: int = 2,
) -> Plan:
    """A run of one codec setting on one sequence: `cells` repeats of an evaluator that nobody has installed."""
    frames = SequenceEntry(
        sequence, PluginSetting("dataset", "ramps", "1", {"frames": FRAMES}), "f00d", FRAMES, 1, False, False
    )
    codec = PluginSetting("codec", "shifts", "1", {"q": 2}, label, distribution="somebody 1.0")
    evaluator = PluginSetting("evaluator", "judge", "1", {}, distribution="somebody 1.0")
    job = CodingJob(digest("job"), frames, codec)
    made = tuple(
        Cell(digest(["cell", repeat]), frames, codec, evaluator, repeat, repeat, False, job.id)
        for repeat in range(cells)
    )
    metrics = [{**asdict(metric), "aggregates": list(metric.aggregates)} for metric in (RATE, ERROR, TICKS)]
    plan = Plan(
        name=name,
        matrix_text="version: 1\n",
        run=RunSettings(1, 60.0, 1024, 0, PluginSetting("executor", "local", "1", {})),
        sequences=(frames,),
        jobs=(job,),
        cells=made,
        declared={"evaluators": {"judge": {"metrics": metrics, "views": []}}, "codecs": {"shifts": {"reference": ""}}},
    )
    environment = {"machine": {"cpu": "an abacus"}, "packages": {"numpy": "2"}}
    store = Store(folder)
    with store.locked():
        store.write_plan(plan)
        store.log_path.write_text("what was logged\n")
        for cell in made:
            store.write_record(_record(cell, environment, note))
        with open(store.coded_path(job.id), "wb") as stream:
            write_bitstreams(stream, [bytes([frame]) * 40 for frame in range(FRAMES)], job.id)
        store.note_encoder(job.id, "somebody 1.0 abc")
    write_file(folder / "report" / "report.html", b"<p>made from the records</p>")
    return plan


def _record(cell: Cell, environment: dict[str, dict[str, str]], note: str) -> Record:
    samples = [Measurement("error", frame + 0.25, frame) for frame in range(FRAMES)]
    single = (Measurement("rate_bpp", 1.5), Measurement("ticks_ms", 3.0 + cell.repeat))
    return replace(
        Record(cell.id, "ok", measurements=single, summaries=summarise(samples, (ERROR,))),
        metrics=("rate_bpp", "error", "ticks_ms"),
        environment=environment_id(environment),
        environment_description=environment,
        cell=cell_description(cell),
        duration_s=0.5,
        started_utc="2026-01-01T00:00:00",
        notes=(note,),
        contents={"frames.parquet": parquet_from_samples(samples), "trajectory.txt": b"0 0 0 0 0 0 0 1\n" * 20},
    )
