"""Where pictures wait for the encoder, or encoded ones for the link."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence

from codecbench.core.simulation.settings import QueuePolicy


class WaitingRoom:
    """Units, by number, that wait; which of them are given up is the policy's to say.

    latest_only: a new one takes the place of whatever waits. drop_late: those older than `deadline_s` when their turn
    comes are passed over. fifo: none.
    """

    def __init__(self, policy: QueuePolicy, captured_s: Sequence[float], deadline_s: float) -> None:
        self._policy, self._captured_s, self._deadline_s = policy, captured_s, deadline_s
        self._waiting: deque[int] = deque()

    def __iter__(self) -> Iterator[int]:
        return iter(self._waiting)

    def put(self, unit: int) -> None:
        """One more waits."""
        if self._policy == "latest_only":
            self._waiting.clear()
        self._waiting.append(unit)

    def take(self, now_s: float) -> int | None:
        """The one whose turn it is; None where nothing waits that is worth it."""
        while self._waiting:
            unit = self._waiting.popleft()
            if self._policy != "drop_late" or now_s - self._captured_s[unit] <= self._deadline_s:
                return unit
        return None
