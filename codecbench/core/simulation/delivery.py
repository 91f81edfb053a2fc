"""Delivery of a coded sequence over a link: which frames arrive, when, and why the others do not."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.codec import decoder_of
from codecbench.core.contracts.evaluator import CodedSequence, Context, SentPacket
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.link import Link
from codecbench.core.contracts.stream import LOST, Picture, StreamDecoder
from codecbench.core.simulation.adaptation import AdaptiveEncoder, adaptive_encoder
from codecbench.core.simulation.link_queue import EventSimulator
from codecbench.core.simulation.receiver import (
    FrameOutcome,
    Part,
    PartialDecode,
    PartialDecoder,
    frame_outcomes,
    received_ranges,
)
from codecbench.core.simulation.sender import PacketCounts, Sender
from codecbench.core.simulation.settings import LinkSettings

Times = NDArray[np.float64]


@dataclass(frozen=True)
class Delivery:
    """Delivery outcomes of N frames. Times are in seconds since the first frame's capture."""

    captured_s: Times
    """(N,) capture times."""
    handed_s: Times
    """(N,) when the receiver output each decoded frame; infinite if it never did."""
    outcomes: tuple[FrameOutcome, ...]
    """(N,) delivery outcomes."""
    sizes_bytes: NDArray[np.int64]
    """(N,) coded sizes."""
    sent_bytes: NDArray[np.int64]
    """(N,) bytes sent, with headers, redundancy and retransmissions."""
    came: NDArray[np.bool_]
    """(N,) whether all of a frame arrived, however late."""
    packets: PacketCounts
    waiting: NDArray[np.int64]
    """(N,) packets in the link's queue when each frame reached the encoder."""
    units: tuple[SentPacket, ...] = ()
    """What was coded, in coding order."""
    bitstreams: Mapping[int, bytes] = field(default_factory=dict)
    """By frame, bitstreams of those that were re-encoded to fit the link."""
    parts: Mapping[int, Part] = field(default_factory=dict)
    """By frame, those decoded in part although packets are missing."""

    @property
    def output_frames(self) -> list[int]:
        """The frames that the receiver output, in order."""
        return np.flatnonzero(np.isfinite(self.handed_s)).tolist()

    @property
    def output_bytes(self) -> int:
        """Size of their bitstreams, as far as these arrived."""
        parts = self.parts
        return sum(
            parts[frame].received.size_bytes if frame in parts else int(self.sizes_bytes[frame])
            for frame in self.output_frames
        )

    def read_at(self, pace_s: float) -> dict[int, float]:
        """Return by frame when a reader is done with it that takes `pace_s` for each, always of the newest frame."""
        if pace_s == 0.0:
            return {frame: float(self.handed_s[frame]) for frame in self.output_frames}
        done_s: dict[int, float] = {}
        frames, place, free_s = self.output_frames, 0, 0.0
        while place < len(frames):
            begun_s = max(free_s, float(self.handed_s[frames[place]]))
            while place + 1 < len(frames) and self.handed_s[frames[place + 1]] <= begun_s:
                place += 1
            free_s = done_s[frames[place]] = begun_s + pace_s
            place += 1
        return done_s

    def ages_s(self) -> Times:
        """Return (N,) the age of the newest output frame at each capture; before the first, the time since time 0."""
        frames = np.array(self.output_frames, dtype=np.int64)
        known = np.searchsorted(self.handed_s[frames], self.captured_s, side="right") - 1
        newest_s = np.where(known >= 0, self.captured_s[frames[known]] if len(frames) else 0.0, self.captured_s[0])
        return np.asarray(self.captured_s - newest_s)

    def gaps_s(self) -> Times:
        """Return the times between output frames, from the first capture to the last, or the last output if later."""
        output_s = self.handed_s[self.output_frames]
        return np.diff(np.concatenate([[0.0], output_s, [max(self.captured_s[-1], *output_s, 0.0)]]))


def delivery_of(coded: CodedSequence, settings: LinkSettings, context: Context) -> Delivery:
    """Simulate a coded sequence over the link of an evaluator's settings; the cell's repeat seeds the randomness."""
    settings = settings.with_measured_times(context.inputs)
    if settings.concealed and coded.codec.carries == "features":
        # A set that depends on a lost one is missing: features are never concealed.
        settings = settings.model_copy(update={"concealed": False})
    link, rng = settings.create_link(context.plugins), settings.link_rng(context.repeat)
    encoder = None if settings.adapt is None else adaptive_encoder(coded, settings.adapt)
    bitstreams = {} if encoder is None else encoder.bitstreams
    partial_decode = PartialDecoder(coded, bitstreams).whole_share if settings.partial else None
    delivery = deliver(coded.packets, coded.sequence.timestamps_s, link, settings, rng, encoder, partial_decode)
    return replace(delivery, bitstreams=bitstreams)


