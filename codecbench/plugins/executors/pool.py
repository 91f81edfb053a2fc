"""A pool of isolated worker processes on pebble.

Each worker is a pebble pool of its own, so that a worker that dies while it holds a lock or is halfway through
sending a result can harm no other task; after a death its pool is discarded. This module watches time, on the monotonic
clock, and memory, and kills a worker that exceeds either with all its descendants.
"""

from __future__ import annotations

import json
import os
import queue
import shutil
import signal
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from pebble import ProcessExpired, ProcessPool

from codecbench.core.contracts.executor import Finished, Status, Task
from codecbench.plugins.executors.fork_server import ProcessEnvironment, server_pid, worker_context
from codecbench.plugins.executors.isolation import RETIRED, WorkerFiles, WorkerFolder, enter_worker, perform, process_of
from codecbench.plugins.executors.process_tree import is_running, kill_tree, tree_mb

_POLL_S: Final = 0.1
_START_S: Final = 180.0
"""The longest that a worker may take to start its task; importing everything takes seconds on a cold disk."""
_GRACE_S: Final = 0.5
"""After a time-out, time for the worker to write its traceback."""
_ENDING_S: Final = 2.0
"""The longest wait for workers at the end; a killed one ends within a few milliseconds."""
_LAUNCHES: Final = 3
"""How often a task is started whose worker dies before it begins."""
_UNKNOWN: Final = 255
"""Exit status that multiprocessing reports if it cannot know the real one."""
_LOST: Final = "its worker was lost with the process that starts workers, which a plugin or the system killed"
_OUTPUT_TAIL: Final = 8192
_OUTPUT_LIMIT: Final = 16 << 20


@dataclass
class _Slot:
    """One worker and its current task."""

    files: WorkerFiles
    pool: ProcessPool | None = None
    task: Task | None = None
    future: Future[Any] | None = None
    launched: float = 0.0
    """When the task was given to the worker, on the monotonic clock."""
    started: float | None = None
    """When the worker began the task, as far as known."""
    pid: int = 0
    baseline_mb: float = 0.0
    gone_since: float | None = None
    """When the process was first missing."""
    server: int | None = None
    """Process id of the fork server at launch."""
    launches: int = 0


