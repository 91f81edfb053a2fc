"""The executor contract: run tasks in workers, and let no task take down another."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Literal

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
    worker is pinned to one core. company: the distributions, besides codecbench's, whose code it runs; a worker
    that has run a task with one company gets no task with another, so that nobody meets what another has changed.
    confined: only where the worker has no network and can write to no file outside a folder of its own.
    """

    id: str
    function: Callable[[Any], Any]
    argument: Any
    timeout_s: float | None = None
    memory_mb: int | None = None
    exclusive: bool = False
    company: tuple[str, ...] = ()
    confined: bool = False


@dataclass(frozen=True)
class Finished:
    """How a task ended: its value if `ok`, else a one-line reason and, where there is one, the traceback."""

    task_id: str
    status: Status
    value: Any = None
    reason: str = ""
    traceback: str = ""


@dataclass
class Retirement:
    """Whether this process, a worker, is to get no further task; see `retirement`."""

    asked: bool = False


retirement: Final = Retirement()
"""A task sets `asked` where it finds its process changed in a way that it cannot undo; the executor gives later tasks
to another process. Where it does not, those tasks fail: each looks for itself."""


class Executor(Configured[P]):
    """Runs tasks. The engine submits those whose inputs are ready and takes back whatever has finished.

    shares_files: workers see the run folder, so that large inputs and outputs travel by path, not by value.
    confines: it can do tasks that are to be confined; others are not given any.
    """

    shares_files: bool = True
    confines: ClassVar[bool] = False

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
