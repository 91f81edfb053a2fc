"""What a call takes, by the clock on the wall and by the processor's."""

from __future__ import annotations

import gc
import math
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final

_MAX_LOOPS: Final = 1000
_YARDSTICK: Final = bytes((index * index >> 5) & 255 for index in range(1 << 16))


@dataclass(frozen=True)
class Duration:
    """What one call takes, in milliseconds: by the clock on the wall and of this process's processor time."""

    wall_ms: float
    cpu_ms: float

    def __add__(self, other: Duration) -> Duration:
        return Duration(self.wall_ms + other.wall_ms, self.cpu_ms + other.cpu_ms)


def yardstick() -> Duration:
    """Time of deflating a fixed 64 KiB: work that no codec changes, so that runs at different times, on a machine
    that is busier or clocked lower, can be compared in units of it."""
    return duration(lambda: zlib.compress(_YARDSTICK, 6), 0.0)


def duration(call: Callable[[], object], min_ms: float) -> Duration:
    """Time of one call: of a single one if it takes `min_ms`, else the mean over as many as take that long."""
    first = timed(call, 1)
    if first.wall_ms >= min_ms:
        return first
    loops = min(_MAX_LOOPS, math.ceil(min_ms / max(first.wall_ms, 1e-6)))
    return timed(call, loops)


def timed(call: Callable[[], object], loops: int = 1) -> Duration:
    """Mean time of a call over as many as `loops`."""
    turns = range(loops)
    cpu_start_ns, wall_start_ns = time.process_time_ns(), time.perf_counter_ns()
    for _ in turns:
        call()
    wall_end_ns, cpu_end_ns = time.perf_counter_ns(), time.process_time_ns()
    return Duration((wall_end_ns - wall_start_ns) / loops * 1e-6, (cpu_end_ns - cpu_start_ns) / loops * 1e-6)


@contextmanager
def no_collection() -> Iterator[None]:
    """Collect garbage now and not meanwhile."""
    enabled = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()
