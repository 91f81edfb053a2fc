"""What a call takes, by the clock on the wall and by the processor's."""

from __future__ import annotations

import gc
import math
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final, TypeVar

_T = TypeVar("_T")
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
    return timed(lambda: zlib.compress(_YARDSTICK, 6))[1]


def repeated(call: Callable[[], _T], min_ms: float) -> tuple[_T, Duration]:
    """What a call returns, and its time: of this single call if it takes `min_ms`, else the mean over as many more as
    take that long."""
    value, first = timed(call)
    if first.wall_ms >= min_ms:
        return value, first
    return timed(call, min(_MAX_LOOPS, math.ceil(min_ms / max(first.wall_ms, 1e-6))))


def timed(call: Callable[[], _T], loops: int = 1) -> tuple[_T, Duration]:
    """What the last of `loops` calls returns, and the mean time of one."""
    turns = range(loops - 1)
    cpu_start_ns, wall_start_ns = time.process_time_ns(), time.perf_counter_ns()
    for _ in turns:
        call()
    value = call()
    wall_end_ns, cpu_end_ns = time.perf_counter_ns(), time.process_time_ns()
    return value, Duration((wall_end_ns - wall_start_ns) / loops * 1e-6, (cpu_end_ns - cpu_start_ns) / loops * 1e-6)


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
