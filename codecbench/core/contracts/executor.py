"""The executor contract: run tasks in workers, and let no task take down another."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Literal

from codecbench.core.contracts.params import Configured, P

Status = Literal["ok", "failed", "timed_out", "crashed", "unsupported"]

PATHS_VARIABLE: Final = "CODECBENCH_PATHS"
"""The environment variable that tells a worker where the folders of a plan are on its machine: `there=here`, joined
as in PATH."""


@dataclass(frozen=True)
class Task:
    """A call of an importable function in a worker.

    function and argument must pickle. timeout_s counts from when the worker starts it. memory_mb caps the
    worker's memory while it runs; None leaves it alone. exclusive: nothing else runs meanwhile, and the
    worker is pinned to one core.
    """

    id: str
    function: Callable[[Any], Any]
    argument: Any
    timeout_s: float | None = None
    memory_mb: int | None = None
    exclusive: bool = False


@dataclass(frozen=True)
class Finished:
    """How a task ended: its value if `ok`, else a one-line reason and, where there is one, the traceback."""

    task_id: str
    status: Status
    value: Any = None
    reason: str = ""
    traceback: str = ""


class Executor(Configured[P]):
    """Runs tasks. The engine submits those whose inputs are ready and takes back whatever has finished.

    shares_files: workers see the run folder, so that large inputs and outputs travel by path, not by value.
    """

    shares_files: bool = True

    @abstractmethod
    def start(self, workers: int, prepare: Callable[[], None]) -> None:
        """Start up to `workers` workers, each of which calls `prepare` once before its first task."""

    @abstractmethod
    def submit(self, task: Task) -> None:
        """Queue a task; returns at once."""

    @abstractmethod
    def next_finished(self, timeout_s: float) -> Finished | None:
        """The next task to end, or None when none ended within `timeout_s`."""

    @abstractmethod
    def stop(self) -> None:
        """End all workers within seconds, whatever they are doing. Safe to call twice."""
