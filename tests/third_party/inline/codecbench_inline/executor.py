"""An executor that runs every task in the calling process, where a debugger reaches it."""

import traceback
from collections import deque
from collections.abc import Callable

from codecbench import Executor, Finished, NoParams, Task


class Inline(Executor[NoParams]):
    """One task at a time, without limits: a task that hangs or crashes takes the run with it."""

    name = "inline"
    version = "1"
    params_type = NoParams

    def __init__(self, params: NoParams) -> None:
        super().__init__(params)
        self._waiting: deque[Task] = deque()

    def start(self, workers: int, prepare: Callable[[], None]) -> None:
        prepare()

    def submit(self, task: Task) -> None:
        self._waiting.append(task)

    def next_finished(self, timeout_s: float) -> Finished | None:
        if not self._waiting:
            return None
        task = self._waiting.popleft()
        try:
            return Finished(task.id, "ok", task.function(task.argument))
        except Exception as error:
            reason = f"{type(error).__name__}: {error}"
            return Finished(task.id, "failed", reason=reason, traceback=traceback.format_exc())

    def stop(self) -> None:
        self._waiting.clear()
