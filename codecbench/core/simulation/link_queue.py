"""Discrete-event simulation of the packet queue before a link, with the disciplines drop-tail and CoDel."""

from __future__ import annotations

import heapq
import math
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from itertools import count
from typing import Any, Final

from codecbench.core.contracts.errors import PluginError
from codecbench.core.contracts.link import Channel, Passage, Queue

TARGET_S: Final = 0.005
INTERVAL_S: Final = 0.1
"""CoDel's target and interval: RFC 8289, sections 4.2 and 4.3."""
_RESUME_INTERVALS: Final = 16
"""Intervals within which a return to dropping resumes the last drop rate; RFC 8289, section 5.5."""


class EventSimulator:
    """Runs actions in order of their times; those of equal times in the order in which they were scheduled."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._numbers = count()

    def at(self, time_s: float, action: Callable[[], None]) -> None:
        """Schedule an action. Raises ValueError if the time is past: an effect before its cause."""
        if not time_s >= self.now_s:
            raise ValueError(f"an event at {time_s} s was scheduled at {self.now_s} s, after its time")
        heapq.heappush(self._events, (time_s, next(self._numbers), action))

    def run(self) -> None:
        """Run all scheduled actions, and those scheduled meanwhile."""
        while self._events:
            self.now_s, _, action = heapq.heappop(self._events)
            action()


@dataclass(slots=True, eq=False)
class Packet:
    """A packet of a unit."""

    unit: int
    """Number of its unit."""
    size_bytes: int
    """Size with headers."""
    number: int = 0
    """Number among the unit's packets."""
    tries: int = 0
    """How often it has been sent."""


OnOutcome = Callable[[Packet, Passage | None], None]
"""Called once for each pushed packet, with its passage, or None if it was dropped."""


class LinkQueue(ABC):
    """The packet queue before a link."""

    def __init__(
        self,
        simulator: EventSimulator,
        channel: Channel,
        most: int | None,
        on_outcome: OnOutcome,
        on_idle: Callable[[], None],
    ) -> None:
        """most: how many packets may wait; None for any number. on_idle: called whenever the last packet has left."""
        self._simulator, self._channel, self._on_outcome, self._on_idle = simulator, channel, on_outcome, on_idle
        self._most = math.inf if most is None else most
        self._free_s = 0.0

    @abstractmethod
    def push(self, packet: Packet) -> None:
        """Add a packet now."""

    @abstractmethod
    def waiting(self) -> int:
        """Return how many packets wait now."""

    @abstractmethod
    def waiting_bytes(self) -> int:
        """Return the total size of the packets that wait now."""

    @property
    @abstractmethod
    def is_idle(self) -> bool:
        """Whether no packet is being sent or waits."""

    def _carry(self, packet: Packet, start_s: float) -> Passage:
        passage = self._channel.carry(packet.size_bytes, start_s)
        if not start_s <= passage.sent_s < math.inf or not (
            passage.arrives_s is None or passage.sent_s <= passage.arrives_s < math.inf
        ):
            raise PluginError(f"{type(self._channel).__name__}: a packet sent from {start_s} s got {passage}")
        self._free_s = passage.sent_s
        return passage


class DropTailQueue(LinkQueue):
    """Drops packets that arrive when the queue is full.

    Later packets do not affect those that wait, so a packet's outcome is known when it arrives.
    """

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._starts: deque[tuple[float, int]] = deque()
        self._idle_is_scheduled = False

    def push(self, packet: Packet) -> None:
        now_s = self._simulator.now_s
        if self._free_s > now_s:
            if self.waiting() >= self._most:
                self._on_outcome(packet, None)
                return
            start_s = self._free_s
            self._starts.append((start_s, packet.size_bytes))
        else:
            start_s = now_s
        passage = self._carry(packet, start_s)
        if not self._idle_is_scheduled:
            self._idle_is_scheduled = True
            self._simulator.at(self._free_s, self._idle)
        self._on_outcome(packet, passage)

    def waiting(self) -> int:
        now_s, starts = self._simulator.now_s, self._starts
        while starts and starts[0][0] <= now_s:
            starts.popleft()
        return len(starts)

    def waiting_bytes(self) -> int:
        self.waiting()  # removes those that have left
        return sum(size_bytes for _, size_bytes in self._starts)

    @property
    def is_idle(self) -> bool:
        return self._free_s <= self._simulator.now_s

    def _idle(self) -> None:
        if self._free_s > self._simulator.now_s:
            self._simulator.at(self._free_s, self._idle)
        else:
            self._idle_is_scheduled = False
            self._on_idle()


