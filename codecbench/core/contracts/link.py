"""The link contract: when packets arrive at the receiver, or that they are lost, in simulated time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from codecbench.core.contracts.params import Configured, P

Discipline = Literal["drop_tail", "codel"]


class Passage(NamedTuple):
    """Transmission of one packet over the link."""

    sent_s: float
    """Time in seconds at which its last byte has left, so that the next packet may go."""
    arrives_s: float | None
    """Time in seconds at which it arrives; None if it is lost."""


@dataclass(frozen=True)
class Queue:
    """Properties of the queue before the link, which the simulation runs."""

    packets: int | None = None
    """How many packets may wait, besides the one being sent; None for any number."""
    discipline: Discipline = "drop_tail"
    """`drop_tail` drops arrivals if the queue is full; `codel` also drops overdue packets from its head (RFC 8289)."""

    def __post_init__(self) -> None:
        if self.packets is not None and self.packets < 1:
            raise ValueError(f"a queue of {self.packets} packets has no room; give 1 or more, or None")


class Channel(ABC):
    """The state of a link in operation, from time 0 on."""

    @abstractmethod
    def carry(self, size_bytes: int, start_s: float) -> Passage:
        """Transmit a packet that starts at `start_s`; return when it has left and when it arrives.

        Packets come one after another: `start_s` is never before the last one's `sent_s`. Return a `sent_s` of at least
        `start_s`, and an `arrives_s` of at least `sent_s` plus the link's delay.
        """


class Link(Configured[P]):
    """A link from a sender to a receiver; an instance is one setting of it."""

    @property
    def delay_s(self) -> float:
        """Least propagation delay in seconds; the receiver's feedback takes as long."""
        return 0.0

    @property
    def keeps_order(self) -> bool:
        """Whether packets arrive in the order in which they left."""
        return True

    @property
    def queue(self) -> Queue:
        """The queue in which packets wait for this link."""
        return Queue()

    @abstractmethod
    def open(self, rng: np.random.Generator) -> Channel:
        """Put the link into operation. Draw all randomness from `rng`, so that equal generators give equal results.

        Draw events in time, such as fades, apart from the loss of single packets, by `rng.spawn`: codecs that send
        other packets then meet the same fades.
        """
