"""Questions to several companies at once: a host forks a child for each, so that none can harm another's answer.

The host has imported nothing of theirs and has one thread, so forking is safe, and it costs no second interpreter.
"""

from __future__ import annotations

import json
import os
import select
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Final

from codecbench.core.engine.foreign_errors import ended

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

    All children run at once, for at most `limit_s`, and none is left.
    """
    children = {name: _forked(question) for name, question in questions.items()}
    deadline = time.monotonic() + limit_s
    waiting = list(children.values())
    while waiting and time.monotonic() < deadline:
        for child in waiting:
            child.reap()
        ready, _, _ = select.select([child.pipe for child in waiting], [], [], _POLL_S)
        for child in waiting:
            part = os.read(child.pipe, 1 << 16) if child.pipe in ready else b""
            child.content += part
            child.done = child.answered or (child.status is not None and not part)
        waiting = [child for child in waiting if not child.done]
    return {name: _ended(child, limit_s) for name, child in children.items()}


def _forked(question: Callable[[], bytes]) -> _Child:
    reading, writing = os.pipe()
    pid = os.fork()
    if pid:
        os.close(writing)
        return _Child(pid, reading)
    with suppress(BaseException):
        os.setpgid(0, 0)
        os.closerange(3, writing)
        os.closerange(writing + 1, _MOST_DESCRIPTORS)
        content = question()
        while content:
            content = content[os.write(writing, content) :]
    os._exit(0)


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
