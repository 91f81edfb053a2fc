"""How far a run is and how long the rest will take."""

from __future__ import annotations

import math
import time
from collections import Counter, defaultdict
from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from codecbench.core.engine.planning.estimate import START_S, TYPICAL_CELL_S, TYPICAL_CODING_MS
from codecbench.core.engine.planning.model import Cell, CodingJob
from codecbench.core.engine.running.schedule import Work
from codecbench.core.engine.storage.record import Record


@dataclass(frozen=True)
class Progress:
    """A moment of a run.

    Cells and jobs that an earlier run left are in `cells_kept` and nowhere else. remaining_s: an estimate, None before
    the first job or cell has ended. compiling: how many kernels are compiled ahead so far, in words,
    empty when they all are. notice: something that its user has to know. cell and record: what just ended, None for a
    coding job. measured: its headlines in words, see `measured_words`.
    """

    cells_total: int
    cells_done: int
    cells_kept: int
    jobs_total: int
    jobs_done: int
    not_ok: int
    elapsed_s: float
    remaining_s: float | None
    compiling: str = ""
    notice: str = ""
    cell: Cell | None = None
    record: Record | None = None
    measured: str = ""

    @property
    def share(self) -> float | None:
        """How much of the work is done, 0 to 1; None before the first job or cell has ended."""
        if self.remaining_s is None:
            return None
        return self.elapsed_s / (self.elapsed_s + self.remaining_s) if self.remaining_s else 1.0


def headline_words(cell: Cell, record: Record, declared: Mapping[str, Any]) -> str:
    """The headlines of a cell, such as `jpeg quality=30: PSNR 30.3 dB, SSIM 0.88`; empty where it has none.

    declared: as of a `Plan`.
    """
    values = []
    for metric in declared.get("evaluators", {}).get(cell.evaluator.title, {}).get("metrics", ()):
        value = record.summaries.get((metric["name"], "", metric["aggregates"][0]), math.nan)
        if metric["headline"] and math.isfinite(value):
            unit = "" if metric["display_unit"] in ("", "1") else f" {metric['display_unit']}"
            values.append(f"{metric['label']} {value * metric['display_factor']:.3g}{unit}")
    setting = " ".join(filter(None, (cell.codec.name, cell.codec.label)))
    return f"{setting}: {', '.join(values)}" if values else ""


@dataclass
class _Spent:
    """Seconds that work of a kind took, and how many frames its sequences had."""

    seconds: float = 0.0
    frames: int = 0

    def add(self, seconds: float, frames: int) -> None:
        self.seconds += seconds
        self.frames += frames

    @property
    def per_frame_s(self) -> float:
        return self.seconds / self.frames


class Pace:
    """Estimates the time that is left from frames and from what a frame of each kind of work took so far.

    A kind is an evaluator's setting, or encoding, under one codec: a slow codec says nothing of a fast one. Of a kind
    that has not been seen yet the estimate is that of the same evaluator under other codecs; of an evaluator that has
    not, what it declares as typical, in proportion to how the others did beside what they declare. An evaluator that
    declares nothing is taken, until it is seen, to look at a few frames of a sequence, as `estimate` takes it.

    The first work of a task in a worker takes up to START_S longer: of what it took, what was expected is kept, as far
    as that can be. So short runs are not taken for long ones, and long ones are hardly changed.
    """

    def __init__(self, workers: int, typical_ms: Mapping[str, float] | None = None) -> None:
        """typical_ms: milliseconds a frame, by the title of an evaluator's setting, where it declares them."""
        self._workers = workers
        self._typical_s = {title: ms / 1000 for title, ms in (typical_ms or {}).items() if ms > 0}
        self._guessed_s: dict[str, float] = {_ENCODING: TYPICAL_CODING_MS / 1000}
        self._begun_by: set[tuple[Hashable, str]] = set()
        self._begun = time.monotonic()
        self._left: Counter[_Kind] = Counter()
        self._spent: dict[_Kind, _Spent] = defaultdict(_Spent)
        self._of_task: dict[str, _Spent] = defaultdict(_Spent)
        self._alone: set[_Kind] = set()

    def expect(self, jobs: list[CodingJob], cells: list[Cell]) -> None:
        """There are jobs and cells to be done."""
        self._alone |= {_kind(cell) for cell in cells if cell.exclusive}
        everything: list[Work] = [*jobs, *cells]
        for work in everything:
            self._left[_kind(work)] += work.sequence.frames
        for cell in cells:
            self._guessed_s.setdefault(cell.evaluator.title, TYPICAL_CELL_S / max(cell.sequence.frames, 1))

    @property
    def elapsed_s(self) -> float:
        return time.monotonic() - self._begun

    def ended(self, work: Work, duration_s: float | None = None, worker: Hashable = None) -> None:
        """A job or cell has ended; `duration_s` is None where it was never computed, `worker` where it is not known."""
        kind, frames = _kind(work), work.sequence.frames
        self._left[kind] -= frames
        if duration_s is None or not frames:
            return
        if worker is not None and (worker, kind[0]) not in self._begun_by:
            self._begun_by.add((worker, kind[0]))
            duration_s = min(duration_s, max(duration_s - START_S, self._per_frame_s(kind) * frames))
        self._spent[kind].add(duration_s, frames)
        self._of_task[kind[0]].add(duration_s, frames)

    def remaining_s(self) -> float | None:
        """Seconds to the end."""
        if not self._of_task:
            return None
        return sum(
            frames * self._per_frame_s(kind) / (1 if kind in self._alone else self._workers)
            for kind, frames in self._left.items()
            if frames
        )

    def _per_frame_s(self, kind: _Kind) -> float:
        if kind in self._spent:
            return self._spent[kind].per_frame_s
        if kind[0] in self._of_task:
            return self._of_task[kind[0]].per_frame_s
        known = {task: spent for task, spent in self._of_task.items() if task in self._typical_s}
        if kind[0] in self._typical_s and known:
            declared = sum(self._typical_s[task] * spent.frames for task, spent in known.items())
            return self._typical_s[kind[0]] * sum(spent.seconds for spent in known.values()) / declared
        if kind[0] in self._typical_s:
            return self._typical_s[kind[0]]
        return self._guessed_s[kind[0]]


_Kind = tuple[str, str]
"""The title of an evaluator's setting, or what encoding is called here, and a codec."""

_ENCODING: Final = "encoding, which is no evaluator"


def _kind(work: Work) -> _Kind:
    return (_ENCODING if isinstance(work, CodingJob) else work.evaluator.title), work.codec.name


@dataclass(frozen=True)
class RunSummary:
    """How a run ended.

    statuses: how many cells of the plan have which status now. computed: cells computed by this run. kept:
    cells that an earlier run had computed. encoded: coding jobs done. interrupted: the signal that ended the
    run early, or None. damaged: what was found damaged and why, by cell. notices: what was said of kept cells.
    """

    folder: Path
    statuses: dict[str, int]
    computed: int
    kept: int
    encoded: int
    interrupted: str | None = None
    damaged: dict[str, str] = field(default_factory=dict)
    notices: tuple[str, ...] = ()
