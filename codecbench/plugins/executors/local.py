"""The local executor: worker processes on this machine, which are reused and isolated from each other."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable
from typing import ClassVar

from codecbench.core.contracts.errors import CodecbenchError
from codecbench.core.contracts.executor import Executor, Finished, Task
from codecbench.core.contracts.params import NoParams, Params
from codecbench.plugins.executors.isolation import SINGLE_THREADED
from codecbench.plugins.executors.pool import WorkerPool


class LocalExecutor(Executor[NoParams]):
    """Runs tasks in order in worker processes on this machine.

    An exclusive task waits until every earlier one has ended, and later ones wait for it. Numerical
    libraries in workers use one thread each.
    """

    name = "local"
    version = "1"
    params_type: ClassVar[type[Params]] = NoParams

    def __init__(self, params: NoParams | None = None) -> None:
        super().__init__(params or NoParams())
        self._pool: WorkerPool | None = None
        self._waiting: deque[Task] = deque()
        self._alone = False
        self._environment: dict[str, str | None] = {}

    def start(self, workers: int, prepare: Callable[[], None]) -> None:
        self._environment = {name: os.environ.get(name) for name in SINGLE_THREADED}
        os.environ.update(SINGLE_THREADED)
        self._pool = WorkerPool(workers, prepare)

    def submit(self, task: Task) -> None:
        self._waiting.append(task)
        self._fill()

    def next_finished(self, timeout_s: float) -> Finished | None:
        finished = self._running_pool().next_finished(timeout_s)
        if finished is not None:
            self._fill()
        return finished

    def stop(self) -> None:
        pool, self._pool = self._pool, None
        self._waiting.clear()
        if pool is None:
            return
        pool.stop()
        for name, value in self._environment.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value

    def _fill(self) -> None:
        """Start waiting tasks, in order, as far as workers and exclusive tasks allow."""
        pool = self._running_pool()
        while self._waiting:
            if pool.running and (self._alone or self._waiting[0].exclusive):
                return
            if not pool.start(self._waiting[0]):
                return
            self._alone = self._waiting.popleft().exclusive

    def _running_pool(self) -> WorkerPool:
        if self._pool is None:
            raise CodecbenchError("the local executor is not running; call start first")
        return self._pool
