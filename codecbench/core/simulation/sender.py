"""The sender: frames queue for the encoder, coded frames queue for the link, and lost packets are retransmitted."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from codecbench.core.contracts.evaluator import SentPacket
from codecbench.core.contracts.link import Link, Passage
from codecbench.core.simulation.adaptation import FILL, AdaptiveEncoder, Throughput
from codecbench.core.simulation.link_queue import EventSimulator, Packet, link_queue
from codecbench.core.simulation.settings import LinkSettings, QueuePolicy

MOST_TRIES: Final = 1000
"""Number of transmissions after which a packet is given up, whatever the transport promises."""


@dataclass
class PacketCounts:
    """Numbers of packets: each one sent arrives, is lost on the link, or is dropped by the link's queue."""

    sent: int = 0
    arrived: int = 0
    late: int = 0
    """Those that arrived after the deadline."""
    lost: int = 0
    dropped: int = 0


@dataclass
class Shipment:
    """The transmission of a unit."""

    needed: int
    """How many of its packets suffice to decode it."""
    count: int
    """How many packets there are; the first `needed` are its data, the others redundancy."""
    sent_bytes: int = 0
    """Bytes sent, with headers, redundancy and retransmissions."""
    arrivals: list[tuple[float, int]] = field(default_factory=list)
    """Arrival time in seconds and number of each packet that arrived."""

    @property
    def complete_s(self) -> float:
        """Time in seconds at which it can be decoded; infinite if it never can."""
        if len(self.arrivals) < self.needed:
            return math.inf
        return sorted(self.arrivals)[self.needed - 1][0]


