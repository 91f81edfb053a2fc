"""Questions to several companies at once: a child is forked for each, so that none can harm another's answer.

Whoever forks has imported nothing of theirs and has one thread, so forking is safe; it costs no second interpreter.
"""

from __future__ import annotations

import json
import os
import select
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Final

from codecbench.core.engine.foreign_errors import ended
from codecbench.core.engine.hosting.host import HOSTED_VARIABLE, cache_variable

_POLL_S: Final = 0.05
_MOST_DESCRIPTORS: Final = 1024


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


def answers_of_children(questions: dict[str, Callable[[], bytes]], limit_s: float) -> dict[str, dict[str, Any]]:
    """Each question's answer, a line of JSON, made in a child of its own; `error` and `text` where there is none.

    All children run at once, for at most `limit_s`, in a folder of their own, and none is left.
    """
    with tempfile.TemporaryDirectory(prefix="codecbench-host-", ignore_cleanup_errors=True) as folder:
        children = {name: _forked(question, folder) for name, question in questions.items()}
        try:
            _wait(list(children.values()), time.monotonic() + limit_s)
        finally:
            answers = {name: _ended(child, limit_s) for name, child in children.items()}
    return answers


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


def _forked(question: Callable[[], bytes], folder: str) -> _Child:
    reading, writing = os.pipe()
    pid = os.fork()
    if pid:
        os.close(writing)
        return _Child(pid, reading)
    with suppress(BaseException):
        os.setsid()
        os.closerange(3, writing)
        os.closerange(writing + 1, _MOST_DESCRIPTORS)
        _settle(folder)
        content = question()
        while content:
            content = content[os.write(writing, content) :]
    os._exit(0)


def _settle(folder: str) -> None:
    """Leave the folder and the terminal of whoever runs codecbench."""
    nothing = os.open(os.devnull, os.O_RDWR)
    for descriptor in range(3):
        os.dup2(nothing, descriptor)
    sys.path[:] = [os.path.abspath(path) for path in sys.path]
    os.environ.update(cache_variable(), TMPDIR=folder, **{HOSTED_VARIABLE: "1"})
    tempfile.tempdir = None
    os.chdir(folder)


def _ended(child: _Child, limit_s: float) -> dict[str, Any]:
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(child.pid, signal.SIGKILL)
    with suppress(ProcessLookupError, PermissionError):
        os.kill(child.pid, signal.SIGKILL)
    with suppress(ChildProcessError):
        os.waitpid(child.pid, 0)
    os.close(child.pipe)
    with suppress(ValueError):
        answer = json.loads(child.content)
        if isinstance(answer, dict):
            return answer
    if child.status is None:
        return {"error": "", "text": f"no answer within {limit_s:g} s"}
    if child.content:
        return {"error": "", "text": "it answered nonsense"}
    return {"error": "", "text": ended(child.status)}