def deliver(
    units: Sequence[SentPacket],
    timestamps_s: Times,
    link: Link[Any],
    settings: LinkSettings,
    rng: np.random.Generator,
    encoder: AdaptiveEncoder | None = None,
    partial_decode: PartialDecode | None = None,
) -> Delivery:
    """Simulate sending an encoder's output over a link. Equal arguments give equal results.

    units: in coding order. timestamps_s: (N,) of the frames. encoder: re-encodes frames to fit the link.
    partial_decode: decodes incomplete frames.
    """
    if settings.queue_policy == "auto":
        stands_alone = all(unit.starts for unit in units)
        settings = settings.model_copy(update={"queue_policy": "latest_only" if stands_alone else "fifo"})
    captured_s = np.asarray(timestamps_s, dtype=np.float64) - timestamps_s[0]
    frame_times = captured_s.tolist()
    simulator = EventSimulator()
    sender = Sender(simulator, units, [frame_times[unit.frame] for unit in units], link, settings, rng, encoder)
    for number, unit in enumerate(units):
        ready_s = frame_times[min(unit.after, len(frame_times)) - 1]
        simulator.at(ready_s, lambda number=number: sender.enqueue(number))  # type: ignore[misc]
    simulator.run()
    complete_s = {number: shipment.complete_s for number, shipment in sender.shipments.items()}
    parts = {} if partial_decode is None else _parts(sender, units, frame_times, settings, partial_decode)
    partial_s = {number: parts[unit.frame].received.known_s for number, unit in enumerate(units) if unit.frame in parts}
    outcomes, handed_s = frame_outcomes(sender.units, captured_s, complete_s, settings, partial_s)
    sizes, sent, waiting = np.zeros((3, len(captured_s)), dtype=np.int64)
    came = np.zeros(len(captured_s), dtype=bool)
    for number, unit in enumerate(units):
        sizes[unit.frame] = sender.units.get(number, unit).size_bytes
        sent[unit.frame] = sender.shipments[number].sent_bytes if number in sender.shipments else 0
        waiting[unit.frame] = sender.waiting[number]
        came[unit.frame] = math.isfinite(complete_s.get(number, math.inf))
    coded = tuple(sender.units.values())
    return Delivery(
        captured_s, handed_s, tuple(outcomes), sizes, sent, came, sender.counts, waiting, coded, parts=parts
    )


def _parts(
    sender: Sender,
    units: Sequence[SentPacket],
    captured_s: Sequence[float],
    settings: LinkSettings,
    partial_decode: PartialDecode,
) -> dict[int, Part]:
    """Return by frame the incomplete ones that can be decoded in part before the deadline."""
    parts = {}
    sizes_bytes = {number: unit.size_bytes for number, unit in sender.units.items()}
    for number, received in received_ranges(sender.shipments, sizes_bytes, settings).items():
        frame = units[number].frame
        if received.known_s - captured_s[frame] > settings.deadline_s:
            continue
        whole_share = partial_decode(frame, received.ranges)
        if whole_share is not None:
            parts[frame] = Part(received, whole_share)
    return parts


class DeliveredFrames:
    """Decoded images of the frames that a receiver outputs; ask for them in rising order.

    If something was concealed, or an inter-frame codec re-encoded, a session decodes all that arrived and is told of
    each loss: from the first loss on, only the codec can say what its frames look like.
    """

    def __init__(self, coded: CodedSequence, delivery: Delivery) -> None:
        self._coded, self._came, self._bitstreams = coded, delivery.came, delivery.bitstreams
        self._parts, self._partial = delivery.parts, PartialDecoder(coded, delivery.bitstreams)
        is_recoded = bool(delivery.bitstreams) and not coded.codec.stateless
        self._decoder = decoder_of(coded.codec) if is_recoded or "concealed" in delivery.outcomes else None
        self._is_over = False
        self._units = iter(delivery.units)
        self._session = 0
        self._frames: list[int] | None = [] if is_recoded else None
        self._decoded: dict[int, Image | None] = {}

    def image(self, frame: int) -> Image | None:
        """Return the image of a frame that was output; None if the decoder makes none."""
        if frame in self._parts:
            partial = self._partial.decode(frame, self._parts[frame].received.ranges)
            return None if partial is None else partial.image
        if frame in self._bitstreams and self._coded.codec.stateless:
            return self._coded.codec.decode(self._bitstreams[frame])
        if self._decoder is None:
            return self._coded.frame(frame).decoded
        while frame not in self._decoded and not self._is_over:
            self._decoded |= {index: image for index, image in self._next(self._decoder) if index >= frame}
        return self._decoded.pop(frame, None)

    def _next(self, decoder: StreamDecoder) -> list[tuple[int, Image | None]]:
        """Decode the next packet, or flush at the end of its session; return images with their frames."""
        unit = next(self._units, None)
        self._is_over = unit is None
        if unit is None:
            return self._in_sequence(decoder.flush())
        flushed = []
        if unit.session != self._session:
            flushed = self._in_sequence(decoder.flush())
            decoder = self._decoder = decoder_of(self._coded.codec)
            self._session, self._frames = unit.session, []
        number = unit.frame
        if self._frames is not None:
            number = len(self._frames)
            self._frames.append(unit.frame)
        if not self._came[unit.frame]:
            return flushed + self._in_sequence(decoder.push(LOST))
        data = self._bitstreams.get(unit.frame) or self._coded.frame(unit.frame).bitstream
        return flushed + self._in_sequence(decoder.push(replace(unit, frame=number).packet(data)))

    def _in_sequence(self, pictures: list[Picture]) -> list[tuple[int, Image | None]]:
        """Return images with their frame in the sequence; a re-encoded session numbers them as they were pushed."""
        if self._frames is None:
            return [(picture.frame, picture.image) for picture in pictures]
        return [(self._frames[picture.frame], picture.image) for picture in pictures]
