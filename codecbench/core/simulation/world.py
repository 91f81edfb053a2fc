"""Simulated time: events in the order in which they are due, and no clock."""

from __future__ import annotations

import heapq
from collections.abc import Callable
from itertools import count


class World:
    """Where things happen at times, one after the other; those of one time in the order in which they were planned."""

    def __init__(self) -> None:
        self.now_s = 0.0
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._numbers = count()

    def at(self, time_s: float, action: Callable[[], None]) -> None:
        """Plan something. Raises ValueError for what is past: an effect before its cause."""
        if not time_s >= self.now_s:
            raise ValueError(f"planned for {time_s} s at {self.now_s} s; nothing happens in the past")
        heapq.heappush(self._events, (time_s, next(self._numbers), action))

    def run(self) -> None:
        """Let happen whatever is planned, and what is planned meanwhile."""
        while self._events:
            self.now_s, _, action = heapq.heappop(self._events)
            action()
