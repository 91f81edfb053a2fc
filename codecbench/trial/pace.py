"""The speed of this machine now, relative to the one on which typical costs were measured; takes a second."""

from __future__ import annotations

import os
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from statistics import median
from typing import Any, Final

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.engine.plugins.registry import Registry
from codecbench.plugins.evaluators.timed_calls import time_call, yardstick
from codecbench.trial.recording import Recording

_USUAL_MS: Final = 0.7
"""Time of the yardstick on the machine of the typical costs, with all workers busy."""
_DURATION_S: Final = 0.7
_FRAMES: Final = 3


@dataclass(frozen=True)
class Pace:
    """The speed of a machine."""

    slowness: float
    """How many times as long as typical work takes."""
    reading_ms: float
    """Time to read a frame at slowness 1."""
    compiling_s: float = 0.0
    """Time in which one worker compiles the kernels that the cache lacks."""


def measure_pace(registry: Registry, recording: Recording) -> Pace:
    """Measure the pace of this machine, as busy as it is now."""
    name = recording.dataset
    reading_ms = float(registry.ask(_reading_ms, name, recording.params, of=[("dataset", name)], times=10))
    slow = _slowness(os.cpu_count() or 1)
    return Pace(slow, reading_ms / max(slow, 1.0))


def _slowness(workers: int) -> float:
    """Measure how many times as long as typical work takes with all workers busy and the present load."""

    def calls(end_s: float) -> int:
        count = 0
        while time.perf_counter() < end_s:
            yardstick()
            count += 1
        return count

    end_s = time.perf_counter() + _DURATION_S
    with ThreadPoolExecutor(workers) as pool:  # deflating releases the interpreter lock
        done = sum(pool.map(calls, [end_s] * workers))
    return _DURATION_S * 1e3 * workers / max(done, 1) / _USUAL_MS


def _reading_ms(registry: Registry, name: str, params: dict[str, Any]) -> float:
    sequence = registry.create("dataset", name, params).open()
    times_ms = []
    for part in range(_FRAMES):
        with suppress(DatasetError):  # the run of the matrix reports it
            times_ms.append(time_call(partial(sequence.read, len(sequence) * part // _FRAMES))[1].wall_ms)
    return median(times_ms or [0.0])
