"""The order in which a plan is computed: what is ready, what waits for bitstreams, what runs alone at the end."""

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
    """The remaining work of a plan.

    Work goes sequence by sequence, so that a worker reads each frame once for many settings. Within a sequence, the
    cells of a setting follow as soon as it is encoded. Exclusive cells come last, ordered by repeat and then by codec,
    so that drift (temperature, clock) affects all codecs alike.
    """

    def __init__(self, plan: Plan, todo: list[Cell], encoded: set[str]) -> None:
        """todo: the cells to compute. encoded: ids of the jobs whose bitstreams exist."""
        self.jobs = {job.id: job for job in plan.jobs}
        self.cells = {cell.id: cell for cell in todo}
        self._encoded = set(encoded)
        self._to_encode: set[str] = set()
        self._waiting: dict[str, list[Cell]] = defaultdict(list)
        self._ready: list[_Ready] = []
        self._exclusive: list[_Ready] = []
        self._under_way: set[str] = set()
        self._sequences = {entry.fingerprint: place for place, entry in enumerate(plan.sequences)}
        self._codecs: dict[PluginSetting, int] = {}
        self._evaluators: dict[PluginSetting, int] = {}
        for cell in plan.cells:
            self._codecs.setdefault(cell.codec, len(self._codecs))
            self._evaluators.setdefault(cell.evaluator, len(self._evaluators))
        self.needed_jobs = {cell.job_id for cell in todo if cell.job_id is not None} - self._encoded
        self._remaining = len(todo)
        for job_id in self.needed_jobs:
            self._encode(job_id)
        for cell in todo:
            if cell.job_id is None or cell.job_id in self._encoded:
                self._push(cell)
            else:
                self._waiting[cell.job_id].append(cell)

    def __len__(self) -> int:
        """Return how many cells and jobs have not ended."""
        return self._remaining

    def take(self, is_ready: Callable[[Work], bool] | None = None) -> Work | None:
        """Return what to start next, or None while everything waits for running work or is not ready."""
        queue = self._ready
        if not queue and not any(self._waiting.values()) and all(self._runs_alone(id_) for id_ in self._under_way):
            queue = self._exclusive
        if not queue:
            return None
        if is_ready is not None:
            entry = next((entry for entry in sorted(queue) if is_ready(self._work(entry.id))), None)
            if entry is None:
                return None
            queue.remove(entry)
            heapq.heapify(queue)
        else:
            entry = heapq.heappop(queue)
        self._under_way.add(entry.id)
        return self._work(entry.id)

    def _work(self, id_: str) -> Work:
        return self.jobs.get(id_) or self.cells[id_]

    def finish(self, work: Work) -> None:
        """Note the end of a job or cell; a job that ended well frees its cells."""
        self._under_way.discard(work.id)
        self._remaining -= 1
        if isinstance(work, CodingJob):
            self._encoded.add(work.id)
            self._to_encode.discard(work.id)
            for cell in self._waiting.pop(work.id, []):
                self._push(cell)

    def fail(self, job: CodingJob) -> list[Cell]:
        """Note that a job failed; remove the cells that depend on it from the schedule and return them."""
        self._under_way.discard(job.id)
        self._to_encode.discard(job.id)
        cells = self._waiting.pop(job.id, [])
        self._remaining -= 1 + len(cells)
        return cells

    def encode_again(self, cell: Cell) -> bool:
        """Put a cell back until its bitstreams are encoded again; return whether that was not already due."""
        assert cell.job_id is not None
        self._under_way.discard(cell.id)
        self._waiting[cell.job_id].append(cell)
        return self._encode(cell.job_id)

    def _encode(self, job_id: str) -> bool:
        if job_id in self._to_encode:
            return False
        self._encoded.discard(job_id)
        self._to_encode.add(job_id)
        self._push(self.jobs[job_id])
        self._remaining += 1
        return True

    def _push(self, work: Work) -> None:
        queue = self._exclusive if isinstance(work, Cell) and work.exclusive else self._ready
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
