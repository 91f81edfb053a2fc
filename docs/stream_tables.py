"""The tables of stills and streams side by side."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from run_tables import CODING, SETTING, Column, rows_of

from codecbench.core.analysis.ranking import Ranked, rankings
from codecbench.core.analysis.run_result import RunResult
from codecbench.core.report.tables import table

Heads = tuple[str, ...]
ANCHORS: Final = ("jpeg", "h264")
STREAMS: Final = {
    "kbit/s": Column("stream.bitrate_kbps.mean"),
    **{head: CODING[head] for head in ("bit/px", "PSNR dB", "SSIM", "features kept")},
    "localisation AUC": Column("localization.located_auc.mean"),
    "map points found": Column("localization.tracked_inliers.mean"),
    "relative pose AUC": Column("relative_pose.pose_auc_10deg.mean"),
    "ATE mm": Column("trajectory.ate_rmse_m.median", 1e3),
    "frames held back": Column("stream.delay_frames.mean"),
}


JOINING: Final = {
    "kbit/s": STREAMS["kbit/s"],
    "PSNR dB": STREAMS["PSNR dB"],
    "largest frame, bytes": Column("stream.largest_frame_bytes.mean"),
    "joining, frames": Column("stream.joining_frames.mean"),
    "worst, frames": Column("stream.joining_worst_frames.mean"),
}


def joining(run: RunResult, heads: Heads) -> Iterator[str]:
    """How long a receiver waits for whole pictures, and at what price."""
    (sequence,) = run.plan.sequences
    yield f"{sequence.frames} frames at 30 Hz, joined at twenty of the first half:\n"
    shown = {**STREAMS, **JOINING}
    rows = rows_of(run, sequence.name)
    yield table(heads, [[row[head] if head in SETTING else shown[head].shown(row) for head in heads] for row in rows])


def every_setting(run: RunResult, heads: Heads) -> Iterator[str]:
    """Rate, quality and tasks of every setting."""
    (sequence,) = run.plan.sequences
    rows = [
        [row[head] if head in SETTING else STREAMS[head].shown(row) for head in heads]
        for row in rows_of(run, sequence.name)
    ]
    yield f"{sequence.frames} frames at 30 Hz:\n"
    yield table(heads, rows)
    yield "![Localisation over the rate, one line a codec](images/video.svg)"


def order(run: RunResult, heads: Heads) -> Iterator[str]:
    """Codecs in order of each task, and what they save beside a still codec and beside a stream."""
    rows = []
    for ranking in rankings(run, brief=True):
        for ranked in ranking.ranked:
            places = str(ranked.first) if ranked.first == ranked.last else f"{ranked.first}–{ranked.last}"
            saved = [_saved(ranked, anchor) for anchor in ANCHORS]
            rows.append([ranking.column.label, places, ranked.curve, *saved, ", ".join(ranked.ahead_of) or "–"])
    yield table(heads, rows)


def _saved(ranked: Ranked, anchor: str) -> str:
    found = ranked.bd_rates.get(anchor)
    return "–" if found is None or found.reason else f"{found.percent:+.0f} %"
