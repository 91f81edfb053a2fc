"""Questions to several companies at once: a child is forked for each, so that none can harm another's answer.

Whoever forks has imported nothing of theirs and has one thread, so forking is safe; it costs no second interpreter. The
program itself forks one child, the scout, which forks the others.
"""

from __future__ import annotations

import ctypes
import importlib
import json
import os
import select
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from codecbench.core.contracts.confinement import wanted
from codecbench.core.contracts.errors import PluginError
from codecbench.core.contracts.held_folder import HeldFolder
from codecbench.core.engine.foreign_errors import ended
from codecbench.core.engine.hosting.host import FOLDER_PREFIX, HOSTED_VARIABLE, PluginHost, cache_variable

_SERVING: Final = "codecbench.core.engine.serving"
_PR_SET_PDEATHSIG: Final = 1
_POLL_S: Final = 0.05
_SCOUT_TIMES: Final = 3
"""A scout may ask twice, and needs some time itself."""
_GRACE_S: Final = 2.0
"""A scout that has to go gets so long to end its children."""
_MOST_DESCRIPTORS: Final = 1024
_ENDING: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@dataclass
class _Child:
    pid: int
    pipe: int
    content: bytearray = field(default_factory=bytearray)
    status: int | None = None
    done: bool = False

    @property
    def answered(self) -> bool:
        return self.content.endswith(b"\n")

    def reap(self) -> None:
        with suppress(ChildProcessError):
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self.status = os.waitstatus_to_exitcode(status)


class Scout:
    """Finds out what distributions offer while this process goes on: a child where forking is safe, or else a host.

    A context manager, which leaves nobody behind.
    """

    def __init__(self, companies: Sequence[str], limit_s: float) -> None:
        self._arguments = (list(companies), limit_s)
        self._limit_s = _SCOUT_TIMES * limit_s
        self._host: PluginHost | None = None
        if wanted() or not is_single_threaded():
            self._host = PluginHost(())
            self._host.start()
        else:
            self._folder = HeldFolder(FOLDER_PREFIX)
            self._child = _forked(self._scouted, self._folder.path)

    def answers(self) -> dict[str, Any]:
        """What each distribution offers, or `error` and `text`; call it once. Raises PluginError where it fails."""
        if self._host is not None:
            return dict(self._host.ask(f"{_SERVING}:scouted", self._arguments, ours=False, times=_SCOUT_TIMES))
        _wait([self._child], time.monotonic() + self._limit_s)
        answer = _answered(self._child, self._limit_s)
        if "value" not in answer:
            raise PluginError(str(answer.get("text")))
        return dict(answer["value"])

    def __enter__(self) -> Scout:
        return self

    def __exit__(self, *_: object) -> None:
        if self._host is not None:
            self._host.end()
            return
        deadline = time.monotonic() + _GRACE_S
        while not self._child.done and self._child.status is None and time.monotonic() < deadline:
            os.kill(self._child.pid, signal.SIGTERM)
            time.sleep(_POLL_S)
            self._child.reap()
        _end(self._child)
        self._folder.remove()

    def _scouted(self) -> bytes:
        signal.signal(signal.SIGTERM, lambda *_: sys.exit())  # which ends its children on the way
        return bytes(importlib.import_module(_SERVING).scouted_line(*self._arguments))


def answers_of_children(questions: dict[str, Callable[[], bytes]], limit_s: float) -> dict[str, dict[str, Any]]:
    """Each question's answer, a line of JSON, made in a child of its own; `error` and `text` where there is none.

    All children run at once, for at most `limit_s`, in a folder of their own, and none is left.
    """
    with HeldFolder(FOLDER_PREFIX) as folder:
        children: dict[str, _Child] = {}
        try:
            for name, question in questions.items():
                children[name] = _forked(question, folder.path)
            _wait(list(children.values()), time.monotonic() + limit_s)
        finally:
            for child in children.values():
                _end(child)
    return {name: _answered(child, limit_s) for name, child in children.items()}


def is_single_threaded() -> bool:
    """Whether this process has one thread, those of libraries counted; False where the system does not tell."""
    try:
        return len(os.listdir("/proc/self/task")) == 1
    except OSError:
        return False


def _wait(waiting: list[_Child], deadline: float) -> None:
    """Read what children write until all have answered or ended, or it is too late."""
    while waiting and time.monotonic() < deadline:
        for child in waiting:
            child.reap()
        ready, _, _ = select.select([child.pipe for child in waiting], [], [], _POLL_S)
        for child in waiting:
            part = os.read(child.pipe, 1 << 16) if child.pipe in ready else b""
            child.content += part
            child.done = child.answered or (child.status is not None and not part)
        waiting = [child for child in waiting if not child.done]


def _forked(question: Callable[[], bytes], folder: Path) -> _Child:
    reading, writing = os.pipe()
    asker = os.getpid()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _ENDING)  # none may end the child as if it were its parent
    pid = os.fork()
    if pid:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        os.close(writing)
        return _Child(pid, reading)
    with suppress(BaseException):
        os.setsid()
        _die_with_parent(asker)
        for number in _ENDING:
            signal.signal(number, signal.SIG_DFL)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        os.closerange(3, writing)
        os.closerange(writing + 1, _MOST_DESCRIPTORS)
        _settle(folder)
        content = question()
        while content:
            content = content[os.write(writing, content) :]
    os._exit(0)


def _die_with_parent(parent: int) -> None:
    """End this process when the one that asks it ends."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(0)


def _settle(folder: Path) -> None:
    """Leave the folder and the terminal of whoever runs codecbench."""
    nothing = os.open(os.devnull, os.O_RDWR)
    for descriptor in range(3):
        os.dup2(nothing, descriptor)
    sys.path[:] = [os.path.abspath(path) for path in sys.path]
    os.environ.update(cache_variable(), TMPDIR=str(folder), **{HOSTED_VARIABLE: "1"})
    tempfile.tempdir = str(folder)
    os.chdir(folder)


def _end(child: _Child) -> None:
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(child.pid, signal.SIGKILL)
    with suppress(ProcessLookupError, PermissionError):
        os.kill(child.pid, signal.SIGKILL)
    with suppress(ChildProcessError):
        os.waitpid(child.pid, 0)
    os.close(child.pipe)


def _answered(child: _Child, limit_s: float) -> dict[str, Any]:
    with suppress(ValueError):
        answer = json.loads(child.content)
        if isinstance(answer, dict):
            return answer
    if child.status is None:
        return {"error": "", "text": f"no answer within {limit_s:g} s"}
    if child.content:
        return {"error": "", "text": "it answered nonsense"}
    return {"error": "", "text": ended(child.status)}
