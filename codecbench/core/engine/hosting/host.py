"""A host: a process in which the plugins of one distribution are imported, constructed and asked, in one role.

Plugins of other distributions than codecbench's run in hosts and nowhere else. What comes back is JSON and bytes, so
that no answer can make this process import or call anything. A host that exits, is killed, hangs or answers nonsense
costs what it was asked. Its roles keep apart what must not know of each other: who decodes never saw what was encoded.
A host has a parent, its supervisor, because a plugin may end its parent; what it started ends with it.
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
"""The environment variable that says how long a plugin may take to be imported, constructed or described."""

HOSTED_VARIABLE: Final = "CODECBENCH_HOSTED"
"""Set in hosts, so that a plugin which calls codecbench when it is imported is not imported again and again."""

FOLDER_PREFIX: Final = "codecbench-host-"
"""How the names of folders begin in which plugins of others are asked."""

_SERVE: Final = "codecbench.core.engine.plugins.serving:serve"
_LIMIT_S: Final = 60.0
_POLL_MS: Final = 100
_PATIENCE_S: Final = 1.0
_MOST_LATE: Final = 1000
"""So often is something read of an answer that is late."""


def limit_s() -> float:
    """How long a host may take for one description, in seconds."""
    with suppress(ValueError):
        return max(0.1, float(os.environ.get(LIMIT_VARIABLE, _LIMIT_S)))
    return _LIMIT_S


class Host:
    """The process of one distribution, by its name with its version, in one role; started by the first question.

    limit_s: how long an answer may take, None where whoever asks is watched itself. prints: what its plugins print goes
    where this process prints, and not nowhere, if it is not confined.
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
        held = HeldFolder(FOLDER_PREFIX)
        self._folder = held.path
        folder = str(held.path)
        if confines := is_confinement_requested():
            confinement()
        taken, writes = os.pipe()
        reads, given = os.pipe()
        sends, receives = SharedMemory(), SharedMemory()
        descriptors = (taken, given, receives.descriptor, sends.descriptor)
        printed = None if self._prints and not confines else subprocess.DEVNULL
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
            stdout=printed,
            stderr=printed,
            pass_fds=descriptors,
            cwd=folder,
            env={**os.environ, **cache_variable(), "TMPDIR": folder, HOSTED_VARIABLE: "1"},
            start_new_session=True,
        )
        os.close(taken)
        os.close(given)
        left_running.add(self._process.pid)
        self._channel = _HostChannel(self, reads, writes, sends, receives)
        self._end = weakref.finalize(self, _end, self._process, (reads, writes), (sends, receives), held)

    def ask(
        self, function: Callable[..., Any] | str, *arguments: Any, times: float = 1, shows: Collection[str] = ()
    ) -> Any:
        """What `function(*arguments)` returns there. function: of codecbench, also as `module:name`.

        times: how many times the usual limit it may take. shows: paths that it is to see if it is confined; it is
        started anew for one that it does not see. Raises the CodecbenchError that the function raised, PluginTimeout,
        or PluginFault for anything else that happened.
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
        """End the process with all that it started; the next question starts another."""
        if self._process is not None:
            left_running.discard(self._process.pid)
        self._end()
        self._process, self._channel, self._end = None, None, lambda: None

    @contextmanager
    def answering(self, channel: _HostChannel) -> Iterator[None]:
        """Until when an answer has to come, and what becomes of this host where none comes."""
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
        """Return when there is something to read or room to write. Raises PluginLoss where the process is gone or late.

        What is there in time is read, also by who comes late, but not what goes on coming.
        """
        assert self._process is not None
        assert self._channel is not None
        poll = select.poll()
        poll.register(descriptor, event)
        while True:
            gone = self._process.poll() is not None
            late = self._deadline is not None and time.monotonic() > self._deadline
            self._late += late
            if poll.poll(0 if gone or late else _POLL_MS) and self._late < _MOST_LATE:
                return
            if late:
                raise PluginTimeout(f"no answer within {self._channel.limit_s:g} s")
            if gone:
                raise self._loss()

    def _loss(self) -> PluginLoss:
        """How the process ended, and where it was then."""
        assert self._process is not None
        try:
            status = self._process.wait(1.0)
            loss = PluginLoss(describe_exit(128 - status if status > 128 else status))
        except subprocess.TimeoutExpired:
            return PluginLoss("it closed the connection of its process")
        with suppress(OSError), open(self._folder / CRASH_FILE, errors="replace", opener=open_plain) as file:
            if trace := file.read(LONGEST_TRACE):
                loss.add_note(f"in its host:\n{trace}")
        return loss


class _HostChannel(Channel):
    """The end of a conversation that asks a host."""

    def __init__(self, host: Host, reads: int, writes: int, sends: SharedMemory, receives: SharedMemory) -> None:
        super().__init__(reads, writes, sends, receives, host.wait)
        self._host = host  # which lives as long as an object of its process is known

    def call(self, target: Any, name: str, *arguments: Any, **words: Any) -> Any:
        with self._host.answering(self):
            self.depth += 1
            try:
                return super().call(target, name, *arguments, **words)
            finally:
                self.depth -= 1


def cache_variable() -> dict[str, str]:
    """The environment variables of where compiled kernels are, so that they mean the same in another folder."""
    names = {"CODECBENCH_CACHE", "CODECBENCH_KERNELS"} & os.environ.keys()
    return {name: os.path.abspath(os.path.expanduser(os.environ[name])) for name in names}


def _end(
    process: subprocess.Popen[bytes], pipes: tuple[int, ...], memory: tuple[SharedMemory, ...], folder: HeldFolder
) -> None:
    """End a host with its process group and remove what it left."""
    process.terminate()  # its supervisor ends it with all that it started
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
