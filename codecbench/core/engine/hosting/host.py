"""A host: a process in which the plugins of a company of distributions are imported, constructed and asked.

What comes back is JSON and nothing else, so that no answer can make this process import anything. A host that exits,
is killed, hangs or answers nonsense costs the question that it was asked; the next one starts another host.
"""

from __future__ import annotations

import json
import math
import os
import select
import signal
import subprocess
import sys
import threading
import time
import weakref
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, Final

from codecbench.core.contracts import errors
from codecbench.core.contracts.confinement import confining_words, status_inside, wanted
from codecbench.core.contracts.errors import PluginError
from codecbench.core.contracts.held_folder import HeldFolder
from codecbench.core.engine.foreign_errors import ended

LIMIT_VARIABLE: Final = "CODECBENCH_PLUGIN_TIMEOUT_S"
"""The environment variable that says how long a plugin may take to be imported, constructed or asked."""

HOSTED_VARIABLE: Final = "CODECBENCH_HOSTED"
"""Set in hosts, so that a plugin which calls codecbench when it is imported is not imported again and again."""

FOLDER_PREFIX: Final = "codecbench-host-"
"""How the names of folders begin in which plugins of others are asked."""

_LIMIT_S: Final = 60.0
_MOST_BYTES: Final = 64 << 20
_POLL_S: Final = 0.1
_PROGRAM: Final = """
import json, sys
paths, requests, answers, company, folder = json.loads(sys.argv[1])
sys.path[:] = paths
from codecbench.core.engine.serving import serve
serve(requests, answers, company, folder)
"""


class PluginFault(PluginError):
    """A plugin of another distribution exits, hangs, raises or breaks the contract; it costs that plugin's rows."""


class PluginLoss(PluginFault):
    """Its process ended, or had to be ended."""


class PluginTimeout(PluginLoss):
    """It did not answer in time."""


def limit_s() -> float:
    """How long a host may take for one answer, in seconds."""
    with suppress(ValueError):
        return max(0.1, float(os.environ.get(LIMIT_VARIABLE, _LIMIT_S)))
    return _LIMIT_S


class PluginHost:
    """The process of one company; it is started by the first question, or earlier by `start`."""

    def __init__(self, company: Sequence[str]) -> None:
        self.company = tuple(company)
        self._process: subprocess.Popen[bytes] | None = None
        self._end: Callable[[], Any] = lambda: None
        self._requests = self._answers = -1
        self._lock = threading.Lock()
        self._number = 0

    def start(self) -> None:
        """Start the process without waiting for it."""
        if self._process is not None:
            return
        held = HeldFolder(FOLDER_PREFIX)
        folder = str(held.path)
        confining = confining_words(folder) if wanted() else []
        taken, self._requests = os.pipe()
        self._answers, given = os.pipe()
        paths = [os.path.abspath(path) for path in sys.path]
        self._process = subprocess.Popen(
            [*confining, sys.executable, "-c", _PROGRAM, json.dumps([paths, taken, given, self.company, folder])],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            pass_fds=(taken, given),
            cwd=folder,
            env={**os.environ, **cache_variable(), "TMPDIR": folder, HOSTED_VARIABLE: "1"},
            start_new_session=True,
        )
        os.close(taken)
        os.close(given)
        self._end = weakref.finalize(self, _end, self._process, (self._requests, self._answers), held)

    def ask(
        self, function: Callable[..., Any] | str, arguments: Sequence[Any], *, ours: bool = True, times: float = 1
    ) -> Any:
        """What `function(registry, *arguments)` returns in the host, where `registry` has the company's plugins.

        function: also as `module:name`. ours: codecbench's own plugins are in that registry too. times: how many times
        the usual limit it may take.
        Raises the CodecbenchError that the function raised, PluginTimeout, or PluginFault for anything else that
        happened.
        """
        request = {
            "function": function if isinstance(function, str) else f"{function.__module__}:{function.__qualname__}",
            "arguments": arguments,
            "ours": ours,
            "limit_s": math.ceil(times * limit_s()),
        }
        with self._lock:
            self._number += 1
            request["number"] = self._number
            try:
                self.start()
                answer = self._exchange(json.dumps(request, default=str).encode() + b"\n", times * limit_s())
            except BaseException:
                self.end()
                raise
        if "value" in answer:
            return answer["value"]
        known = getattr(errors, str(answer.get("error") or ""), None)
        if known is None or known is PluginError:
            raise PluginFault(str(answer.get("text", "it answered nonsense")))
        raise known(str(answer["text"]))

    def end(self) -> None:
        """End the process; the next question starts another."""
        self._end()
        self._process, self._end = None, lambda: None

    def _exchange(self, request: bytes, limit_s: float) -> dict[str, Any]:
        deadline = time.monotonic() + limit_s
        with suppress(BrokenPipeError):  # then it has died, which reading finds
            while request:
                _, ready, _ = select.select([], [self._requests], [], max(0.0, deadline - time.monotonic()))
                if not ready:
                    raise PluginTimeout(f"no answer within {limit_s:g} s")
                request = request[os.write(self._requests, request[: select.PIPE_BUF]) :]
        content = bytearray()
        while not content.endswith(b"\n"):
            content += self._read(deadline, limit_s)
            if len(content) > _MOST_BYTES:
                raise PluginFault(f"answered with more than {_MOST_BYTES >> 20} MB")
        with suppress(ValueError):
            answer = json.loads(content)
            if isinstance(answer, dict) and answer.get("number") == self._number:
                return answer
        raise PluginFault("it answered nonsense")

    def _read(self, deadline: float, limit_s: float) -> bytes:
        """What the host has written since; waits for it. Raises PluginFault where it is gone or late."""
        assert self._process is not None
        while True:
            gone = self._process.poll()
            ready, _, _ = select.select([self._answers], [], [], 0 if gone is not None else _POLL_S)
            if ready and (part := os.read(self._answers, 1 << 16)):
                return part
            if ready or gone is not None:
                raise PluginLoss(_death(self._process))
            if time.monotonic() > deadline:
                raise PluginTimeout(f"no answer within {limit_s:g} s")


def cache_variable() -> dict[str, str]:
    """The environment variables of where compiled kernels are, so that they mean the same in another folder."""
    names = {"CODECBENCH_CACHE", "CODECBENCH_KERNELS"} & os.environ.keys()
    return {name: os.path.abspath(os.path.expanduser(os.environ[name])) for name in names}


def _death(process: subprocess.Popen[bytes]) -> str:
    try:
        status = process.wait(1.0)
    except subprocess.TimeoutExpired:
        return "it closed the connection of its process"
    return ended(status_inside(status) if wanted() else status)


def _end(process: subprocess.Popen[bytes], pipes: tuple[int, ...], folder: HeldFolder) -> None:
    """Kill a host with its process group and remove what it left."""
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    for pipe in pipes:
        with suppress(OSError):
            os.close(pipe)
    folder.remove()