def packets_of(unit: int, size_bytes: int, settings: LinkSettings) -> tuple[list[Packet], int]:
    """Return the packets of a unit and how many of them suffice to decode it.

    Redundancy is that of an ideal erasure code such as Reed-Solomon: any subset as large as the data suffices.
    """
    payload = settings.payload_bytes
    count = max(1, -(-size_bytes // payload))
    sizes = [settings.mtu] * (count - 1) + [size_bytes - (count - 1) * payload + settings.header_bytes]
    if settings.transport == "fec":
        sizes += [sizes[0]] * math.ceil(count * settings.fec_share)
    return [Packet(unit, size, number) for number, size in enumerate(sizes)], count


class FrameQueue:
    """A queue of units, by number; its policy says which are dropped.

    latest_only: a new one replaces all that wait. drop_late: those past the deadline when their turn comes are skipped.
    fifo: none.
    """

    def __init__(self, policy: QueuePolicy, captured_s: Sequence[float], deadline_s: float) -> None:
        self._policy, self._captured_s, self._deadline_s = policy, captured_s, deadline_s
        self._waiting: deque[int] = deque()

    def __iter__(self) -> Iterator[int]:
        return iter(self._waiting)

    def put(self, unit: int) -> None:
        """Append a unit."""
        if self._policy == "latest_only":
            self._waiting.clear()
        self._waiting.append(unit)

    def take(self, now_s: float) -> int | None:
        """Remove and return the next unit worth sending; None if there is none."""
        while self._waiting:
            unit = self._waiting.popleft()
            if self._policy != "drop_late" or now_s - self._captured_s[unit] <= self._deadline_s:
                return unit
        return None


class Sender:
    """A device with a camera. Units are the encoder's outputs, numbered in coding order."""

    units: dict[int, SentPacket]
    """Units that were coded, by number."""
    shipments: dict[int, Shipment]
    """Units that were sent, by number."""
    waiting: list[int]
    """Packets in the link's queue at each capture."""
    counts: PacketCounts

    def __init__(
        self,
        simulator: EventSimulator,
        units: Sequence[SentPacket],
        captured_s: Sequence[float],
        link: Link[Any],
        settings: LinkSettings,
        rng: np.random.Generator,
        encoder: AdaptiveEncoder | None = None,
    ) -> None:
        """captured_s: capture time of each unit's frame. encoder: re-encodes frames to fit the link."""
        self.units = dict(enumerate(units)) if encoder is None else {}
        self._encoder, self._throughput = encoder, Throughput()
        self._interval_s = float(np.median(np.diff(captured_s))) if len(captured_s) > 1 else 1.0
        self.shipments = {}
        self.waiting = []
        self.counts = PacketCounts()
        self._simulator, self._captured_s, self._settings = simulator, captured_s, settings
        self._frames = [unit.frame for unit in units]
        self._unencoded, self._encoded = (
            FrameQueue(settings.queue_policy, captured_s, settings.deadline_s) for _ in range(2)
        )
        self._deadline_s, self._encode_s = settings.deadline_s, settings.encode_s
        self._is_paced, self._is_repaired = settings.is_paced, settings.is_repaired
        self._is_encoding = False
        self._backlog: deque[Packet] = deque()
        self._round_trip_s = 2.0 * link.delay_s
        self._most = link.queue.packets
        self._queue = link_queue(simulator, link.open(rng), link.queue, self._on_outcome, self._send)

    def enqueue(self, unit: int) -> None:
        """Queue a unit for the encoder, which can begin with it now."""
        self.waiting.append(self._queue.waiting())
        self._unencoded.put(unit)
        self._encode()

    def _encode(self) -> None:
        if self._is_encoding or (unit := self._unencoded.take(self._simulator.now_s)) is None:
            return
        self._is_encoding = True
        if self._encoder is not None:
            rate = self._throughput.bytes_per_s(self._simulator.now_s)
            budget_bytes = None if rate is None else FILL * rate * self._interval_s
            self.units[unit] = self._encoder.encode(self._frames[unit], budget_bytes, self._waiting_bytes())
        self._simulator.at(self._simulator.now_s + self._encode_s, lambda: self._end_encoding(unit))

    def _waiting_bytes(self) -> int:
        """Return the size of all that is coded and not sent yet."""
        coded = sum(self.units[unit].size_bytes for unit in self._encoded)
        return coded + sum(packet.size_bytes for packet in self._backlog) + self._queue.waiting_bytes()

    def _end_encoding(self, unit: int) -> None:
        self._is_encoding = False
        self._encoded.put(unit)
        self._send()
        self._encode()

    def _send(self) -> None:
        """Move packets to the link's queue as far as the policy allows now."""
        while True:
            self._hand_over()
            at_once = self._settings.queue_policy == "fifo"
            if not at_once and (self._backlog or not self._queue.is_idle):
                return
            unit = self._encoded.take(self._simulator.now_s)
            if unit is None:
                return
            packets, needed = packets_of(unit, self.units[unit].size_bytes, self._settings)
            self.shipments[unit] = Shipment(needed, len(packets))
            self._backlog.extend(packets)

    def _hand_over(self) -> None:
        room = len(self._backlog)
        if self._is_paced and self._most is not None:
            room = min(room, self._most - self._queue.waiting() + self._queue.is_idle)
        for _ in range(room):
            packet = self._backlog.popleft()
            packet.tries += 1
            self.shipments[packet.unit].sent_bytes += packet.size_bytes
            self._queue.push(packet)
        self.counts.sent += room

    def _on_outcome(self, packet: Packet, passage: Passage | None) -> None:
        if passage is not None and self._encoder is not None:
            self._throughput.add(packet.size_bytes, self._simulator.now_s, passage.sent_s)
        if passage is not None and passage.arrives_s is not None:
            self.counts.arrived += 1
            self.shipments[packet.unit].arrivals.append((passage.arrives_s, packet.number))
            self.counts.late += passage.arrives_s - self._captured_s[packet.unit] > self._deadline_s
            return
        if passage is None:
            self.counts.dropped += 1
        else:
            self.counts.lost += 1
        if self._is_repaired:
            left_s = self._simulator.now_s if passage is None else passage.sent_s
            self._simulator.at(left_s + self._round_trip_s, lambda: self._send_again(packet))

    def _send_again(self, packet: Packet) -> None:
        """Retransmit a packet that the sender learns is lost; `arq` gives up once its frame is past the deadline."""
        age_s = self._simulator.now_s - self._captured_s[packet.unit]
        is_useless = self._settings.transport == "arq" and age_s > self._deadline_s
        if packet.tries < MOST_TRIES and not is_useless:
            self._backlog.appendleft(packet)
            self._send()
