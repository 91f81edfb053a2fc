"""A codec's baseline: sizes, PSNRs, operation counts and relative times in a file under version control.

Sizes, PSNRs and counts are exact on any machine. Times are in units of a yardstick, a fixed piece of work that
alternates with the codec, so that load or a lower clock slows both. They are valid for one model of processor.
"""

from __future__ import annotations

import json
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, overload

import numpy as np

from codecbench.core.engine.storage.atomic import write_file
from codecbench.core.engine.storage.environment import describe_machine
from codecbench.plugins.evaluators.timed_calls import time_repeatedly, yardstick

_EXACT: Final = ("version", "size_bytes", "psnr_db", "encode_operations", "decode_operations")
_ROUNDING_DB: Final = 1e-9
"""How much two computations of the same PSNR may differ."""
_LEAST_PAIRS: Final = 40
_MOST_S: Final = 8.0
_SAME_SPEED: Final = 0.1
"""How far the yardstick may be from its time in the baseline for a pair to count. Beyond it, other processes share the
core's caches and units differently, which slows different work by different factors."""
_ATTEMPTS: Final = 3
"""Number of series of pairs; a slowdown must show in each."""


class Baseline:
    """The baseline file at `path`. `save` adds what it lacks. Without a path nothing is compared."""

    def __init__(self, path: Path | None, slower_percent: float, processor: str) -> None:
        self._path = path
        self._slower_percent = slower_percent
        self._processor = processor
        self._known: dict[str, dict[str, Any]] = {}
        self._added: dict[str, dict[str, Any]] = {}
        if path is not None and path.exists():
            self._known = json.loads(path.read_text())

    def complaint(self, facts: dict[str, Any]) -> str:
        """Describe how a setting is worse than its baseline: larger, less PSNR, more operations. Empty if it is not."""
        name, before = facts["codec"], self._known.get(facts["codec"])
        if before is None:
            self._added.setdefault(name, {}).update({key: facts[key] for key in _EXACT if key in facts})
            return ""
        if facts["size_bytes"] > before["size_bytes"]:
            return f"{name}: {facts['size_bytes']} bytes; the baseline has {before['size_bytes']}"
        if facts["psnr_db"] < before["psnr_db"] - _ROUNDING_DB:
            return f"{name}: PSNR {facts['psnr_db']} dB; the baseline has {before['psnr_db']} dB"
        for key in ("encode_operations", "decode_operations"):
            if facts.get(key, 0) > before.get(key, np.inf):
                more = 100.0 * (facts[key] / before[key] - 1.0)
                count = f"{facts[key]:,} {key.replace('_', ' ')}"
                return f"{name}: {count}, {more:.1f} % more than the baseline's {before[key]:,}"
        return ""

    def time_complaint(self, name: str, direction: str, call: Callable[[], object]) -> str:
        """Describe how much slower a call is than its baseline, if every attempt shows it. Empty if not.

        Warns if no comparison is possible: the baseline is of another model of processor, or the machine's load differs
        from that of the baseline.
        """
        key = f"{direction}_time"
        before = self._known.get(name)
        if self._path is None or (before is not None and key not in before):
            return ""
        if before is None:
            trials = sorted((relative_time(call) for _ in range(_ATTEMPTS)), key=lambda trial: trial.yardsticks)
            self._added.setdefault(name, {})[key] = {"processor": self._processor, **vars(trials[_ATTEMPTS // 2])}
            return ""
        baseline = before[key]
        if baseline["processor"] != self._processor:
            warnings.warn(f"{name}: times not compared, the baseline is from {baseline['processor']}", stacklevel=2)
            return ""
        least = np.inf
        for _ in range(_ATTEMPTS):
            now = relative_time(call, baseline["yardstick_ms"])
            if now is None:
                warnings.warn(f"{name}: {direction} time is inconclusive: the machine's load differs from "
                              "that of the baseline", stacklevel=2)  # fmt: skip
                return ""
            least = min(least, now.yardsticks / baseline["yardsticks"])
            if least <= 1.0 + self._slower_percent / 100.0:
                return ""
        slower = 100.0 * (least - 1.0)
        return (
            f"{name}: {direction} takes {slower:.1f} % longer than the baseline; {self._slower_percent:g} % is allowed"
        )

    def save(self) -> None:
        """Write what was added. Raises OSError and leaves the file as it was if that fails."""
        if self._path is not None and self._added:
            write_file(self._path, (json.dumps({**self._known, **self._added}, indent=2) + "\n").encode())


def open_baseline(path: Path | None, slower_percent: float) -> Baseline:
    """Return the baseline at `path` for the processor of this machine."""
    return Baseline(path, slower_percent, str(describe_machine()["cpu"]))


@dataclass(frozen=True)
class RelativeTime:
    """Median processor time of a call in yardsticks, and of a yardstick in milliseconds."""

    yardsticks: float
    yardstick_ms: float


@overload
def relative_time(call: Callable[[], object]) -> RelativeTime: ...
@overload
def relative_time(call: Callable[[], object], yardstick_ms: float) -> RelativeTime | None: ...


def relative_time(call: Callable[[], object], yardstick_ms: float | None = None) -> RelativeTime | None:
    """Time a call and the yardstick in turn.

    With `yardstick_ms`, only pairs count whose yardstick takes about that long. Returns None if too few do.
    """
    call()
    ratios: list[float] = []
    beside: list[float] = []
    end_s = time.monotonic() + _MOST_S
    before = yardstick().cpu_ms
    while len(ratios) < _LEAST_PAIRS:
        if yardstick_ms is not None and time.monotonic() > end_s:
            return None
        call_ms = time_repeatedly(call, before)[1].cpu_ms
        after = yardstick().cpu_ms
        mean = (before + after) / 2.0
        if yardstick_ms is None or abs(mean - yardstick_ms) <= _SAME_SPEED * yardstick_ms:
            ratios.append(call_ms / mean)
            beside.append(mean)
        before = after
    return RelativeTime(float(np.median(ratios)), float(np.median(beside)))