class WorkerPool:
    """Up to `workers` processes, each with one task at a time. Use it from one thread.

    Their files are in a new folder in `folder`, by default the system's folder for temporary files.
    """

    def __init__(self, workers: int, prepare: Callable[[], None], folder: str | None = None) -> None:
        self._prepare = prepare
        self._folder = WorkerFolder(folder)
        self._context = worker_context(prepare.__module__)
        self._slots = [_Slot(self._folder.files(n)) for n in range(workers)]
        self._done: queue.Queue[tuple[_Slot, Future[Any]]] = queue.Queue()
        self._endings: list[threading.Thread] = []

    @property
    def running(self) -> int:
        return sum(slot.task is not None for slot in self._slots)

    def start(self, task: Task) -> bool:
        """Give the task to a free worker, preferably one that has started; False if all are busy."""
        free = [slot for slot in self._slots if slot.task is None]
        if not free:
            return False
        slot = next((slot for slot in free if slot.pool is not None), free[0])
        slot.task, slot.launches = task, 0
        self._launch(slot)
        return True

    def next_finished(self, timeout_s: float) -> Finished | None:
        """The next task to end, or None if none ended in time."""
        deadline = time.monotonic() + timeout_s
        while True:
            left = deadline - time.monotonic()
            try:
                slot, future = self._done.get(timeout=max(0.0, min(_POLL_S, left)))
            except queue.Empty:
                finished = self._watch()
            else:
                finished = self._settle(slot, future) if slot.future is future else None
            if finished is not None or left <= 0:
                return finished

    def stop(self) -> None:
        """Kill all workers and everything that they started."""
        for slot in self._slots:
            slot.task = slot.future = None
            self._discard(slot)
        # A worker that is still starting prints errors if this process, and so its semaphores, ends first.
        deadline = time.monotonic() + _ENDING_S
        for ending in self._endings:
            ending.join(max(0.0, deadline - time.monotonic()))
        self._folder.remove()

    def kill(self) -> None:
        """Kill the processes of all workers; their tasks end as crashed. For use from another thread."""
        for slot in self._slots:
            with suppress(OSError, ValueError):
                kill_tree(json.loads(slot.files.identity.read_text())["pid"])

    def _launch(self, slot: _Slot) -> None:
        """Start the slot's task, in a new worker if the old one has ended."""
        assert slot.task is not None
        slot.launches += 1
        slot.launched, slot.started, slot.gone_since = time.monotonic(), None, None
        if slot.pool is None or not slot.pool.active:
            self._discard(slot)
            slot.pool = ProcessPool(
                max_workers=1,
                initializer=enter_worker,
                initargs=(slot.files, self._prepare, ProcessEnvironment.capture()),
                context=self._context,
            )
        future: Future[Any]
        try:
            future = slot.pool.schedule(perform, args=(slot.task,))
        except (
            RuntimeError
        ) as error:  # no process could be started: a signal to the process group may be ending the server
            future = Future()
            future.set_exception(error)
            self._discard(slot)
        slot.future, slot.server = future, server_pid()
        future.add_done_callback(lambda done: self._done.put((slot, done)))

    def _settle(self, slot: _Slot, future: Future[Any]) -> Finished | None:
        """The result of a task whose future is done; None if it was started again."""
        if future.cancelled():
            return self._end(slot, "crashed", "its worker was stopped", discard=True)
        error = future.exception()
        if error is None:
            return self._end(slot, "ok", value=future.result())
        if isinstance(error, ProcessExpired):
            exitcode = error.exitcode
            if exitcode == RETIRED and slot.launches < _LAUNCHES:
                self._discard(slot)
                self._launch(slot)
                return None
            unknown = exitcode == _UNKNOWN
            if unknown and slot.server is not None and not is_running(slot.server):
                return self._end(slot, "crashed", _LOST, discard=True)
            if unknown:  # two threads asked for the status at once, and only one of them gets it: it may be RETIRED
                return self._restart(slot, _describe_death(exitcode))
            return self._end(slot, "crashed", _describe_death(exitcode), discard=True)
        if isinstance(error, RuntimeError) and (slot.pool is None or not slot.pool.active):
            return self._restart(slot, f"its worker could not start or respond: {error}")
        text = " ".join(f"{type(error).__name__}: {error}".split())
        return self._end(slot, "failed", text, traceback=str(error.__cause__ or ""))

    def _restart(self, slot: _Slot, reason: str) -> Finished | None:
        """Start the task again if its worker died before the task began; after _LAUNCHES times the task has crashed."""
        assert slot.task is not None
        if slot.launches >= _LAUNCHES or process_of(slot.files, slot.task) is not None:
            return self._end(slot, "crashed", reason, discard=True)
        self._discard(slot)
        self._launch(slot)
        return None

    def _end(self, slot: _Slot, status: Status, reason: str = "", discard: bool = False, **more: Any) -> Finished:
        assert slot.task is not None
        if reason and not more.get("traceback"):
            more["traceback"] = _output_tail(slot.files.output)
        finished = Finished(slot.task.id, status, reason=reason, **more)
        slot.task = slot.future = None
        if discard:
            self._discard(slot)
        return finished

    def _watch(self) -> Finished | None:
        """Check every busy worker, and return the first task that has to be given up."""
        now = time.monotonic()
        for slot in self._slots:
            if slot.task is not None and (finished := self._watch_one(slot, slot.task, now)) is not None:
                return finished
        return None

    def _watch_one(self, slot: _Slot, task: Task, now: float) -> Finished | None:
        if slot.started is None:
            if slot.future is not None and slot.future.running():
                self._note_worker(slot, now)
            elif (pid := process_of(slot.files, task)) is not None:  # pebble does not know yet, and may never
                slot.pid, slot.started, slot.baseline_mb = pid, now, tree_mb(pid)
            elif now - slot.launched > _START_S:
                return self._restart(slot, f"its worker did not start within {_START_S:g} s")
            return None
        if task.timeout_s is not None and now - slot.started > task.timeout_s + _GRACE_S:
            return self._end(slot, "timed_out", f"no result within {task.timeout_s:g} s", discard=True)
        used_mb = tree_mb(slot.pid) - slot.baseline_mb
        if task.memory_mb is not None and used_mb > task.memory_mb:
            reason = f"used {used_mb:.0f} MB with its children; memory_mb allows {task.memory_mb}"
            return self._end(slot, "crashed", reason, discard=True)
        with suppress(OSError):
            if slot.files.output.stat().st_size > _OUTPUT_LIMIT:
                os.truncate(slot.files.output, 0)
        return self._watch_gone(slot, now)

    def _watch_gone(self, slot: _Slot, now: float) -> Finished | None:
        """Give up a task whose worker exited with status 0 in the middle of it, which pebble takes for no death.

        A worker that declined the task, see `perform`, exits before the task begins; pebble may report that late.
        """
        if is_running(slot.pid):
            slot.gone_since = None
        elif slot.gone_since is None:
            slot.gone_since = now
        elif now - slot.gone_since > 1.0:
            return self._restart(slot, _describe_death(0))
        return None

    def _note_worker(self, slot: _Slot, now: float) -> None:
        """Record the process that took the task. It may have ended since, and pebble then has started another one."""
        pid = _acknowledging_pid(slot)
        if pid is None:
            return
        identity = json.loads(slot.files.identity.read_text())
        slot.pid, slot.started = pid, now
        baseline_mb = identity["baseline_mb"] if identity["pid"] == pid else None
        slot.baseline_mb = tree_mb(slot.pid) if baseline_mb is None else baseline_mb

    def _discard(self, slot: _Slot) -> None:
        """Kill the slot's worker with its descendants and drop its pool."""
        pool, slot.pool = slot.pool, None
        if pool is None:
            return
        pool.stop()  # type: ignore[no-untyped-call]
        with suppress(OSError, ValueError):
            kill_tree(json.loads(slot.files.identity.read_text())["pid"])
        slot.files.identity.unlink(missing_ok=True)
        shutil.rmtree(slot.files.scratch, ignore_errors=True)
        # Joining can wait forever for the rest of a message from a worker that died while sending it.
        ending = threading.Thread(target=pool.join, name="pool end", daemon=True)
        ending.start()
        self._endings = [*(other for other in self._endings if other.is_alive()), ending]


def _acknowledging_pid(slot: _Slot) -> int | None:
    """The process that has acknowledged the slot's task, which only pebble knows; None once the task has ended."""
    assert slot.pool is not None
    tasks = list(slot.pool._pool_manager.task_manager.tasks.values())
    return next((task.worker_id for task in tasks if task.future is slot.future), None)


def _describe_death(exitcode: int) -> str:
    if exitcode < 0:
        names = {int(number): number.name for number in signal.Signals}
        name = names.get(-exitcode, f"signal {-exitcode}")
        hint = "; the system does this when memory runs out" if name == "SIGKILL" else ""
        return f"its worker was killed by {name}{hint}"
    return f"its worker exited with status {exitcode} during the task"


def _output_tail(path: Path) -> str:
    """The end of a worker's output, which has the traceback of a crash."""
    with suppress(OSError), open(path, "rb") as stream:
        stream.seek(max(0, path.stat().st_size - _OUTPUT_TAIL))
        return stream.read().decode(errors="replace")
    return ""
