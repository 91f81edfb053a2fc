"""The `delivery` evaluator measures which frames of a coded sequence arrive over a link, and when; see docs/link.md."""

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

_CAUSES_OF_LOSS: Final[dict[FrameOutcome, tuple[str, str]]] = {
    "late": ("share of frames older than deadline_ms, or after a newer one", "too late"),
    "lost": ("share of frames sent but never whole", "lost in transit"),
    "broken": ("share of frames whole that depend on one not whole", "broken by an earlier loss"),
    "skipped": ("share of frames never sent, for lack of time or rate", "never sent"),
}
"""Summary and label of the metric `<outcome>_share` of each outcome that keeps a frame from being on time."""


_TIMELINE: Final = "timeline.csv"
"""File of a line for each frame: capture time, delivery time (both in seconds, infinite if never) and outcome."""
_NOTE: Final = (
    "The age of the newest frame falls when a frame arrives, then rises until the next. The other line is their delay."
)


class DeliveryParams(LinkSettings):
    """Set the link over which frames are delivered; LinkSettings explains the parameters not listed here.

    repeats: cells per setting, each with other random numbers.
    architecture: `features` refuses image codecs; otherwise any codec is measured by what it sends.
    """

    link: str | None = "ideal"
    repeats: Annotated[int, Field(ge=1)] = 5
    architecture: Architecture = "cta"


def _count_metric(name: str, summary: str, label: str, aggregates: tuple[str, ...] = ("mean", "max")) -> Metric:
    return Metric(name, "1", "lower", summary, aggregates, label=label)


