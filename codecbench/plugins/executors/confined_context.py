"""How confined workers are started: executed by what confines them, not forked from the server; see `confinement`."""

from __future__ import annotations

import errno
import json
import multiprocessing.spawn
import pickle
import shlex
import sys
import threading
from dataclasses import is_dataclass
from enum import Enum
from functools import partial
from io import BytesIO
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.context import SpawnContext, SpawnProcess
from typing import Any

from pebble.pool.process import Acknowledgement

from codecbench.core.contracts.confinement import CONFINED_PID, confining_words
from codecbench.plugins.executors.fork_server import hidden_main
from codecbench.plugins.executors.isolation import WorkerFiles

_STARTING = threading.Lock()
"""Held while a worker starts: the program that starts is one setting of the whole process, and pools have threads."""


class ConfinedContext(SpawnContext):
    """A multiprocessing context that starts a pool's one worker confined.

    Its files are made here, because it can write to `files.scratch` alone. What it answers is taken for data: messages
    of the pool that hold dataclasses of codecbench, exceptions and plain values, and nothing that calls anything.
    """

    def __init__(self, files: WorkerFiles) -> None:
        super().__init__()
        self._files = files
        self._pid = 0
        self._closed = False
        self.Process = self._process  # type: ignore[misc, assignment]

    def close(self) -> None:
        """Start no further worker: a pool replaces one that died until it has stopped, and its files serve the next."""
        with _STARTING:
            self._closed = True

    def RLock(self) -> Any:  # noqa: N802 - named by multiprocessing
        return _LockOfOneEnd()

    def Pipe(self, duplex: bool = True) -> Any:  # noqa: N802 - named by multiprocessing
        reader, writer = super().Pipe(duplex)
        reader.recv = partial(self._received, reader)  # type: ignore[method-assign]
        return reader, writer

    def _process(self, **words: Any) -> ConfinedProcess:
        process = ConfinedProcess(**words)
        process.begin = self._begin
        return process

    def _begin(self, start: Any) -> None:
        """Have `start` run the interpreter by a script that confines it, and write down which process that is."""
        with _STARTING:
            if self._closed:
                raise OSError(errno.ESHUTDOWN, "the worker's place is taken")  # what pebble expects where none starts
            self._begin_alone(start)

    def _begin_alone(self, start: Any) -> None:
        self._files.scratch.mkdir(exist_ok=True)
        script = self._files.identity.with_suffix(".sh")
        interpreter = multiprocessing.spawn.get_executable()
        words = shlex.join([*confining_words(str(self._files.scratch)), _text(interpreter)])
        output = shlex.quote(str(self._files.output))
        script.write_text(f'#!/bin/sh\nexport {CONFINED_PID}=$$\nexec {words} "$@" </dev/null >>{output} 2>&1\n')
        script.chmod(0o700)
        resource_tracker.ensure_running()  # it would be confined, too
        with hidden_main():
            multiprocessing.spawn.set_executable(str(script))
            try:
                self._pid = start()
            finally:
                multiprocessing.spawn.set_executable(interpreter)
        self._files.identity.write_text(json.dumps({"pid": self._pid, "baseline_mb": None}))

    def _received(self, reader: Connection) -> Any:
        message = _Answer.read(reader.recv_bytes())
        if isinstance(message, Acknowledgement):
            message.worker = self._pid  # it knows itself by another number
        return message


class ConfinedProcess(SpawnProcess):
    """A process that its context begins."""

    begin: Any

    def start(self) -> None:
        begin = self.__dict__.pop("begin")  # the context stays here
        begin(self._started)

    def _started(self) -> int:
        super().start()
        assert self.pid is not None
        return self.pid


class _LockOfOneEnd:
    """A lock among the threads of a process: with one process at each end of a pipe there is no other to exclude."""

    def __init__(self) -> None:
        self._lock = threading.RLock()

    def acquire(self, block: bool = True, timeout: float | None = None) -> bool:
        return self._lock.acquire(block, -1 if timeout is None or not block else timeout)

    def release(self) -> None:
        self._lock.release()

    def __reduce__(self) -> Any:
        return _LockOfOneEnd, ()


class _Answer(pickle.Unpickler):
    """Reads what a confined worker sends: dataclasses, enumerations and exceptions of the modules at hand."""

    @classmethod
    def read(cls, content: bytes) -> Any:
        """The message. Raises pickle.PicklingError where it is none, or names anything else."""
        try:
            return cls(BytesIO(content)).load()
        except (pickle.UnpicklingError, ValueError, LookupError, TypeError, AttributeError, EOFError) as error:
            raise pickle.PicklingError(f"the worker's answer cannot be read: {error}") from error

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) == ("pebble.common.types", "RemoteException.rebuild_exception"):
            return super().find_class(module, name)
        found = vars(sys.modules[module]).get(name) if module in sys.modules else None
        if isinstance(found, type) and found.__module__ == module and _is_plain(found, module.partition(".")[0]):
            return found
        raise pickle.PicklingError(f"the worker's answer names {module}.{name}, which is not data")


def _is_plain(found: type, package: str) -> bool:
    if issubclass(found, BaseException):
        return package in ("codecbench", "pebble", "builtins")
    return package in ("codecbench", "pebble") and (is_dataclass(found) or issubclass(found, Enum))


def _text(path: Any) -> str:
    return path.decode() if isinstance(path, bytes) else str(path)
