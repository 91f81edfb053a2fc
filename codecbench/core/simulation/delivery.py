"""A coded sequence over a link: what arrives, when, and what becomes of the rest."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.evaluator import CodedSequence, Context, SentPacket
from codecbench.core.contracts.link import Link
from codecbench.core.simulation.adaptation import AdaptiveEncoder, adaptive_encoder
from codecbench.core.simulation.link_queue import EventSimulator
from codecbench.core.simulation.partial import Part, PartialDecode, PartialDecoder, received_ranges
from codecbench.core.simulation.receiver import FrameOutcome, frame_outcomes
from codecbench.core.simulation.sender import PacketCounts, Sender
from codecbench.core.simulation.settings import LinkSettings

Times = NDArray[np.float64]


@dataclass(frozen=True)
class Delivery:
    """What became of N frames. Times are in seconds from the first picture on.

    captured_s: (N,). handed_s: (N,) when each was there, decoded, for whoever reads it; infinite where it never was or
    was too old. outcomes: of each. sizes_bytes: (N,) as coded. sent_bytes: (N,) with headers, redundancy and what went
    again. came: (N,) whether all of a frame came, however late. packets: counts of those sent. waiting: (N,) packets
    in the link's queue when each frame came to the encoder. units: what was coded, in that order. bitstreams: of the
    frames that were coded anew, as the link asked. parts: of the frames of which a decoder makes something although
    packets are missing.
    """

    captured_s: Times
    handed_s: Times
    outcomes: tuple[FrameOutcome, ...]
    sizes_bytes: NDArray[np.int64]
    sent_bytes: NDArray[np.int64]
    came: NDArray[np.bool_]
    packets: PacketCounts
    waiting: NDArray[np.int64]
    units: tuple[SentPacket, ...] = ()
    bitstreams: Mapping[int, bytes] = field(default_factory=dict)
    parts: Mapping[int, Part] = field(default_factory=dict)

    @property
    def handed(self) -> list[int]:
        """The frames that were handed on, in order."""
        return np.flatnonzero(np.isfinite(self.handed_s)).tolist()

    @property
    def handed_bytes(self) -> int:
        """Of the bitstreams of those, as far as they came."""
        parts = self.parts
        return sum(
            parts[frame].received.size_bytes if frame in parts else int(self.sizes_bytes[frame])
            for frame in self.handed
        )

    def read_at(self, pace_s: float) -> dict[int, float]:
        """By frame, when a reader has done with it that takes `pace_s` for each, and then takes the newest there is."""
        if pace_s == 0.0:
            return {frame: float(self.handed_s[frame]) for frame in self.handed}
        done_s: dict[int, float] = {}
        frames, place, free_s = self.handed, 0, 0.0
        while place < len(frames):
            begun_s = max(free_s, float(self.handed_s[frames[place]]))
            while place + 1 < len(frames) and self.handed_s[frames[place + 1]] <= begun_s:
                place += 1
            free_s = done_s[frames[place]] = begun_s + pace_s
            place += 1
        return done_s

    def ages_s(self) -> Times:
        """(N,) how old the newest picture was at the moment of each; before there is one, since the first was taken."""
        frames = np.array(self.handed, dtype=np.int64)
        known = np.searchsorted(self.handed_s[frames], self.captured_s, side="right") - 1
        newest_s = np.where(known >= 0, self.captured_s[frames[known]] if len(frames) else 0.0, self.captured_s[0])
        return np.asarray(self.captured_s - newest_s)

    def gaps_s(self) -> Times:
        """Times without a new picture, from the first frame to the last, or to the last picture where that is later."""
        handed_s = self.handed_s[self.handed]
        return np.diff(np.concatenate([[0.0], handed_s, [max(self.captured_s[-1], *handed_s, 0.0)]]))


def delivery_of(coded: CodedSequence, settings: LinkSettings, context: Context) -> Delivery:
    """What comes of a coded sequence over the link of an evaluator's settings, with the luck of the cell's repeat."""
    settings = settings.timed(context.inputs)
    if settings.concealed and coded.codec.carries == "features":
        # What depends on a lost set is missing: nothing is made up.
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
    """Send what an encoder gave over a link.

    units: in the order in which they came out. timestamps_s: (N,) of the frames. encoder: codes them anew, as the link
    asks. partial_decode: what a decoder makes of frames that are not whole. Equal arguments give an equal answer.
    """
    if settings.queue_policy == "auto":
        stands_alone = all(unit.starts for unit in units)
        settings = settings.model_copy(update={"queue_policy": "latest_only" if stands_alone else "fifo"})
    captured_s = np.asarray(timestamps_s, dtype=np.float64) - timestamps_s[0]
    of_frames = captured_s.tolist()
    simulator = EventSimulator()
    sender = Sender(simulator, units, [of_frames[unit.frame] for unit in units], link, settings, rng, encoder)
    for number, unit in enumerate(units):
        ready_s = of_frames[min(unit.after, len(of_frames)) - 1]
        simulator.at(ready_s, lambda number=number: sender.give(number))  # type: ignore[misc]
    simulator.run()
    complete_s = {number: shipment.complete_s for number, shipment in sender.shipments.items()}
    parts = {} if partial_decode is None else _parts(sender, units, of_frames, settings, partial_decode)
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
    """By frame, those that are of use although they are not whole, and not too old by then."""
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
