"""Preparation of a worker process, the limits of its tasks, and its files.

The memory cap is RLIMIT_DATA, which Linux counts over all private writable mappings: an allocation beyond it fails at
once, in Python as MemoryError and in C as a null pointer. RLIMIT_AS would also count the gigabytes that numerical
libraries reserve and never touch. Memory that the limit does not count (shared memory, forked children) is watched from
outside, see `pool`.
"""

from __future__ import annotations

import ctypes
import faulthandler
import json
import multiprocessing
import os
import resource
import signal
import sys
import tempfile
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import psutil

from codecbench.core.contracts.executor import Task
from codecbench.core.contracts.held_folder import HeldFolder, left_running
from codecbench.plugins.executors.fork_server import ProcessEnvironment
from codecbench.plugins.executors.process_tree import kill_tree, private_mb, tree_mb

RETIRED: Final = 86
"""Exit status of a worker that declines a task because earlier ones left too much memory in use."""

SINGLE_THREADED: Final = dict.fromkeys(
    (
        "OMP_NUM_THREADS",
        "OPENBLAS_NUM_THREADS",
        "MKL_NUM_THREADS",
        "NUMEXPR_NUM_THREADS",
        "NUMBA_NUM_THREADS",
        "VECLIB_MAXIMUM_THREADS",
        "BLIS_NUM_THREADS",
    ),
    "1",
)
"""Environment variables that are set before a worker starts, because libraries read them when they load."""

_FOLDER_PREFIX: Final = "codecbench-workers-"
_ROOM_BYTES: Final = 1 << 16
"""Free space that a folder of workers needs on its disk."""
_PR_SET_PDEATHSIG: Final = 1
_PR_SET_CHILD_SUBREAPER: Final = 36


@dataclass(frozen=True)
class WorkerFiles:
    """The files of a worker."""

    identity: Path
    """Its process id and memory in use."""
    output: Path
    """Everything that it prints."""
    scratch: Path
    """Folder of its temporary files."""

    @property
    def task_start(self) -> Path:
        """The file in which it records the task that it has started, see `record_start`."""
        return self.scratch / ".begun"


@dataclass
class _State:
    baseline_mb: float = 0.0
    """Memory in use after preparation."""
    task_start: Path | None = None


_state = _State()


def enter_worker(files: WorkerFiles, prepare: Callable[[], None], environment: ProcessEnvironment) -> None:
    """Make this process a worker: with its own process group, output and working folder; it ends with its parent.

    Calls `prepare` and then writes the worker's process id and memory in use to `files.identity`.
    """
    os.setpgid(0, 0)
    environment.apply()
    _redirect_output(files.output)
    files.scratch.mkdir(exist_ok=True)
    _state.task_start = files.task_start
    for name in {"CODECBENCH_CACHE", "CODECBENCH_KERNELS"} & os.environ.keys():
        os.environ[name] = os.path.abspath(os.path.expanduser(os.environ[name]))
    os.chdir(files.scratch)
    tempfile.tempdir = os.environ["TMPDIR"] = str(files.scratch)
    faulthandler.enable(sys.stderr, all_threads=False)
    _adopt_orphans()
    _die_with_parent()
    prepare()
    _state.baseline_mb = private_mb(os.getpid())
    content = json.dumps({"pid": os.getpid(), "baseline_mb": _state.baseline_mb})
    temporary = files.identity.with_suffix(".new")
    temporary.write_text(content)
    os.replace(temporary, files.identity)


