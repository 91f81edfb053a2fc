"""Runs put together for the report: so many codecs and sequences, with failures, paths and frames as asked for."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from measured_runs import METRICS, cell_result, run_of

from codecbench.core.analysis.run_result import RunSchema
from codecbench.core.analysis.table import CellResult
from codecbench.core.contracts.evaluator import CodedFrame
from codecbench.core.contracts.sequence import Frame
from codecbench.core.contracts.view import Drawing, FrameTimeline, KeypointOverlay, Line, TimelineRow, View
from codecbench.core.facade import Run
from codecbench.core.report.pictures import frame_view

QUALITIES = (1.0, 2.0, 4.0)
REPEATS = 4
TRACEBACK = "Traceback (most recent call last):\n  ...\nValueError: it fails </pre><script>alert(1)</script>"


def report_run(
    codecs: int,
    sequences: int = 1,
    *,
    settings: int = 3,
    failed: int = 0,
    paths: bool = True,
    task: bool = True,
    noted: str = "",
) -> Run:
    """A run of `codecs` codecs beside raw, with as many settings each. failed: how many of the codecs' settings have
    no task. paths: whether its tracker left something to draw. task: whether there is a tracker. noted: of the first
    codec."""
    results: list[CellResult] = []
    left = failed
    for number, sequence in enumerate(f"sequence{number}" for number in range(sequences)):
        results += _cells("raw", 0.0, 24.0, sequence, number, paths, task, broken=False)
        for codec in range(codecs):
            for q in QUALITIES[:settings]:
                rate = 0.1 * q * (1 + 0.2 * codec)
                broken, left = left > 0, left - 1
                results += _cells(_name(codec), q, rate, sequence, number, paths, task, broken=broken)
    if noted:
        results = [replace(found, notes=(noted,)) if found.cell.codec.name == "plain" else found for found in results]
    run = run_of(*results)
    views = {"track": (View("map", "Paths", note="Seen from above."),)} if paths else {}
    return replace(run, schema=RunSchema({}, views, run.schema.baselines, run.schema.anchors))


def _name(codec: int) -> str:
    return "plain" if codec == 0 else f"codec{codec}"


def _cells(
    codec: str, q: float, rate: float, sequence: str, number: int, paths: bool, task: bool, *, broken: bool
) -> list[CellResult]:
    rng = np.random.default_rng([number, int(10 * q), int(100 * rate)])
    score = np.inf if codec == "raw" else 30 + 3 * np.log2(rate)
    own = {("bits", ""): [rate], ("score", ""): [score], ("speed", ""): [1 + rate]}
    found = [cell_result(codec, q, "look", own=own, sequence_name=sequence, count=300)]
    if broken:
        missing = cell_result(codec, q, "track", sequence_name=sequence, status="failed", reason="ValueError: it fails")
        return [*found, replace(missing, traceback=TRACEBACK)]
    for repeat in range(REPEATS if task else 0):
        drift = 0.01 / min(rate, 1.0) ** 0.5 * np.exp(rng.normal(0, 0.1))
        held = {("drift", ""): [drift], ("held", ""): [1.0 if rate > 0.15 else 0.0]}
        result = cell_result(codec, q, "track", own=held, repeat=repeat, sequence_name=sequence, count=300)
        found.append(replace(result, drawing=partial(_drawing, drift)) if paths else result)
    return found


def _drawing(drift: float) -> Drawing:
    turn = np.linspace(0, 2 * np.pi, 300)
    truth = np.column_stack([np.cos(turn), np.sin(2 * turn)])
    positions = truth + drift * np.column_stack([np.sin(5 * turn), np.cos(3 * turn)])
    positions[120:150] = np.nan
    errors = np.linalg.norm(positions - truth, axis=1)
    known = positions[~np.isnan(positions[:, 0])]
    lines = (Line("ground truth", "truth", truth), Line("optimised", "after", known))
    lost = np.isnan(errors)
    rows = (
        TimelineRow("tracked", "good", ~lost),
        TimelineRow("waiting", "fair", np.arange(300) < 3),
        TimelineRow("lost", "bad", lost),
    )
    timeline = FrameTimeline(np.arange(300), positions, errors, "m", rows)
    return Drawing(lines, f"error {drift:.3g} m", True, timeline=timeline)


def report_frames(run: Run, frames: tuple[int, ...] = (75, 225)) -> dict[str, Any]:
    """Frames of every setting but raw's, as the page takes them; all settings of a sequence share the original."""
    originals, found = [], []
    for entry in run.plan.sequences:
        first = len(originals)
        settings = {(r.cell.codec.name, r.cell.codec.label) for r in run.results if r.cell.codec.name != "raw"}
        for codec, label in sorted(settings):
            for place, index in enumerate(frames):
                view = frame_view(coded_frame(index), index, (200, 150), marks())
                if len(originals) < first + len(frames):
                    originals.append({"picture": view.original, "width": view.width, "height": view.height})
                found.append(
                    {"sequence": entry.name, "codec": codec, "setting": label, "title": f"{codec} {label}",
                     "frame": index, "original": first + place, "decoded": view.decoded,
                     "difference": view.difference, "kept": view.kept, "lost": view.lost, "note": view.note}
                )  # fmt: skip
    return {"frames": found, "originals": originals}


def coded_frame(index: int = 0, height: int = 240, width: int = 320) -> CodedFrame:
    """A ramp, and the same with its low bits gone."""
    image = np.add.outer(np.arange(height) // 2, np.arange(width) // 3).astype(np.uint8)
    return CodedFrame(Frame(index, 0.1 * index, image), b"", image & 0xF0)


def marks() -> KeypointOverlay:
    """Two places, of which the second is lost."""
    return KeypointOverlay(np.array([[160.0, 120.0], [170.0, 130.0]]), np.array([True, False]), "1 of 2 kept")


assert {"bits", "score", "speed", "drift", "held"} <= set(METRICS)
