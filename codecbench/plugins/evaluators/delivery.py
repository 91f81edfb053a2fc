"""The `delivery` evaluator: what arrives of a coded sequence over a link, and when. docs/link.md explains the link."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from codecbench.core.contracts.codec import Architecture, gets_features
from codecbench.core.contracts.evaluator import (
    CodedSequence,
    Context,
    Measurement,
    Outcome,
    PluginUse,
    SequenceEvaluator,
)
from codecbench.core.contracts.metric import Metric, Quantity
from codecbench.core.contracts.view import Drawing, FrameTimeline, Line, View
from codecbench.core.simulation.delivery import Delivery, delivery_of
from codecbench.core.simulation.receiver import FrameOutcome
from codecbench.core.simulation.settings import LinkSettings
from codecbench.plugins.evaluators.outcomes import rows_of_outcomes

_UNTIMELY: Final[dict[FrameOutcome, tuple[str, str]]] = {
    "late": ("share of frames older than deadline_ms, or after a newer one", "too late"),
    "lost": ("share of frames sent but never whole", "lost on the way"),
    "broken": ("share of frames whole that depend on one not whole", "broken by an earlier loss"),
    "skipped": ("share of frames never sent, for want of time or rate", "never sent"),
}


_TIMELINE: Final = "timeline.csv"
"""For each frame, when it was taken, when it was there, and its outcome; in seconds, infinite if never in time."""
_NOTE: Final = (
    "The age of the newest picture falls when one comes, and rises until the next; beside it the delay of each."
)


class DeliveryParams(LinkSettings):
    """`link` and all about it: see LinkSettings. `repeats`: cells for each setting, each with its own chance.

    `architecture`: `features` refuses codecs of pictures; else each is measured by what it sends.
    """

    link: str | None = "ideal"
    repeats: Annotated[int, Field(ge=1)] = 5
    architecture: Architecture = "cta"


def _count(name: str, summary: str, label: str, aggregates: tuple[str, ...] = ("mean", "max")) -> Metric:
    return Metric(name, "1", "lower", summary, aggregates, label=label)


class DeliveryEvaluator(SequenceEvaluator[DeliveryParams]):
    """Sizes alone are looked at: nothing is decoded, and coded anew only where the sender adapts."""

    name = "delivery"
    version = "1"
    params_type = DeliveryParams
    typical_ms_per_frame = 0.2
    views = (View("map", "What comes, and how old it is", note=_NOTE),)
    metrics: ClassVar[tuple[Metric, ...]] = (
        Metric(
            "on_time", "1", "higher", "1 if the frame is handed on, else 0",
            role="task", headline=True, label="pictures on time", column_header="on time",
        ),
        Metric(
            "age_ms", "ms", "lower",
            "at each capture, age of the newest frame handed on, or time since the first capture",
            ("p95", "median", "max"),
            role="task", headline=True, label="age of the newest picture", column_header="age ms", scale="log",
        ),
        Metric(
            "delay_ms", "ms", "lower",
            "from capture until decoded; missing if not on time",
            ("median", "p95", "max"),
            label="delay of pictures", scale="log", quantity="delay",
        ),
        Metric("delivered_share", "1", "higher", "share of frames whole, however late", label="delivered"),
        Metric(
            "concealed_share", "1", "lower", "share of frames on time that depend on a lost one",
            label="concealed",
        ),
        Metric(
            "partial_share", "1", "lower", "share of frames on time with missing packets",
            label="in part",
        ),
        Metric(
            "partial_whole_share", "1", "higher",
            "share of their pixels that are undamaged",
            label="as sent of those in part",
        ),
        *(
            Metric(f"{outcome}_share", "1", "lower", summary, label=label, quantity="cause")
            for outcome, (summary, label) in _UNTIMELY.items()
        ),
        _count("stalls_half_s", "waits over 0.5 s for a frame", "stalls over 0.5 s"),
        _count("stalls_1_s", "waits over 1 s for a frame", "stalls over 1 s"),
        Metric("longest_stall_s", "s", "lower", "longest wait for a frame", ("median", "max"), scale="log"),
        _count(
            "queue_packets", "packets queued when a frame comes to the encoder",
            "packets waiting", ("p95", "max"),
        ),
        Metric(
            "goodput_kbps", "kbit/s", "higher", "bytes of frames on time over the nominal length",
            label="goodput",
        ),
        Metric(
            "sent_kbps", "kbit/s", "lower",
            "bytes sent, with headers, redundancy and retransmissions",
            role="rate", label="sent over the link", scale="log",
        ),
        Metric("wasted_share", "1", "lower", "share of sent bytes for frames not on time", label="sent in vain"),
        Metric("packets_sent", "1", "neither", "packets given to the link"),
        Metric("packets_arrived", "1", "neither", "packets that arrived"),
        Metric("packets_late", "1", "lower", "packets arrived when their frame was past deadline_ms"),
        Metric("packets_lost", "1", "lower", "packets lost by the link"),
        Metric("packets_dropped", "1", "lower", "packets dropped by the queue"),
    )  # fmt: skip

    @property
    def repeats(self) -> int:
        return self.params.repeats

    @property
    def uses(self) -> tuple[PluginUse, ...]:
        return self.params.link_uses

    @property
    def requires(self) -> dict[str, Quantity]:
        return self.params.requires

    def repeat_identity(self, repeat: int) -> dict[str, Any]:
        """All parameters but `repeats`: more of them recompute nothing."""
        return {name: value for name, value in self.params.identity().items() if name != "repeats"}

    def evaluate(self, coded: CodedSequence, context: Context) -> Iterator[Measurement]:
        gets_features(coded.codec, self.params.architecture)
        found = delivery_of(coded, self.params, context)
        yield from _of_frames(found)
        for outcome in _UNTIMELY:
            yield Measurement(f"{outcome}_share", found.outcomes.count(outcome) / len(found.outcomes))
        yield Measurement("delivered_share", float(found.came.mean()))
        handed = found.output_frames
        concealed = found.outcomes.count("concealed")
        yield (
            Measurement("concealed_share", concealed / len(handed))
            if handed
            else Measurement("concealed_share", math.nan, reason="no picture was on time")
        )
        if self.params.partial:
            yield from _of_parts(found)
        gaps_s = found.gaps_s()
        yield Measurement("stalls_half_s", float(np.count_nonzero(gaps_s > 0.5)))
        yield Measurement("stalls_1_s", float(np.count_nonzero(gaps_s > 1.0)))
        yield Measurement("longest_stall_s", float(gaps_s.max()))
        yield from _rates(found, len(found.outcomes) / coded.sequence.frame_rate_hz)
        for name in ("sent", "arrived", "late", "lost", "dropped"):
            yield Measurement(f"packets_{name}", float(getattr(found.packets, name)))
        rows = zip(found.captured_s, found.handed_s, found.outcomes, strict=True)
        lines = [f"{taken_s:.6f},{handed_s:.6f},{outcome}\n" for taken_s, handed_s, outcome in rows]
        (context.artifacts / _TIMELINE).write_text("".join(lines))

    def drawing(self, outcome: Outcome) -> Drawing:
        captured_s, handed_s, outcomes = _read_timeline(outcome.artifacts / _TIMELINE)
        came = np.isfinite(handed_s)
        shares = [(cause, outcome.value(f"{cause}_share")) for cause in _UNTIMELY]
        words = [f"{100 * share:.0f} % {cause}" for cause, share in shares if share >= 0.005]
        lines = (
            Line("age of the newest picture", "after", _saw(captured_s[came], handed_s[came], captured_s[-1])),
            Line("delay of pictures", "before", np.column_stack([captured_s, handed_s - captured_s])[came]),
        )
        caption = ", ".join([f"{100 * came.mean():.0f} % on time", *words])
        known = np.searchsorted(handed_s[came], captured_s, side="right")
        ages_s = captured_s - np.concatenate([captured_s[:1], captured_s[came]])[known]
        frames = np.arange(len(captured_s))
        timeline = FrameTimeline(frames, None, ages_s, "s", rows_of_outcomes(outcomes), "age of the newest picture")
        drawn = tuple(line for line in lines if len(line.points))
        return Drawing(drawn, caption, axes=("time [s]", "age [s]"), timeline=timeline)


def _read_timeline(path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64], list[str]]:
    """When each frame was taken and there, and its outcome; none of them in a file from before outcomes were kept."""
    rows = [line.split(",") for line in path.read_text().splitlines()]
    captured_s, handed_s = (np.array([float(row[column]) for row in rows]) for column in (0, 1))
    return captured_s, handed_s, [row[2] for row in rows if len(row) > 2]


def _saw(taken_s: NDArray[np.float64], handed_s: NDArray[np.float64], end_s: float) -> NDArray[np.float64]:
    """(P, 2) time and age of the newest picture, which falls when one comes and rises until the next; from time 0."""
    newest_s = np.concatenate([[0.0], taken_s])
    begins_s = np.concatenate([[0.0], handed_s])
    ends_s = np.concatenate([handed_s, [max(end_s, begins_s[-1])]])
    times_s = np.column_stack([begins_s, ends_s]).ravel()
    return np.column_stack([times_s, times_s - np.repeat(newest_s, 2)])


def _of_frames(found: Delivery) -> Iterator[Measurement]:
    for frame, (outcome, age_s, waiting) in enumerate(
        zip(found.outcomes, found.ages_s().tolist(), found.waiting.tolist(), strict=True)
    ):
        is_on_time = math.isfinite(found.handed_s[frame])
        delay_ms = 1e3 * float(found.handed_s[frame] - found.captured_s[frame]) if is_on_time else math.nan
        yield Measurement("on_time", float(is_on_time), frame)
        yield Measurement("delay_ms", delay_ms, frame, reason=None if is_on_time else f"the picture was {outcome}")
        yield Measurement("age_ms", 1e3 * age_s, frame)
        yield Measurement("queue_packets", float(waiting), frame)


def _of_parts(found: Delivery) -> Iterator[Measurement]:
    whole = [found.parts[frame].whole_share for frame in found.output_frames if frame in found.parts]
    if not found.output_frames:
        yield Measurement("partial_share", math.nan, reason="no picture was on time")
    else:
        yield Measurement("partial_share", len(whole) / len(found.output_frames))
    reason = None if whole else "no picture came in part"
    yield Measurement("partial_whole_share", float(np.mean(whole)) if whole else math.nan, reason=reason)


def _rates(found: Delivery, duration_s: float) -> Iterator[Measurement]:
    handed = found.output_frames
    sent_bytes = int(found.sent_bytes.sum())
    yield Measurement("goodput_kbps", 8e-3 * found.output_bytes / duration_s)
    yield Measurement("sent_kbps", 8e-3 * sent_bytes / duration_s)
    if sent_bytes:
        yield Measurement("wasted_share", 1.0 - float(found.sent_bytes[handed].sum()) / sent_bytes)
    else:
        yield Measurement("wasted_share", math.nan, reason="nothing was sent")
