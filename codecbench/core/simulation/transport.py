"""A coded picture as packets, and when enough of them are there."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from codecbench.core.simulation.link_queue import Packet
from codecbench.core.simulation.settings import LinkSettings


@dataclass
class PacketCounts:
    """What became of packets, by number: each that was sent has arrived, was lost on the way, or was dropped by the
    link's queue. Of those that arrived some were late."""

    sent: int = 0
    arrived: int = 0
    late: int = 0
    lost: int = 0
    dropped: int = 0


@dataclass
class Shipment:
    """A unit on its way. needed: how many of its packets make it whole; count: how many there are, of which the first
    `needed` are its data. sent_bytes: with headers, redundancy and what went again. arrivals: of the packets that
    came, when and which."""

    needed: int
    count: int
    sent_bytes: int = 0
    arrivals: list[tuple[float, int]] = field(default_factory=list)

    @property
    def complete_s(self) -> float:
        """When it can be decoded; infinite where it never can."""
        if len(self.arrivals) < self.needed:
            return math.inf
        return sorted(self.arrivals)[self.needed - 1][0]


def packets_of(unit: int, size_bytes: int, settings: LinkSettings) -> tuple[list[Packet], int]:
    """The packets of a unit and how many of them make it whole.

    Redundancy is that of an ideal erasure code, of which any as many packets do as there are of data; Reed-Solomon
    codes are of this kind.
    """
    payload = settings.payload_bytes
    count = max(1, -(-size_bytes // payload))
    sizes = [settings.mtu] * (count - 1) + [size_bytes - (count - 1) * payload + settings.header_bytes]
    if settings.transport == "fec":
        sizes += [sizes[0]] * math.ceil(count * settings.fec_share)
    return [Packet(unit, size, number) for number, size in enumerate(sizes)], count