class DeliveryEvaluator(SequenceEvaluator[DeliveryParams]):
    """Simulates delivery from frame sizes: decodes nothing, and encodes again only if the sender adapts its rate."""

    name = "delivery"
    version = "1"
    bits = (8, 16)
    params_type = DeliveryParams
    typical_ms_per_frame = 0.2
    views = (View("map", "Delivered frames and their age", note=_NOTE),)
    metrics: ClassVar[tuple[Metric, ...]] = (
        Metric(
            "on_time", "1", "higher", "1 if the receiver outputs the frame, else 0",
            role="task", headline=True, label="frames before the deadline", column_header="on time",
        ),
        Metric(
            "age_ms", "ms", "lower",
            "at each capture, age of the newest output frame, or time since the first capture",
            ("p95", "median", "max"),
            role="task", headline=True, label="age of the newest frame", column_header="age ms", scale="log",
        ),
        Metric(
            "delay_ms", "ms", "lower",
            "from capture until decoded; missing if not on time",
            ("median", "p95", "max"),
            label="frame delay", scale="log", quantity="delay",
        ),
        Metric("delivered_share", "1", "higher", "share of frames whole, however late", label="delivered"),
        Metric(
            "concealed_share", "1", "lower", "share of frames on time that depend on a lost one",
            label="concealed",
        ),
        Metric(
            "partial_share", "1", "lower", "share of frames on time with missing packets",
            label="partial",
        ),
        Metric(
            "partial_whole_share", "1", "higher",
            "share of undamaged pixels in partial frames",
            label="intact share of partial frames",
        ),
        *(
            Metric(f"{outcome}_share", "1", "lower", summary, label=label, quantity="cause")
            for outcome, (summary, label) in _CAUSES_OF_LOSS.items()
        ),
        _count_metric("stalls_half_s", "waits over 0.5 s for a frame", "stalls over 0.5 s"),
        _count_metric("stalls_1_s", "waits over 1 s for a frame", "stalls over 1 s"),
        Metric("longest_stall_s", "s", "lower", "longest wait for a frame", ("median", "max"), scale="log"),
        _count_metric(
            "queue_packets", "packets queued when a frame reaches the encoder",
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
        Metric("wasted_share", "1", "lower", "share of sent bytes for frames not on time", label="wasted"),
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
        """All parameters except `repeats`, so that more repeats recompute nothing."""
        return {name: value for name, value in self.params.identity().items() if name != "repeats"}

    def evaluate(self, coded: CodedSequence, context: Context) -> Iterator[Measurement]:
        gets_features(coded.codec, self.params.architecture)
        delivery = delivery_of(coded, self.params, context)
        yield from _frame_measurements(delivery)
        for outcome in _CAUSES_OF_LOSS:
            yield Measurement(f"{outcome}_share", delivery.outcomes.count(outcome) / len(delivery.outcomes))
        yield Measurement("delivered_share", float(delivery.came.mean()))
        handed = delivery.output_frames
        concealed = delivery.outcomes.count("concealed")
        yield (
            Measurement("concealed_share", concealed / len(handed))
            if handed
            else Measurement("concealed_share", math.nan, reason="no frame was on time")
        )
        if self.params.partial:
            yield from _partial_measurements(delivery)
        gaps_s = delivery.gaps_s()
        yield Measurement("stalls_half_s", float(np.count_nonzero(gaps_s > 0.5)))
        yield Measurement("stalls_1_s", float(np.count_nonzero(gaps_s > 1.0)))
        yield Measurement("longest_stall_s", float(gaps_s.max()))
        yield from _rates(delivery, len(delivery.outcomes) / coded.sequence.frame_rate_hz)
        for name in ("sent", "arrived", "late", "lost", "dropped"):
            yield Measurement(f"packets_{name}", float(getattr(delivery.packets, name)))
        rows = zip(delivery.captured_s, delivery.handed_s, delivery.outcomes, strict=True)
        lines = [f"{captured_s:.6f},{handed_s:.6f},{outcome}\n" for captured_s, handed_s, outcome in rows]
        (context.artifacts / _TIMELINE).write_text("".join(lines))

    def drawing(self, outcome: Outcome) -> Drawing:
        captured_s, handed_s, outcomes = _read_timeline(outcome.artifacts / _TIMELINE)
        is_on_time = np.isfinite(handed_s)
        shares = [(cause, outcome.value(f"{cause}_share")) for cause in _CAUSES_OF_LOSS]
        words = [f"{100 * share:.0f} % {cause}" for cause, share in shares if share >= 0.005]
        lines = (
            Line(
                "age of the newest frame",
                "after",
                _age_sawtooth(captured_s[is_on_time], handed_s[is_on_time], captured_s[-1]),
            ),
            Line("frame delay", "before", np.column_stack([captured_s, handed_s - captured_s])[is_on_time]),
        )
        caption = ", ".join([f"{100 * is_on_time.mean():.0f} % on time", *words])
        newest = np.searchsorted(handed_s[is_on_time], captured_s, side="right")
        ages_s = captured_s - np.concatenate([captured_s[:1], captured_s[is_on_time]])[newest]
        frames = np.arange(len(captured_s))
        timeline = FrameTimeline(frames, None, ages_s, "s", rows_of_outcomes(outcomes), "age of the newest frame")
        nonempty = tuple(line for line in lines if len(line.points))
        return Drawing(nonempty, caption, axes=("time [s]", "age [s]"), timeline=timeline)


def _read_timeline(path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64], list[str]]:
    """Capture times, delivery times and outcomes of the frames; older files have no outcomes, which are then empty."""
    rows = [line.split(",") for line in path.read_text().splitlines()]
    captured_s, handed_s = (np.array([float(row[column]) for row in rows]) for column in (0, 1))
    return captured_s, handed_s, [row[2] for row in rows if len(row) > 2]


def _age_sawtooth(captured_s: NDArray[np.float64], handed_s: NDArray[np.float64], end_s: float) -> NDArray[np.float64]:
    """(P, 2) time and age of the newest frame, from time 0. The age falls when one arrives, then rises."""
    newest_s = np.concatenate([[0.0], captured_s])
    begins_s = np.concatenate([[0.0], handed_s])
    ends_s = np.concatenate([handed_s, [max(end_s, begins_s[-1])]])
    times_s = np.column_stack([begins_s, ends_s]).ravel()
    return np.column_stack([times_s, times_s - np.repeat(newest_s, 2)])


def _frame_measurements(delivery: Delivery) -> Iterator[Measurement]:
    """The metrics that have a value for each frame."""
    for frame, (outcome, age_s, waiting) in enumerate(
        zip(delivery.outcomes, delivery.ages_s().tolist(), delivery.waiting.tolist(), strict=True)
    ):
        is_on_time = math.isfinite(delivery.handed_s[frame])
        delay_ms = 1e3 * float(delivery.handed_s[frame] - delivery.captured_s[frame]) if is_on_time else math.nan
        yield Measurement("on_time", float(is_on_time), frame)
        yield Measurement("delay_ms", delay_ms, frame, reason=None if is_on_time else f"the frame was {outcome}")
        yield Measurement("age_ms", 1e3 * age_s, frame)
        yield Measurement("queue_packets", float(waiting), frame)


def _partial_measurements(delivery: Delivery) -> Iterator[Measurement]:
    """The metrics of frames that were handed on with packets missing."""
    whole_shares = [delivery.parts[frame].whole_share for frame in delivery.output_frames if frame in delivery.parts]
    if not delivery.output_frames:
        yield Measurement("partial_share", math.nan, reason="no frame was on time")
    else:
        yield Measurement("partial_share", len(whole_shares) / len(delivery.output_frames))
    reason = None if whole_shares else "no frame was partial"
    yield Measurement("partial_whole_share", float(np.mean(whole_shares)) if whole_shares else math.nan, reason=reason)


def _rates(delivery: Delivery, duration_s: float) -> Iterator[Measurement]:
    handed = delivery.output_frames
    sent_bytes = int(delivery.sent_bytes.sum())
    yield Measurement("goodput_kbps", 8e-3 * delivery.output_bytes / duration_s)
    yield Measurement("sent_kbps", 8e-3 * sent_bytes / duration_s)
    if sent_bytes:
        yield Measurement("wasted_share", 1.0 - float(delivery.sent_bytes[handed].sum()) / sent_bytes)
    else:
        yield Measurement("wasted_share", math.nan, reason="nothing was sent")