class CoDelQueue(LinkQueue):
    """Drops packets from the head, ever more often, while they wait longer than a target: RFC 8289, section 5."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._packets: deque[tuple[Packet, float]] = deque()
        self._bytes = self._largest = 0
        self._is_sending = self._is_dropping = False
        self._above_until_s: float | None = None
        self._next_drop_s = 0.0
        self._drops = self._drops_before = 0

    def push(self, packet: Packet) -> None:
        if len(self._packets) >= self._most:
            self._on_outcome(packet, None)
            return
        self._packets.append((packet, self._simulator.now_s))
        self._bytes += packet.size_bytes
        self._largest = max(self._largest, packet.size_bytes)
        if not self._is_sending:
            self._serve()

    def waiting(self) -> int:
        return len(self._packets)

    def waiting_bytes(self) -> int:
        return self._bytes

    @property
    def is_idle(self) -> bool:
        return not self._is_sending

    def _serve(self) -> None:
        """Send the next packet that is not dropped, and schedule the next call for when it has left."""
        packet = self._next()
        self._is_sending = packet is not None
        if packet is None:
            self._on_idle()
            return
        passage = self._carry(packet, self._simulator.now_s)
        self._simulator.at(self._free_s, self._serve)
        self._on_outcome(packet, passage)

    def _next(self) -> Packet | None:
        now_s = self._simulator.now_s
        packet, is_old = self._head()
        if self._is_dropping:
            self._is_dropping = is_old
            while self._is_dropping and now_s >= self._next_drop_s:
                self._drop(packet)
                self._drops += 1
                packet, is_old = self._head()
                self._is_dropping = is_old
                if is_old:
                    self._next_drop_s = self._control_law(self._next_drop_s)
        elif is_old:
            self._drop(packet)
            packet, _ = self._head()
            self._is_dropping = True
            more = self._drops - self._drops_before
            resumes = more > 1 and now_s - self._next_drop_s < _RESUME_INTERVALS * INTERVAL_S
            self._drops = self._drops_before = more if resumes else 1
            self._next_drop_s = self._control_law(now_s)
        return packet

    def _head(self) -> tuple[Packet | None, bool]:
        """Remove the packet at the head; return it, and whether delay has been above target for an interval."""
        if not self._packets:
            self._above_until_s = None
            return None, False
        packet, entered_s = self._packets.popleft()
        self._bytes -= packet.size_bytes
        now_s = self._simulator.now_s
        if now_s - entered_s < TARGET_S or self._bytes <= self._largest:
            self._above_until_s = None
            return packet, False
        if self._above_until_s is None:
            self._above_until_s = now_s + INTERVAL_S
        return packet, now_s >= self._above_until_s

    def _drop(self, packet: Packet | None) -> None:
        assert packet is not None
        self._on_outcome(packet, None)

    def _control_law(self, time_s: float) -> float:
        return time_s + INTERVAL_S / math.sqrt(self._drops)


def link_queue(
    simulator: EventSimulator, channel: Channel, queue: Queue, on_outcome: OnOutcome, on_idle: Callable[[], None]
) -> LinkQueue:
    """Create the queue that a link declares."""
    kind = CoDelQueue if queue.discipline == "codel" else DropTailQueue
    return kind(simulator, channel, queue.packets, on_outcome, on_idle)
