"""In which order a plan is worked off: what is ready, what waits for bitstreams, what runs alone at the end."""

from __future__ import annotations

import heapq
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

from codecbench.core.engine.planning.model import Cell, CodingJob, Plan, PluginSetting

Work: TypeAlias = CodingJob | Cell
_Rank: TypeAlias = tuple[int, ...]


@dataclass(frozen=True, order=True)
class _Ready:
    rank: _Rank
    id: str


class Schedule:
    """The work that is left of a plan.

    Sequence by sequence, so that a worker reads each frame once for many settings; within one, the cells of a
    setting as soon as it is encoded. Exclusive cells come when all else is done, ordered by repeat and then by
    codec, so that whatever drifts meanwhile (temperature, clock) falls on all codecs alike.
    """

    def __init__(self, plan: Plan, todo: list[Cell], coded: set[str]) -> None:
        """todo: the cells to compute. coded: ids of the jobs whose bitstreams are there."""
        self.jobs = {job.id: job for job in plan.jobs}
        self.cells = {cell.id: cell for cell in todo}
        self._coded = set(coded)
        self._uncoded: set[str] = set()
        self._waiting: dict[str, list[Cell]] = defaultdict(list)
        self._ready: list[_Ready] = []
        self._alone: list[_Ready] = []
        self._out: set[str] = set()
        self._sequences = {entry.fingerprint: place for place, entry in enumerate(plan.sequences)}
        self._codecs: dict[PluginSetting, int] = {}
        self._evaluators: dict[PluginSetting, int] = {}
        for cell in plan.cells:
            self._codecs.setdefault(cell.codec, len(self._codecs))
            self._evaluators.setdefault(cell.evaluator, len(self._evaluators))
        self.needed_jobs = {cell.job_id for cell in todo if cell.job_id is not None} - self._coded
        self._left = len(todo)
        for job_id in self.needed_jobs:
            self._encode(job_id)
        for cell in todo:
            if cell.job_id is None or cell.job_id in self._coded:
                self._push(cell)
            else:
                self._waiting[cell.job_id].append(cell)

    def __len__(self) -> int:
        """How many cells and jobs have not ended."""
        return self._left

    def take(self, is_ready: Callable[[Work], bool] | None = None) -> Work | None:
        """What to start next, or None while everything waits for something that is under way, or is not ready."""
        queue = self._ready
        if not queue and not any(self._waiting.values()) and all(self._runs_alone(id_) for id_ in self._out):
            queue = self._alone
        if not queue:
            return None
        if is_ready is not None:
            found = next((entry for entry in sorted(queue) if is_ready(self._work(entry.id))), None)
            if found is None:
                return None
            queue.remove(found)
            heapq.heapify(queue)
        else:
            found = heapq.heappop(queue)
        self._out.add(found.id)
        return self._work(found.id)

    def _work(self, id_: str) -> Work:
        return self.jobs.get(id_) or self.cells[id_]

    def ended(self, work: Work) -> None:
        """A job or cell that was taken has ended; a job that ended well frees its cells."""
        self._out.discard(work.id)
        self._left -= 1
        if isinstance(work, CodingJob):
            self._coded.add(work.id)
            self._uncoded.discard(work.id)
            for cell in self._waiting.pop(work.id, []):
                self._push(cell)

    def failed(self, job: CodingJob) -> list[Cell]:
        """A job ended badly: the cells that can now not be computed, which are out of the schedule."""
        self._out.discard(job.id)
        self._uncoded.discard(job.id)
        cells = self._waiting.pop(job.id, [])
        self._left -= 1 + len(cells)
        return cells

    def encode_again(self, cell: Cell) -> bool:
        """A cell that was taken waits until its bitstreams are made again; whether that was not due already."""
        assert cell.job_id is not None
        self._out.discard(cell.id)
        self._waiting[cell.job_id].append(cell)
        return self._encode(cell.job_id)

    def _encode(self, job_id: str) -> bool:
        if job_id in self._uncoded:
            return False
        self._coded.discard(job_id)
        self._uncoded.add(job_id)
        self._push(self.jobs[job_id])
        self._left += 1
        return True

    def _push(self, work: Work) -> None:
        queue = self._alone if isinstance(work, Cell) and work.exclusive else self._ready
        heapq.heappush(queue, _Ready(self._rank(work), work.id))

    def _rank(self, work: Work) -> _Rank:
        sequence = self._sequences[work.sequence.fingerprint]
        codec = self._codecs[work.codec]
        if isinstance(work, CodingJob):
            return sequence, 0, codec, 0, 0
        evaluator = self._evaluators[work.evaluator]
        if work.exclusive:
            return sequence, evaluator, work.repeat, codec
        return sequence, int(work.job_id is None), codec, 1 + evaluator, work.repeat

    def _runs_alone(self, id_: str) -> bool:
        return id_ in self.cells and self.cells[id_].exclusive
