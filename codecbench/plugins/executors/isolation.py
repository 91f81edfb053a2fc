"""What happens inside a worker process: how it is prepared, and how one task is kept from harming the next.

The memory cap is RLIMIT_DATA, which Linux counts over all private writable mappings: an allocation beyond it
fails in Python as MemoryError and in C as a null pointer, at once. RLIMIT_AS would also count the gigabytes
that numerical libraries reserve and never touch. What the limit does not see (shared memory, forked
children) is watched from outside, see `pool`.
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
from codecbench.plugins.executors.fork_server import Surroundings
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
"""Set before a worker starts, because these libraries read them when they load."""

_PR_SET_PDEATHSIG: Final = 1
_PR_SET_CHILD_SUBREAPER: Final = 36


@dataclass(frozen=True)
class WorkerFiles:
    """Where a worker says who it is, where whatever it prints goes, and where its temporary files are."""

    identity: Path
    output: Path
    scratch: Path

    @property
    def begun(self) -> Path:
        """Where the worker says which task it has begun, see `begin`."""
        return self.scratch / ".begun"


@dataclass
class _State:
    baseline_mb: float = 0.0
    begun: Path | None = None


_state = _State()


def enter_worker(files: WorkerFiles, prepare: Callable[[], None], surroundings: Surroundings) -> None:
    """Make this process a worker: own process group, output, working folder; gone when the parent is gone.

    Calls `prepare` and then writes the worker's process id and memory in use to `files.identity`.
    """
    os.setpgid(0, 0)
    surroundings.enter()
    _redirect_output(files.output)
    files.scratch.mkdir(exist_ok=True)
    _state.begun = files.begun
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
    """Call the task's function under its limits and return its value; whatever it raises is passed on.

    A worker in which earlier tasks left more than half of this one's cap in use exits with RETIRED instead, and the
    pool gives the task to a fresh one.
    """
    if _is_crowded(task.memory_mb):
        os._exit(RETIRED)
    if _state.begun is not None:
        begin(_state.begun, task)
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
            os._exit(0)  # the task forked and came back twice
        with suppress(ValueError):  # the task lowered the limit for good; restoring then fails too
            resource.setrlimit(resource.RLIMIT_DATA, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
        os.sched_setaffinity(0, cores)
        faulthandler.cancel_dump_traceback_later()
        _end_children()


def _is_crowded(memory_mb: int | None) -> bool:
    """Whether earlier tasks, such as compiling kernels, left so much that a task with this cap would suffer.

    In this process, or in those that they left running.
    """
    return memory_mb is not None and tree_mb(os.getpid()) > _state.baseline_mb + memory_mb / 2


def begin(file: Path, task: Task) -> None:
    """Say that this process begins the task, so that it is not begun again if the process dies before it was heard."""
    with suppress(OSError):
        file.write_text(f"{os.getpid()} {task.id}")


def begun_by(files: WorkerFiles, task: Task) -> int | None:
    """The process that has begun the task; None where none has."""
    with suppress(OSError, ValueError):
        pid, _, id_ = files.begun.read_text().partition(" ")
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
    """Make orphans of this process's descendants its children: a task cannot leave a process by leaving its group."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1)


def _die_with_parent() -> None:
    """End this process and its group when the program ends that wanted it, even while C code holds the interpreter.

    The server that forked it ends with that program, and the system kills this process with the server.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    process = multiprocessing.parent_process()
    if process is not None:
        if not process.is_alive():
            os._exit(1)
        threading.Thread(target=_follow, args=(process,), name="parent watch", daemon=True).start()


def _follow(parent: Any) -> None:
    parent.join()
    os.killpg(os.getpid(), signal.SIGKILL)


def _limit_memory(memory_mb: int | None) -> None:
    """Let this process grow to `memory_mb` above what it had when it was prepared."""
    if memory_mb is None:
        return
    mapped_kb = 0
    with open("/proc/self/status", encoding="ascii", errors="replace") as status:
        mapped_kb = next((int(line.split()[1]) for line in status if line.startswith("VmData:")), 0)
    room_mb = _state.baseline_mb + memory_mb - private_mb(os.getpid())
    limit = mapped_kb * 1024 + int(max(room_mb, 0.0) * 2**20)
    resource.setrlimit(resource.RLIMIT_DATA, (limit, resource.RLIM_INFINITY))


def _end_children() -> None:
    """Kill and reap every process that the task left behind, but those that it left for the next one."""
    with suppress(ChildProcessError):
        os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)  # raises at once where there are none
        while left := [child for child in psutil.Process().children() if child.pid not in left_running]:
            for child in left:
                kill_tree(child.pid)
                with suppress(psutil.NoSuchProcess):
                    child.kill()  # one of this process's own group
                os.waitpid(child.pid, 0)  # its own children are this process's by now


_PREFIX: Final = "codecbench-workers-"
_ROOM_BYTES: Final = 1 << 16


class WorkerFolder(HeldFolder):
    """A new folder in `parent`, by default the system's for temporary files. Raises OSError on a full disk.

    Folders that pools left whose process was killed are removed first.
    """

    def __init__(self, parent: str | None = None) -> None:
        super().__init__(_PREFIX, parent)
        room = self.path / "room"
        try:  # on a full disk every worker would end before it began
            with open(room, "w", encoding="ascii") as file:
                file.write("\0" * _ROOM_BYTES)
            room.unlink()
        except OSError as error:
            self.remove()
            error.filename = str(self.path.parent)
            raise

    def files(self, number: int) -> WorkerFiles:
        """Where the worker of this number keeps its files."""
        return WorkerFiles(*(self.path / f"{number}.{ending}" for ending in ("json", "out", "tmp")))
