"""How long streams take to join, and codecs in order of their tasks."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from run_tables import CODING, SETTING, Column, rows_of

from codecbench.core.analysis.ranking import rankings
from codecbench.core.analysis.run_result import RunResult
from codecbench.core.report.formatting import signed_percent
from codecbench.core.report.tables import table

Heads = tuple[str, ...]
ANCHORS: Final = ("jpeg", "h264")
JOINING: Final = {
    "kbit/s": Column("stream.bitrate_kbps.mean"),
    "PSNR dB": CODING["PSNR dB"],
    "largest frame, bytes": Column("stream.largest_frame_bytes.mean"),
    "joining, frames": Column("stream.joining_frames.mean"),
    "worst, frames": Column("stream.joining_worst_frames.mean"),
}


def joining(run: RunResult, heads: Heads) -> Iterator[str]:
    """How long a receiver waits for whole pictures, and at what price."""
    (sequence,) = run.plan.sequences
    yield f"{sequence.frames} frames at 30 Hz, joined at twenty of the first half:\n"
    rows = rows_of(run, sequence.name)
    yield table(heads, [[row[head] if head in SETTING else JOINING[head].shown(row) for head in heads] for row in rows])


def order(run: RunResult, heads: Heads) -> Iterator[str]:
    """Codecs in order of each task, and what they save vs. a still codec and vs. a stream."""
    rows = []
    for ranking in rankings(run, brief=True):
        for ranked in ranking.ranked:
            beside = [ranking.evidence(ranked.curve, anchor) for anchor in ANCHORS]
            saved = ["–" if found is None else signed_percent(found) for found in beside]
            rows.append([ranking.column.label, ranked.curve, *saved, ", ".join(ranked.ahead_of) or "–"])
    yield table(heads, rows)
