"""Communicate with a child process line by line, with time limits."""

from __future__ import annotations

import json
import os
import selectors
import signal
import subprocess
import time
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from codecbench.core.contracts.errors import SlamError

_LOG_TAIL_CHARS = 300


class ChildProcess:
    """A child process that answers each request with one line of JSON; use it as a context manager.

    log: the file that the child prints to; error messages quote its end. Leaving the context kills the child.
    """

    def __init__(self, command: list[str], log: Path, name: str) -> None:
        self._log = log
        self._name = name
        self._rest = b""
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0)
        self._selector = selectors.DefaultSelector()
        assert self._process.stdout is not None
        self._selector.register(self._process.stdout, selectors.EVENT_READ)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.kill()
        self._process.wait()
        self._selector.close()
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                stream.close()

    def send(self, request: dict[str, Any], payload: bytes = b"") -> None:
        """Send a request and its bytes. Raises SlamError if the child has ended."""
        assert self._process.stdin is not None
        content = memoryview(json.dumps(request).encode() + b"\n" + payload)
        try:
            while content:
                content = content[self._process.stdin.write(content) :]
        except BrokenPipeError:
            raise SlamError(self._describe_exit()) from None

    def receive(self, timeout_s: float, doing: str) -> dict[str, Any]:
        """The next answer. Raises SlamError if none comes in time or the child ends."""
        deadline = time.monotonic() + timeout_s
        assert self._process.stdout is not None
        while b"\n" not in self._rest:
            if not self._selector.select(max(deadline - time.monotonic(), 0.0)):
                raise SlamError(
                    f"{self._name} did not reply within {timeout_s:g} s, {doing}; {self._describe_output()}"
                )
            piece = os.read(self._process.stdout.fileno(), 1 << 16)
            if not piece:
                raise SlamError(f"{self._describe_exit()}, {doing}; {self._describe_output()}")
            self._rest += piece
        line, _, self._rest = self._rest.partition(b"\n")
        answer: dict[str, Any] = json.loads(line)
        return answer

    def _describe_exit(self) -> str:
        code = self._process.wait(timeout=10.0)
        how = f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with exit status {code}"
        advice = " (out of memory: raise the run's memory_mb)" if "bad_alloc" in self._output() else ""
        return f"{self._name} {how}{advice}"

    def _describe_output(self) -> str:
        return f"its last output: {' | '.join(self._output().split(chr(10)))[-_LOG_TAIL_CHARS:].strip() or 'none'}"

    def _output(self) -> str:
        return self._log.read_text(errors="replace") if self._log.exists() else ""
