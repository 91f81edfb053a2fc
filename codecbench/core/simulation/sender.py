"""The sender: pictures wait for the encoder, encoded ones for the link, and lost packets go again."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from codecbench.core.contracts.evaluator import SentPacket
from codecbench.core.contracts.link import Link, Passage
from codecbench.core.simulation.adaptation import FILL, AdaptiveEncoder, Throughput
from codecbench.core.simulation.link_queue import Packet, link_queue
from codecbench.core.simulation.settings import LinkSettings
from codecbench.core.simulation.transport import PacketCounts, Shipment, packets_of
from codecbench.core.simulation.waiting_room import WaitingRoom
from codecbench.core.simulation.world import World

MOST_TRIES: Final = 1000
"""A packet that was lost so often is given up, whatever the transport promises."""


class Sender:
    """A device with a camera. Units are what the encoder gives, by number, in its order.

    units: those that were coded, as they became. shipments: of those that were sent. waiting: packets in the link's
    queue whenever a picture was taken.
    """

    def __init__(
        self,
        world: World,
        units: Sequence[SentPacket],
        captured_s: Sequence[float],
        link: Link[Any],
        settings: LinkSettings,
        rng: np.random.Generator,
        encoder: AdaptiveEncoder | None = None,
    ) -> None:
        """captured_s: of each unit's picture. encoder: codes the pictures anew, as the link asks."""
        self.units = dict(enumerate(units)) if encoder is None else {}
        self._encoder, self._throughput = encoder, Throughput()
        self._interval_s = float(np.median(np.diff(captured_s))) if len(captured_s) > 1 else 1.0
        self.shipments: dict[int, Shipment] = {}
        self.waiting: list[int] = []
        self.counts = PacketCounts()
        self._world, self._captured_s, self._settings = world, captured_s, settings
        self._frames = [unit.frame for unit in units]
        self._unencoded, self._encoded = (
            WaitingRoom(settings.queue_policy, captured_s, settings.deadline_s) for _ in range(2)
        )
        self._deadline_s, self._encode_s = settings.deadline_s, settings.encode_s
        self._is_paced, self._is_repaired = settings.is_paced, settings.is_repaired
        self._is_encoding = False
        self._backlog: deque[Packet] = deque()
        self._round_trip_s = 2.0 * link.delay_s
        self._most = link.queue.packets
        self._queue = link_queue(world, link.open(rng), link.queue, self._on_fate, self._send)

    def give(self, unit: int) -> None:
        """The encoder can begin with a unit now."""
        self.waiting.append(self._queue.waiting())
        self._unencoded.put(unit)
        self._encode()

    def _encode(self) -> None:
        if self._is_encoding or (unit := self._unencoded.take(self._world.now_s)) is None:
            return
        self._is_encoding = True
        if self._encoder is not None:
            rate = self._throughput.at(self._world.now_s)
            budget_bytes = None if rate is None else FILL * rate * self._interval_s
            self.units[unit] = self._encoder.encode(self._frames[unit], budget_bytes, self._waiting_bytes())
        self._world.at(self._world.now_s + self._encode_s, lambda: self._end_encoding(unit))

    def _waiting_bytes(self) -> int:
        """Of all that was coded and has not left yet."""
        coded = sum(self.units[unit].size_bytes for unit in self._encoded)
        return coded + sum(packet.size_bytes for packet in self._backlog) + self._queue.waiting_bytes()

    def _end_encoding(self, unit: int) -> None:
        self._is_encoding = False
        self._encoded.put(unit)
        self._send()
        self._encode()

    def _send(self) -> None:
        """Hand over what the link is to have now."""
        while True:
            self._hand_over()
            at_once = self._settings.queue_policy == "fifo"
            if not at_once and (self._backlog or not self._queue.is_idle):
                return
            unit = self._encoded.take(self._world.now_s)
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

    def _on_fate(self, packet: Packet, passage: Passage | None) -> None:
        if passage is not None and self._encoder is not None:
            self._throughput.add(packet.size_bytes, self._world.now_s, passage.sent_s)
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
            left_s = self._world.now_s if passage is None else passage.sent_s
            self._world.at(left_s + self._round_trip_s, lambda: self._send_again(packet))

    def _send_again(self, packet: Packet) -> None:
        """The sender hears that a packet is missing. `arq` gives it up when its picture is too old to be of use."""
        age_s = self._world.now_s - self._captured_s[packet.unit]
        is_in_vain = self._settings.transport == "arq" and age_s > self._deadline_s
        if packet.tries < MOST_TRIES and not is_in_vain:
            self._backlog.appendleft(packet)
            self._send()
