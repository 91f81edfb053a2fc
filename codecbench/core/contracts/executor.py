"""The executor contract: run tasks in workers, and let no task take down another."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Literal

from codecbench.core.contracts.params import Configured, P

Status = Literal["ok", "failed", "timed_out", "crashed", "unsupported"]

PATHS_VARIABLE: Final = "CODECBENCH_PATHS"
"""Environment variable that maps the folders of a plan to a worker's machine: `there=here`, joined as in PATH."""


@dataclass(frozen=True)
class Task:
    """A call of an importable function in a worker."""

    id: str
    function: Callable[[Any], Any]
    """Must pickle."""
    argument: Any
    """Must pickle."""
    timeout_s: float | None = None
    """Seconds from when the worker starts it; None for no limit."""
    memory_mb: int | None = None
    """Cap on the worker's memory while the task runs; None for no cap."""
    exclusive: bool = False
    """Nothing else runs meanwhile, and the worker is pinned to one core."""


@dataclass(frozen=True)
class Finished:
    """How a task ended."""

    task_id: str
    status: Status
    value: Any = None
    """What the function returned, if `ok`."""
    reason: str = ""
    """Why it failed, in one line."""
    traceback: str = ""
    """Traceback of the failure, if there is one."""


class Executor(Configured[P]):
    """Runs tasks: the engine submits those whose inputs are ready and takes back those that have finished."""

    shares_files: bool = True
    """Workers see the run folder, so large inputs and outputs travel by path, not by value."""

    @abstractmethod
    def start(self, workers: int, prepare: Callable[[], None]) -> None:
        """Start up to `workers` workers, each of which calls `prepare` once before its first task."""

    @abstractmethod
    def submit(self, task: Task) -> None:
        """Queue a task, and return at once."""

    @abstractmethod
    def next_finished(self, timeout_s: float) -> Finished | None:
        """Return the next task to end; None if none ended within `timeout_s`."""

    @abstractmethod
    def stop(self) -> None:
        """End all workers within seconds, whatever they are doing. Safe to call twice."""
