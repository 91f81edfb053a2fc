"""How far a run is and how long the rest will take."""

from __future__ import annotations

import time
from collections import Counter, defaultdict
from dataclasses import dataclass

from codecbench.core.engine.planning.model import Cell, CodingJob
from codecbench.core.engine.running.schedule import Work
from codecbench.core.engine.storage.record import Record


@dataclass(frozen=True)
class Progress:
    """A moment of a run.

    Cells and jobs that an earlier run left are in `cells_kept` and nowhere else. remaining_s: an estimate,
    None before there is anything to base one on. compiling: how many kernels are compiled ahead so far, in words,
    empty when they all are. notice: something that its user has to know. cell and record: what just ended, None for a
    coding job.
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


class Pace:
    """Estimates the time that is left from the time that each kind of work took per frame so far."""

    def __init__(self, workers: int) -> None:
        self._workers = workers
        self._begun = time.monotonic()
        self._left: Counter[tuple[str, str]] = Counter()
        self._spent: dict[tuple[str, str], tuple[float, int]] = defaultdict(lambda: (0.0, 0))
        self._alone: set[tuple[str, str]] = set()

    def expect(self, jobs: list[CodingJob], cells: list[Cell]) -> None:
        """There are jobs and cells to be done."""
        self._alone |= {_kind(cell) for cell in cells if cell.exclusive}
        everything: list[Work] = [*jobs, *cells]
        for work in everything:
            self._left[_kind(work)] += work.sequence.frames

    @property
    def elapsed_s(self) -> float:
        return time.monotonic() - self._begun

    def ended(self, work: Work, duration_s: float | None = None) -> None:
        """A job or cell has ended; `duration_s` is None where it was never computed."""
        kind, frames = _kind(work), work.sequence.frames
        self._left[kind] -= frames
        if duration_s is not None:
            seconds, counted = self._spent[kind]
            self._spent[kind] = seconds + duration_s, counted + frames

    def again(self, work: Work) -> None:
        """A job or cell that has ended is to be done once more."""
        self._left[_kind(work)] += work.sequence.frames

    def remaining_s(self) -> float | None:
        """Seconds to the end; kinds of work that have not been seen yet are taken to cost the mean."""
        seconds = sum(spent for spent, _ in self._spent.values())
        frames = sum(count for _, count in self._spent.values())
        if not frames:
            return None
        total = 0.0
        for kind, left in self._left.items():
            spent, counted = self._spent.get(kind, (seconds, frames))
            total += left * spent / counted / (1 if kind in self._alone else self._workers)
        return total


def _kind(work: Work) -> tuple[str, str]:
    return ("coding", work.codec.name) if isinstance(work, CodingJob) else ("cell", work.evaluator.name)
