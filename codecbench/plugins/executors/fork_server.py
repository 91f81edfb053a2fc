"""The process that workers are forked from: it has loaded once what each of them would load again.

Loading numpy, numba, scipy and the rest costs a process about two seconds of processor time; a fork of one that has
them begins in a few milliseconds, which counts where workers die, or live for one task.
The server runs nobody's code but these libraries': it only forks.
"""

from __future__ import annotations

import multiprocessing
import multiprocessing.forkserver
import os
import signal
import sys
import threading
import types
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.context import BaseContext, ForkServerContext, ForkServerProcess, SpawnContext, SpawnProcess
from typing import Any, Final

_LOADED: Final = (
    "cv2", "pyarrow.parquet", "scipy.optimize", "codecbench.core.kernels.preload",
    "codecbench.plugins.executors.isolation", "codecbench.plugins.executors.fork_server_exit",
)  # fmt: skip
"""What nearly every worker imports. None of these starts a thread when it is imported, so that forking is safe."""

_main_lock = threading.Lock()


@contextmanager
def hidden_main() -> Iterator[None]:
    """Processes started meanwhile do not import the program's main script again: tasks never live there."""
    with _main_lock:
        main = sys.modules["__main__"]
        sys.modules["__main__"] = types.ModuleType("__main__")
        try:
            yield
        finally:
            sys.modules["__main__"] = main


def worker_context(*modules: str) -> BaseContext:
    """A multiprocessing context whose processes are forked from a server that has loaded `_LOADED` and `modules`.

    They are spawned, each loading all of it, where the server gets no socket: the name of one has at most 107
    characters, and it lies in the folder for temporary files, which may have a long name.
    """
    try:
        return _ForkServer(*modules)
    except OSError:
        return _Spawned()


def server_pid() -> int | None:
    """The process that forks workers; None where there is none, or nobody says."""
    return getattr(getattr(multiprocessing.forkserver, "_forkserver", None), "_forkserver_pid", None)


class _ForkedProcess(ForkServerProcess):
    def start(self) -> None:
        with hidden_main(), _deaf():  # also where the server is gone, and started anew for it
            super().start()


class _ForkServer(ForkServerContext):
    Process = _ForkedProcess

    def __init__(self, *modules: str) -> None:
        super().__init__()
        self.set_forkserver_preload([*_LOADED, *modules])
        with hidden_main(), _safe_path(), _deaf():
            multiprocessing.forkserver.ensure_running()


class _SpawnedProcess(SpawnProcess):
    def start(self) -> None:
        with hidden_main():
            super().start()


class _Spawned(SpawnContext):
    Process = _SpawnedProcess


@dataclass(frozen=True)
class Surroundings:
    """What a process inherits from the one that wants it, but not from the server that forks it."""

    variables: Mapping[str, str]
    umask: int

    @staticmethod
    def now() -> Surroundings:
        """Those of this process. Not for two threads at once: the umask can only be read by setting it."""
        mask = os.umask(0o077)
        os.umask(mask)
        return Surroundings(dict(os.environ), mask)

    def enter(self) -> None:
        """Make them those of this process, and let the server end with the process that started it.

        A forked process holds a copy of the descriptor by which the server knows that it is still wanted.
        """
        os.environ.clear()
        os.environ.update(self.variables)
        os.umask(self.umask)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})  # which a worker ignores, and its children need not
        server: Any = getattr(multiprocessing.forkserver, "_forkserver", None)  # nothing public has the descriptor
        with suppress(AttributeError, TypeError, OSError):
            os.close(server._forkserver_alive_fd)
            server._forkserver_alive_fd = None


@contextmanager
def _deaf() -> Iterator[None]:
    """Processes started meanwhile do not hear SIGINT: Ctrl-C is for the program, and reaches all of its terminal.

    The server ignores it by itself, but only once it has loaded everything, and says so at length before.
    """
    resource_tracker.ensure_running()  # which would listen again after it has been started
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _safe_path() -> Iterator[None]:
    """The server does not import modules from the folder in which the program was started."""
    before = os.environ.get("PYTHONSAFEPATH")
    os.environ["PYTHONSAFEPATH"] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ["PYTHONSAFEPATH"]
        else:
            os.environ["PYTHONSAFEPATH"] = before
