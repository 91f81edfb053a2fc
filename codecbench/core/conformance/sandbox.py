"""A sandbox process for calls that may crash, hang, exit or exhaust memory without harm.

It is spawned, not forked, so it has nothing that an encoder left behind in this process.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import resource
import signal
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from multiprocessing.connection import Connection
from typing import Any, Literal

import psutil

from codecbench.core.contracts.errors import BitstreamError, CodecbenchError, Unsupported

Verb = Literal["encode", "decode"]
_START_TIMEOUT_S = 60.0
_MEBIBYTE = 1 << 20


@dataclass(frozen=True)
class Reply:
    """Result of a call."""

    status: Literal["done", "refused", "unsupported", "raised", "crashed", "hung", "out_of_memory"]
    """`refused` is a BitstreamError, `unsupported` an Unsupported; all others but `done` are faults."""
    value: Any = None
    """The return value, if `done`."""
    reason: str = ""
    """Text of the error or fault."""


class Sandbox:
    """A process that is started when first needed, and again after it died."""

    def __init__(self, *, may_start_others: bool = False) -> None:
        """may_start_others: whether calls may use sandboxes themselves; the owner then has to stop this one."""
        self._may_start_others = may_start_others
        self._process: Any = None
        self._connection: Connection | None = None

    def call(self, function: Callable[..., Any], *arguments: Any, timeout_s: float, memory_mb: int) -> Reply:
        """Call a module's function in the process; function, arguments and result must be picklable.

        `memory_mb` is how much the process may allocate beyond what it has already.
        """
        if self._connection is None:
            self._start()
        assert self._connection is not None
        with suppress(EOFError, ConnectionError):
            self._connection.send((function, arguments, memory_mb))
            for limit_s in (_START_TIMEOUT_S, timeout_s):  # importing the codec's module has its own limit
                if not self._connection.poll(limit_s):
                    self.stop()
                    return Reply("hung", reason=f"no answer within {limit_s:g} s")
                reply: Reply | None = self._connection.recv()
                if reply is not None:
                    return reply
        return Reply("crashed", reason=_death(self.stop()))

    def stop(self) -> int | None:
        """End the process and all its children, and return its exit code."""
        if self._process is None:
            return None
        if self._connection is not None:
            self._connection.close()
        children: list[psutil.Process] = []
        with suppress(psutil.NoSuchProcess):
            children = psutil.Process(self._process.pid).children(recursive=True)
        self._process.join(0.5)
        self._process.kill()
        self._process.join()
        for process in children:
            with suppress(psutil.NoSuchProcess):
                process.kill()
        code: int | None = self._process.exitcode
        self._process = self._connection = None
        return code

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._connection, child_end = context.Pipe()
        self._process = context.Process(target=_serve, args=(child_end,), daemon=not self._may_start_others)
        self._process.start()
        child_end.close()


@cache
def sandbox(verb: Verb) -> Sandbox:
    """Return the sandbox for encoding, or that for decoding, which never sees what an encoder saw."""
    return Sandbox()


def _serve(connection: Connection) -> None:
    with open(os.devnull, "wb") as devnull:
        for stream in (1, 2):
            os.dup2(devnull.fileno(), stream)  # C libraries print warnings there for every damaged bitstream
    while True:
        try:
            request = connection.recv()
        except EOFError:
            return
        except BaseException as error:  # noqa: BLE001 - importing the codec's module may raise anything
            reason = f"the codec's module does not import in another process: {type(error).__name__}: {error}"
            connection.send(Reply("raised", reason=reason))
            continue
        connection.send(None)
        reply = _answer(*request)
        try:
            connection.send(reply)
        except (pickle.PicklingError, TypeError, AttributeError) as error:
            connection.send(Reply("raised", reason=f"its result cannot be passed to another process: {error}"))


def _answer(function: Callable[..., Any], arguments: tuple[Any, ...], memory_mb: int) -> Reply:
    try:
        with _memory_limit(memory_mb):
            return Reply("done", function(*arguments))
    except BitstreamError as error:
        return Reply("refused", reason=str(error))
    except Unsupported as error:
        return Reply("unsupported", reason=str(error))
    except MemoryError:
        return Reply("out_of_memory", reason=f"more than {memory_mb} MiB")
    except CodecbenchError as error:
        return Reply("raised", reason=f"{type(error).__name__}: {error}")
    except (SystemExit, KeyboardInterrupt) as error:
        return Reply("raised", reason=f"{error!r}, which ends programs")
    except BaseException:  # noqa: BLE001 - whatever a codec raises is what the caller wants to know
        return Reply("raised", reason=traceback.format_exc(limit=-3).strip())


def _death(code: int | None) -> str:
    if code is not None and code < 0:
        with suppress(ValueError):
            return f"the process was killed by {signal.Signals(-code).name}"
    return f"the process exited with status {code}"


@contextmanager
def _memory_limit(memory_mb: int) -> Iterator[None]:
    """Cap the address space at what is mapped now plus `memory_mb`."""
    mapped = psutil.Process().memory_info().vms
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (mapped + memory_mb * _MEBIBYTE, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
