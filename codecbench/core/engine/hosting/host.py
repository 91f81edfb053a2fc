"""A host: a process in which the plugins of one distribution are imported, constructed and called, in one role.

Plugins of other distributions than codecbench's run only in hosts. Answers are JSON and bytes, so that no answer can
make this process import or call anything. If a host exits, is killed, hangs or answers nonsense, only the current
question is lost. Roles separate what must not share knowledge: the decoder never saw what was encoded. Each host has a
parent, its supervisor, because a plugin may kill its parent; everything a host started ends with it.
"""

from __future__ import annotations

import os
import select
import subprocess
import threading
import time
import weakref
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final, Literal

from codecbench.core.contracts.held_folder import HeldFolder, left_running, open_plain
from codecbench.core.engine.hosting import HOSTED_VARIABLE
from codecbench.core.engine.hosting.channel import (
    CRASH_FILE,
    LONGEST_TRACE,
    Channel,
    PluginFault,
    PluginLoss,
    PluginNonsense,
    PluginTimeout,
    SharedMemory,
)
from codecbench.core.engine.hosting.confinement import confinement, is_confinement_requested, supervisor_command
from codecbench.core.engine.text import describe_exit

__all__ = ["Host", "PluginFault", "PluginLoss", "PluginTimeout"]

Role = Literal["describe", "read", "encode", "decode", "evaluate"]

LIMIT_VARIABLE: Final = "CODECBENCH_PLUGIN_TIMEOUT_S"
"""Environment variable with the time limit for importing, constructing or describing a plugin, in seconds."""

FOLDER_PREFIX: Final = "codecbench-host-"
"""Prefix of the names of hosts' temporary folders."""

_SERVE: Final = "codecbench.core.engine.plugins.serving:serve"
_LIMIT_S: Final = 60.0
_POLL_MS: Final = 100
_PATIENCE_S: Final = 1.0
_MOST_LATE: Final = 1000
"""Maximum number of reads of a late answer."""


def limit_s() -> float:
    """Return the time limit of a host for one description, in seconds."""
    with suppress(ValueError):
        return max(0.1, float(os.environ.get(LIMIT_VARIABLE, _LIMIT_S)))
    return _LIMIT_S


