"""A clock that a test holds: no time passes but what is said to pass, however busy the machine is."""

from __future__ import annotations

import pytest

from codecbench.plugins.evaluators import timed_calls


class HeldClock:
    """Stands for the module `time` where calls are timed."""

    def __init__(self) -> None:
        self.wall_ns = self.cpu_ns = 0

    def sleep(self, seconds: float) -> None:
        self.wall_ns += round(seconds * 1e9)

    def compute(self, seconds: float) -> None:
        self.sleep(seconds)
        self.cpu_ns += round(seconds * 1e9)

    def perf_counter_ns(self) -> int:
        return self.wall_ns

    def process_time_ns(self) -> int:
        return self.cpu_ns


CLOCK = HeldClock()


@pytest.fixture
def held_clock(monkeypatch: pytest.MonkeyPatch) -> HeldClock:
    """CLOCK, by which calls are timed during this test."""
    monkeypatch.setattr(timed_calls, "time", CLOCK)
    return CLOCK