def perform(task: Task) -> Any:
    """Call the task's function under its limits and return its value; exceptions are passed on.

    If earlier tasks left more than half of this one's cap in use, the worker exits with RETIRED instead, and the pool
    gives the task to a new worker.
    """
    if _is_crowded(task.memory_mb):
        os._exit(RETIRED)
    if _state.task_start is not None:
        record_start(_state.task_start, task)
    os.ftruncate(1, 0)
    if task.timeout_s is not None:
        faulthandler.dump_traceback_later(task.timeout_s, file=sys.stderr)
    cores, process = os.sched_getaffinity(0), os.getpid()
    try:
        if task.exclusive:
            os.sched_setaffinity(0, {max(cores)})
        _limit_memory(task.memory_mb)
        return task.function(task.argument)
    finally:
        if os.getpid() != process:
            os._exit(0)  # the task forked and returned twice
        with suppress(ValueError):  # the task lowered the limit permanently; restoring it fails too
            resource.setrlimit(resource.RLIMIT_DATA, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
        os.sched_setaffinity(0, cores)
        faulthandler.cancel_dump_traceback_later()
        _end_children()


def _is_crowded(memory_mb: int | None) -> bool:
    """Whether earlier tasks, such as compiling kernels, left more than half of a task's cap in use.

    Counts this process and those that they left running.
    """
    return memory_mb is not None and tree_mb(os.getpid()) > _state.baseline_mb + memory_mb / 2


def record_start(file: Path, task: Task) -> None:
    """Record that this process starts the task, so that the task does not start again if the process dies early."""
    with suppress(OSError):
        file.write_text(f"{os.getpid()} {task.id}")


def process_of(files: WorkerFiles, task: Task) -> int | None:
    """The process that has started the task; None if none has."""
    with suppress(OSError, ValueError):
        pid, _, id_ = files.task_start.read_text().partition(" ")
        return int(pid) if id_ == task.id else None
    return None


def _redirect_output(path: Path) -> None:
    output = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND | os.O_TRUNC, 0o600)
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.dup2(output, 1)
    os.dup2(output, 2)
    os.close(output)
    os.close(nothing)


def _adopt_orphans() -> None:
    """Make orphaned descendants children of this process, so that none can escape by leaving the process group."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1)


def _die_with_parent() -> None:
    """End this process and its group with the program that wanted it, even while C code blocks the interpreter.

    The server that forked this process ends with the program, and the system kills this process with the server.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    process = multiprocessing.parent_process()
    if process is not None:
        if not process.is_alive():
            os._exit(1)
        threading.Thread(target=_end_after, args=(process,), name="parent watch", daemon=True).start()


def _end_after(parent: Any) -> None:
    parent.join()
    os.killpg(os.getpid(), signal.SIGKILL)


def _limit_memory(memory_mb: int | None) -> None:
    """Limit the memory of this process to `memory_mb` above what it used when it was prepared."""
    if memory_mb is None:
        return
    mapped_kb = 0
    with open("/proc/self/status", encoding="ascii", errors="replace") as status:
        mapped_kb = next((int(line.split()[1]) for line in status if line.startswith("VmData:")), 0)
    room_mb = _state.baseline_mb + memory_mb - private_mb(os.getpid())
    limit = mapped_kb * 1024 + int(max(room_mb, 0.0) * 2**20)
    resource.setrlimit(resource.RLIMIT_DATA, (limit, resource.RLIM_INFINITY))


def _end_children() -> None:
    """Kill and reap the processes that the task left behind, except those that it left for the next task."""
    with suppress(ChildProcessError):
        os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)  # raises at once if there are none
        while left := [child for child in psutil.Process().children() if child.pid not in left_running]:
            for child in left:
                kill_tree(child.pid)
                with suppress(psutil.NoSuchProcess):
                    child.kill()  # one of this process's own group
                os.waitpid(child.pid, 0)  # its own children are this process's by now


class WorkerFolder(HeldFolder):
    """A new folder for the files of a pool's workers, in `parent` or else the system's folder for temporary files.

    It is held while the pool lives. Folders of pools whose process was killed are removed first. Raises OSError on a
    full disk.
    """

    def __init__(self, parent: str | None = None) -> None:
        super().__init__(_FOLDER_PREFIX, parent)
        room = self.path / "room"
        try:  # on a full disk every worker would end before its first task
            with open(room, "w", encoding="ascii") as file:
                file.write("\0" * _ROOM_BYTES)
            room.unlink()
        except OSError as error:
            self.remove()
            error.filename = str(self.path.parent)
            raise

    def files(self, number: int) -> WorkerFiles:
        """The files of the worker of this number."""
        return WorkerFiles(*(self.path / f"{number}.{ending}" for ending in ("json", "out", "tmp")))
