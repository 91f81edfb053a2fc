"""How far a run is, how long the rest will take, and how it ended."""

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

    Cells and jobs from an earlier run count in `cells_kept` and nowhere else.
    """

    cells_total: int
    cells_done: int
    cells_kept: int
    jobs_total: int
    jobs_done: int
    not_ok: int
    elapsed_s: float
    remaining_s: float | None
    """Estimated seconds to the end; None before the first job or cell has ended."""
    compiling: str = ""
    """Progress of compiling kernels, in words; empty when all are compiled."""
    notice: str = ""
    """A message for the user."""
    cell: Cell | None = None
    """The cell that just ended; None for a coding job."""
    record: Record | None = None
    """The record of that cell."""
    measured: str = ""
    """Its primary metrics in words, see `headline_words`."""

    @property
    def share(self) -> float | None:
        """Fraction of the work that is done, 0 to 1; None before the first job or cell has ended."""
        if self.remaining_s is None:
            return None
        return self.elapsed_s / (self.elapsed_s + self.remaining_s) if self.remaining_s else 1.0


def headline_words(cell: Cell, record: Record, declared: Mapping[str, Any]) -> str:
    """Format the primary metrics of a cell, such as `jpeg quality=30: PSNR 30.3 dB, SSIM 0.88`; empty if it has none.

    declared: as in `Plan`.
    """
    parts = []
    for metric in declared.get("evaluators", {}).get(cell.evaluator.title, {}).get("metrics", ()):
        value = record.summaries.get((metric["name"], "", metric["aggregates"][0]), math.nan)
        if metric["headline"] and math.isfinite(value):
            unit = "" if metric["display_unit"] in ("", "1") else f" {metric['display_unit']}"
            parts.append(f"{metric['label']} {value * metric['display_factor']:.3g}{unit}")
    setting = " ".join(filter(None, (cell.codec.name, cell.codec.label)))
    return f"{setting}: {', '.join(parts)}" if parts else ""


@dataclass
class _TimeSpent:
    """Seconds spent on a kind of work, and the number of frames of its sequences."""

    seconds: float = 0.0
    frames: int = 0

    def add(self, seconds: float, frames: int) -> None:
        self.seconds += seconds
        self.frames += frames

    @property
    def per_frame_s(self) -> float:
        return self.seconds / self.frames


class Pace:
    """Estimates the remaining time from the number of frames and the measured time per frame of each kind of work.

    A kind is an evaluator's setting, or encoding, under one codec: a slow codec does not predict a fast one. The
    estimate of an unseen kind is that of the same evaluator under other codecs. For an unseen evaluator it is its
    declared typical cost, scaled by how the others compared with theirs. An evaluator without a declared cost is
    assumed to look at a few frames of a sequence, as in `estimate`.

    The first work of a task in a worker takes up to START_S longer, so that much above the expected time is not
    counted. Short runs are then not mistaken for long ones, and long ones hardly change.
    """

    def __init__(self, workers: int, typical_ms: Mapping[str, float] | None = None) -> None:
        """typical_ms: milliseconds per frame by evaluator title, for evaluators that declare them."""
        self._workers = workers
        self._typical_s = {title: ms / 1000 for title, ms in (typical_ms or {}).items() if ms > 0}
        self._guessed_s: dict[str, float] = {_ENCODING: TYPICAL_CODING_MS / 1000}
        self._begun_by: set[tuple[Hashable, str]] = set()
        self._begun = time.monotonic()
        self._left: Counter[_Kind] = Counter()
        self._spent: dict[_Kind, _TimeSpent] = defaultdict(_TimeSpent)
        self._of_task: dict[str, _TimeSpent] = defaultdict(_TimeSpent)
        self._alone: set[_Kind] = set()

    def expect(self, jobs: list[CodingJob], cells: list[Cell]) -> None:
        """Add jobs and cells to the remaining work."""
        self._alone |= {_kind(cell) for cell in cells if cell.exclusive}
        all_work: list[Work] = [*jobs, *cells]
        for work in all_work:
            self._left[_kind(work)] += work.sequence.frames
        for cell in cells:
            self._guessed_s.setdefault(cell.evaluator.title, TYPICAL_CELL_S / max(cell.sequence.frames, 1))

    @property
    def elapsed_s(self) -> float:
        return time.monotonic() - self._begun

    def finish(self, work: Work, duration_s: float | None = None, worker: Hashable = None) -> None:
        """Note the end of a job or cell. `duration_s` is None if it was never computed, `worker` if it is unknown."""
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
        """Return the estimated seconds to the end."""
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
        declared_tasks = {task: spent for task, spent in self._of_task.items() if task in self._typical_s}
        if kind[0] in self._typical_s and declared_tasks:
            declared = sum(self._typical_s[task] * spent.frames for task, spent in declared_tasks.items())
            return self._typical_s[kind[0]] * sum(spent.seconds for spent in declared_tasks.values()) / declared
        if kind[0] in self._typical_s:
            return self._typical_s[kind[0]]
        return self._guessed_s[kind[0]]


_Kind = tuple[str, str]
"""Evaluator title, or `_ENCODING`, and codec name."""

_ENCODING: Final = "encoding, which is no evaluator"


def _kind(work: Work) -> _Kind:
    return (_ENCODING if isinstance(work, CodingJob) else work.evaluator.title), work.codec.name


@dataclass(frozen=True)
class RunSummary:
    """How a run ended."""

    folder: Path
    statuses: dict[str, int]
    """Number of cells of the plan by status."""
    computed: int
    """Number of cells computed by this run."""
    kept: int
    """Number of cells computed by an earlier run."""
    encoded: int
    """Number of coding jobs done."""
    interrupted: str | None = None
    """The signal that ended the run early, or None."""
    damaged: dict[str, str] = field(default_factory=dict)
    """Why data of a cell was found damaged, by cell."""
    notices: tuple[str, ...] = ()
    """Messages about kept cells."""
