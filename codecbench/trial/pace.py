"""How fast this machine is now, beside the one on which typical costs were measured; a second tells it."""

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
"""What the yardstick takes where typical costs hold, with every worker at it."""
_LONG_S: Final = 0.7
_FRAMES: Final = 3


@dataclass(frozen=True)
class Pace:
    """slowness: how many times as long as usual work takes. reading_ms: of a frame, where work takes as long as usual.
    compiling_s: of kernels that the cache does not have, by one worker."""

    slowness: float
    reading_ms: float
    compiling_s: float = 0.0


def measured_pace(registry: Registry, recording: Recording) -> Pace:
    """The pace of this machine as busy as it is now."""
    name = recording.dataset
    reading_ms = float(registry.ask(_reading_ms, name, recording.params, of=[("dataset", name)], times=10))
    slow = _slowness(os.cpu_count() or 1)
    return Pace(slow, reading_ms / max(slow, 1.0))


def _slowness(workers: int) -> float:
    """How many times as long as usual work takes, with all workers at it and whatever else the machine does now."""

    def calls(end_s: float) -> int:
        done = 0
        while time.perf_counter() < end_s:
            yardstick()
            done += 1
        return done

    end_s = time.perf_counter() + _LONG_S
    with ThreadPoolExecutor(workers) as pool:  # deflating lets other threads run
        done = sum(pool.map(calls, [end_s] * workers))
    return _LONG_S * 1e3 * workers / max(done, 1) / _USUAL_MS


def _reading_ms(registry: Registry, name: str, params: dict[str, Any]) -> float:
    sequence = registry.create("dataset", name, params).open()
    taken = []
    for part in range(_FRAMES):
        with suppress(DatasetError):  # who runs the matrix is told
            taken.append(time_call(partial(sequence.read, len(sequence) * part // _FRAMES))[1].wall_ms)
    return median(taken or [0.0])