class Host:
    """The process of one distribution, given with its version, in one role; the first question starts it.

    limit_s: time limit of an answer; None if the caller is watched itself. prints: the plugins' output goes to this
    process's output instead of nowhere, unless the host is confined.
    """

    def __init__(
        self,
        distribution: str,
        role: Role = "describe",
        limit_s: Callable[[], float] | None = limit_s,
        *,
        prints: bool = False,
    ) -> None:
        self.distribution, self.role, self._limit_s, self._prints = distribution, role, limit_s, prints
        self._process: subprocess.Popen[bytes] | None = None
        self._end: Callable[[], Any] = lambda: None
        self._channel: _HostChannel | None = None
        self._lock = threading.Lock()
        self._deadline: float | None = None
        self._late = 0
        self._folder = Path()
        self._shows: set[str] = set()

    @property
    def lives(self) -> bool:
        """Whether it was started and has not ended."""
        return self._process is not None and self._process.poll() is None

    def start(self) -> None:
        """Start the process without waiting for it."""
        if self._process is not None:
            return
        folder_lock = HeldFolder(FOLDER_PREFIX)
        self._folder = folder_lock.path
        folder = str(folder_lock.path)
        if confines := is_confinement_requested():
            confinement()
        host_reads, writes = os.pipe()
        reads, host_writes = os.pipe()
        sends, receives = SharedMemory(), SharedMemory()
        descriptors = (host_reads, host_writes, receives.descriptor, sends.descriptor)
        output = None if self._prints and not confines else subprocess.DEVNULL
        self._process = subprocess.Popen(
            supervisor_command(
                _SERVE,
                descriptors,
                self.distribution,
                folder,
                folder=folder,
                confines=confines,
                descriptors=descriptors,
                dies=self._limit_s is None,
                shows=self._shows,
            ),
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=output,
            pass_fds=descriptors,
            cwd=folder,
            env={**os.environ, **cache_variable(), "TMPDIR": folder, HOSTED_VARIABLE: "1"},
            start_new_session=True,
        )
        os.close(host_reads)
        os.close(host_writes)
        left_running.add(self._process.pid)
        self._channel = _HostChannel(self, reads, writes, sends, receives)
        self._end = weakref.finalize(self, _end, self._process, (reads, writes), (sends, receives), folder_lock)

    def ask(
        self, function: Callable[..., Any] | str, *arguments: Any, times: float = 1, shows: Collection[str] = ()
    ) -> Any:
        """Return what `function(*arguments)` returns there. function: of codecbench, also as `module:name`.

        times: multiple of the usual time limit. shows: paths that it must see if it is confined; it is restarted for a
        new one. Raises the CodecbenchError that the function raised, PluginTimeout, or PluginFault for anything else.
        """
        name = function if isinstance(function, str) else f"{function.__module__}:{function.__qualname__}"
        with self._lock:
            if not self._shows.issuperset(shows):
                self._shows.update(shows)
                if is_confinement_requested():
                    self.end()
            self.start()
            assert self._channel is not None
            self._channel.limit_s = None if self._limit_s is None else times * self._limit_s()
            return self._channel.call(None, name, *arguments)

    def end(self) -> None:
        """End the process and everything it started; the next question starts another."""
        if self._process is not None:
            left_running.discard(self._process.pid)
        self._end()
        self._process, self._channel, self._end = None, None, lambda: None

    @contextmanager
    def answering(self, channel: _HostChannel) -> Iterator[None]:
        """Set the deadline of an answer, and end this host if the block fails because of it."""
        if self._channel is not channel:
            raise PluginLoss("its process has ended")
        if channel.depth == 0:
            channel.forget()
            self._deadline = None if channel.limit_s is None else time.monotonic() + channel.limit_s
            self._late = 0
        try:
            yield
        except (EOFError, BrokenPipeError, ConnectionError) as error:
            loss = self._loss()
            self.end()
            raise loss from error
        except (PluginLoss, PluginNonsense, KeyboardInterrupt):
            self.end()
            raise

    def wait(self, descriptor: int, event: int) -> None:
        """Return when there is something to read or room to write. Raises PluginLoss if the process is gone or late.

        What arrived in time is read even after the deadline, but not what keeps arriving.
        """
        assert self._process is not None
        assert self._channel is not None
        poll = select.poll()
        poll.register(descriptor, event)
        while True:
            is_gone = self._process.poll() is not None
            is_late = self._deadline is not None and time.monotonic() > self._deadline
            self._late += is_late
            if poll.poll(0 if is_gone or is_late else _POLL_MS) and self._late < _MOST_LATE:
                return
            if is_late:
                raise PluginTimeout(f"no answer within {self._channel.limit_s:g} s")
            if is_gone:
                raise self._loss()

    def _loss(self) -> PluginLoss:
        """Return the error that says how the process ended, with its stack trace."""
        assert self._process is not None
        try:
            status = self._process.wait(1.0)
            loss = PluginLoss(describe_exit(128 - status if status > 128 else status))
        except subprocess.TimeoutExpired:
            return PluginLoss("its process closed the connection")
        with suppress(OSError), open(self._folder / CRASH_FILE, errors="replace", opener=open_plain) as file:
            if trace := file.read(LONGEST_TRACE):
                loss.add_note(f"in its host:\n{trace}")
        return loss


class _HostChannel(Channel):
    """The calling end of a conversation with a host."""

    def __init__(self, host: Host, reads: int, writes: int, sends: SharedMemory, receives: SharedMemory) -> None:
        super().__init__(reads, writes, sends, receives, host.wait)
        self._host = host  # keeps the host alive as long as any of its objects

    def call(self, target: Any, name: str, *arguments: Any, **words: Any) -> Any:
        with self._host.answering(self):
            self.depth += 1
            try:
                return super().call(target, name, *arguments, **words)
            finally:
                self.depth -= 1


def cache_variable() -> dict[str, str]:
    """Return the environment variables of the kernel cache with absolute paths, valid in any folder."""
    names = {"CODECBENCH_CACHE", "CODECBENCH_KERNELS"} & os.environ.keys()
    return {name: os.path.abspath(os.path.expanduser(os.environ[name])) for name in names}


def _end(
    process: subprocess.Popen[bytes], pipes: tuple[int, ...], memory: tuple[SharedMemory, ...], folder: HeldFolder
) -> None:
    """End a host with its process group and remove what it left."""
    process.terminate()  # its supervisor ends everything that it started
    with suppress(subprocess.TimeoutExpired):
        process.wait(_PATIENCE_S)
    process.kill()
    process.wait()
    for pipe in pipes:
        with suppress(OSError):
            os.close(pipe)
    for part in memory:
        part.close()
    folder.remove()
