"""The link contract: what becomes of packets between a sender and a receiver, in simulated time."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from codecbench.core.contracts.params import Configured, P

Discipline = Literal["drop_tail", "codel"]


class Passage(NamedTuple):
    """What becomes of a packet whose turn it is.

    sent_s: when its last byte has left, so that the next packet may go. arrives_s: when it is at the other end; None
    where it is lost on the way.
    """

    sent_s: float
    arrives_s: float | None


@dataclass(frozen=True)
class Queue:
    """Where packets wait for their turn; the simulation keeps it, a link says what it is like.

    packets: how many may wait, besides the one that is being sent; None for any number. discipline: `drop_tail` drops
    what finds no room; `codel` drops, besides, from the head what has waited for too long (RFC 8289).
    """

    packets: int | None = None
    discipline: Discipline = "drop_tail"

    def __post_init__(self) -> None:
        if self.packets is not None and self.packets < 1:
            raise ValueError(f"a queue of {self.packets} packets holds nothing; give 1 or more, or None")


class Channel(ABC):
    """A link at work, from time 0 on."""

    @abstractmethod
    def carry(self, size_bytes: int, start_s: float) -> Passage:
        """What becomes of a packet whose turn it is at `start_s`.

        Packets come one after the other: `start_s` is never before the last one's `sent_s`. Neither is the answer's
        `sent_s` before `start_s`, nor `arrives_s` before `sent_s` and the link's delay.
        """


class Link(Configured[P]):
    """A way for packets from a sender to a receiver; an instance is one setting of it."""

    @property
    def delay_s(self) -> float:
        """The least time from leaving to arriving; what the receiver answers takes as long."""
        return 0.0

    @property
    def keeps_order(self) -> bool:
        """Whether packets arrive in the order in which they left."""
        return True

    @property
    def queue(self) -> Queue:
        """Where packets wait for this link."""
        return Queue()

    @abstractmethod
    def open(self, rng: np.random.Generator) -> Channel:
        """The link at work. All chance is drawn from `rng`, so that an equal one gives equal answers.

        Draw what happens in time (a fade, say) apart from what happens to single packets, by `rng.spawn`: codecs that
        send other packets then meet the same fades.
        """
