"""The fork server of workers: it loads once the modules that each worker would load again.

Loading numpy, numba, scipy and the rest costs a process about two seconds of processor time. A fork of a process that
has them starts in a few milliseconds, which matters if workers die, or live for one task. The server itself only forks
and runs no code besides these libraries.
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

_PRELOADED: Final = (
    "cv2", "pyarrow.parquet", "scipy.optimize", "codecbench.core.kernels.preload",
    "codecbench.plugins.executors.isolation", "codecbench.plugins.executors.fork_server_exit",
)  # fmt: skip
"""Modules that nearly every worker imports. None of them starts a thread on import, so that forking is safe."""

_main_lock = threading.Lock()


@contextmanager
def hide_main() -> Iterator[None]:
    """Keep processes started inside from importing the program's main script, which never defines tasks."""
    with _main_lock:
        main = sys.modules["__main__"]
        sys.modules["__main__"] = types.ModuleType("__main__")
        try:
            yield
        finally:
            sys.modules["__main__"] = main


def worker_context(*modules: str) -> BaseContext:
    """A multiprocessing context whose processes are forked from a server that has loaded `_PRELOADED` and `modules`.

    If the server gets no socket, they are spawned and each loads everything. The path of a socket has at most 107
    characters, and it is in the folder for temporary files, which may have a long name.
    """
    try:
        return _ForkServerContext(*modules)
    except OSError:
        return _SpawnedContext()


def server_pid() -> int | None:
    """The process id of the fork server; None if there is none, or if it is unknown."""
    return getattr(getattr(multiprocessing.forkserver, "_forkserver", None), "_forkserver_pid", None)


class _ForkedProcess(ForkServerProcess):
    def start(self) -> None:
        with hide_main(), _block_interrupts():  # the server may have died, and is then started again here
            super().start()


class _ForkServerContext(ForkServerContext):
    Process = _ForkedProcess

    def __init__(self, *modules: str) -> None:
        super().__init__()
        self.set_forkserver_preload([*_PRELOADED, *modules])
        with hide_main(), _use_safe_path(), _block_interrupts():
            multiprocessing.forkserver.ensure_running()


class _SpawnedProcess(SpawnProcess):
    def start(self) -> None:
        with hide_main():
            super().start()


class _SpawnedContext(SpawnContext):
    Process = _SpawnedProcess


@dataclass(frozen=True)
class ProcessEnvironment:
    """The environment that a worker takes from the program, not from the server that forks it."""

    variables: Mapping[str, str]
    umask: int

    @staticmethod
    def capture() -> ProcessEnvironment:
        """The environment of this process. Not for two threads at once: the umask can only be read by setting it."""
        mask = os.umask(0o077)
        os.umask(mask)
        return ProcessEnvironment(dict(os.environ), mask)

    def apply(self) -> None:
        """Make this the environment of this process, and let the server end with the process that started it.

        A forked process has a copy of the descriptor whose closing ends the server, so it closes its copy.
        """
        os.environ.clear()
        os.environ.update(self.variables)
        os.umask(self.umask)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})  # a worker ignores it, but its children need not
        server: Any = getattr(multiprocessing.forkserver, "_forkserver", None)  # the descriptor is not public
        with suppress(AttributeError, TypeError, OSError):
            os.close(server._forkserver_alive_fd)
            server._forkserver_alive_fd = None


@contextmanager
def _block_interrupts() -> Iterator[None]:
    """Block SIGINT in processes that are started inside: Ctrl-C is for the program, but reaches its whole terminal.

    The server ignores SIGINT itself, but only after loading everything; before, it prints a traceback.
    """
    resource_tracker.ensure_running()  # its start would unblock SIGINT
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _use_safe_path() -> Iterator[None]:
    """Keep the server from importing modules from the folder in which the program was started."""
    before = os.environ.get("PYTHONSAFEPATH")
    os.environ["PYTHONSAFEPATH"] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ["PYTHONSAFEPATH"]
        else:
            os.environ["PYTHONSAFEPATH"] = before
