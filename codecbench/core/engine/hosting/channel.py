"""A conversation between two processes: each calls methods of objects that stay in the other one.

Messages are lines of JSON; large data goes through shared memory (`wire`). Only one side works at a time: the other
waits for its answer and meanwhile serves calls itself, as when a host that evaluates asks for frames.
"""

from __future__ import annotations

import fcntl
import importlib
import json
import math
import mmap
import os
import select
import signal
import tempfile
import traceback
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from types import FunctionType, MethodType
from typing import Any, Final
from weakref import WeakValueDictionary

from codecbench.core.contracts import errors
from codecbench.core.engine.hosting.wire import Payload, WireError, pack, unpack
from codecbench.core.engine.text import describe_error

_REMOTE: Final = "codecbench.core.engine.hosting.remote"
_MOST_BYTES: Final = 64 << 20
"""Maximum size of a line."""
_MOST_CALLS: Final = 20
"""Maximum number of nested calls."""
_MARGIN_S: Final = 5
"""A host whose caller has died ends itself this long after its time limit."""
_SEALS: Final = getattr(fcntl, "F_SEAL_SHRINK", 0) | getattr(fcntl, "F_SEAL_SEAL", 0)
"""Seals of shared memory: shrinking it would kill its reader by SIGBUS, and no other seals may be added."""
_LONGEST_TEXT: Final = 4000
LONGEST_TRACE: Final = 20_000
CRASH_FILE: Final = "crash"
"""File in a host's folder with its stack trace if a signal ended it."""

METHODS: Final[dict[str, dict[str, str]]] = {
    "evaluator": {"marks": ""},
    "codec": {
        "open_encoder": "encoder", "open_decoder": "decoder", "encoder": "encoder", "decoder": "decoder",
        "prepared": "codec", "with_params": "codec",
        **dict.fromkeys(("encode", "decode", "decode_partial", "extract", "is_lossless", "is_low_delay",
                         "remark_at", "libraries", "recipes"), ""),
    },
    "encoder": {"push": "", "flush": ""},
    "decoder": {"push": "", "flush": ""},
    "sequence": {"read": ""},
    "coded": {"frame": "", "features": "", "size_bytes": "", "sender": "sender"},
    "sender": {"send": ""},
    "slam_backend": {"run": "", "run_features": ""},
    "link": {"open": "channel"},
    "channel": {"carry": ""},
    "iterator": {"__next__": ""},
    "function": {"__call__": ""},
    "position": {"at": ""},
    "plugins": {"create": "created"},
}  # fmt: skip
"""Methods that may be called on each kind of object, with the kind of object that they return.

An empty kind stands for a plain value.
"""

FACTS: Final[dict[str, tuple[str, ...]]] = {
    "codec": ("name", "version", "capabilities", "carries", "stateless"),
    "sequence": ("name", "timestamps_s", "frame_rate_hz", "channels", "bits", "depth", "camera", "ground_truth",
                 "fingerprint", "notes", "origin", "as_calibrated"),
    "coded": ("packets",),
    "slam_backend": ("name", "architectures"),
    "link": ("name", "delay_s", "keeps_order", "queue"),
}  # fmt: skip
"""Attributes that are sent along with an object."""


class PluginFault(errors.PluginError):
    """Raised if a hosted plugin raises, exits or violates its contract; costs only what was asked of it."""


class PluginLoss(PluginFault):
    """Raised if a plugin's process ended or had to be ended."""


class PluginTimeout(PluginLoss):
    """Raised if a plugin did not answer in time."""


class PluginNonsense(PluginFault):
    """Raised for an answer that codecbench never writes, after which nothing can be understood."""


class Exposed:
    """An object that the other side gets a reference to."""

    def __init__(self, kind: str, value: Any, **facts: Any) -> None:
        self.kind, self.value, self.facts = kind, value, facts


class SharedMemory:
    """Memory behind a descriptor, written by one side and seen by both. It can grow but not shrink."""

    def __init__(self, descriptor: int | None = None) -> None:
        self.descriptor = _new_memory() if descriptor is None else descriptor
        self._map: mmap.mmap | None = None

    def write(self, parts: Payload) -> int:
        """Write the parts one after another from the beginning; return their total size in bytes."""
        size = sum(map(len, parts))
        view = self.view(size)
        at = 0
        for part in parts:
            view[at : at + len(part)] = part
            at += len(part)
        return size

    def view(self, size: int, *, grows: bool = True) -> memoryview:
        """Return the first bytes. Raises WireError if the other side has written less."""
        if self._map is None or len(self._map) < size:
            length = os.fstat(self.descriptor).st_size
            if length < size:
                if not grows:
                    raise WireError(f"{size} bytes in memory of {length}")
                os.ftruncate(self.descriptor, length := max(size, 2 * length))
            if not size:
                return memoryview(bytearray())
            self._map = mmap.mmap(self.descriptor, length)
        return memoryview(self._map)[:size]

    def close(self) -> None:
        self._map = None
        with suppress(OSError):
            os.close(self.descriptor)


def _new_memory() -> int:
    if not hasattr(os, "memfd_create"):
        with tempfile.TemporaryFile() as file:
            return os.dup(file.fileno())
    descriptor = os.memfd_create("codecbench", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, _SEALS)
    return descriptor


class Channel:
    """One end of a conversation. The calling side may also pass functions and iterators.

    reads, writes: descriptors of pipes. sends, receives: shared memory. wait: called with `select.POLLIN` or `POLLOUT`
    before each read and write; raises if the other end is gone. obeys: the other end may call any function of
    codecbench here, which only the process that started this one may. limit_s: time limit of a call at the other end,
    which ends itself long after. depth: number of calls of this side that wait for an answer.
    """

    def __init__(
        self,
        reads: int,
        writes: int,
        sends: SharedMemory,
        receives: SharedMemory,
        wait: Callable[[int, int], None],
        *,
        obeys: bool = False,
    ) -> None:
        self._reads, self._writes, self._sends, self._receives = reads, writes, sends, receives
        self._wait, self.obeys = wait, obeys
        self.limit_s: float | None = None
        self.depth = 0
        self._left = b""
        self._number = self._calls = 0
        self._mine: list[Exposed | None] = []
        self._theirs: WeakValueDictionary[int, Any] = WeakValueDictionary()
        self.dropped: list[int] = []
        """Numbers of remote objects that this side no longer references; sent with the next call."""
        self._raised: list[BaseException] = []
        """Errors sent to the other side during a call, which it may send back."""

    def call(self, target: Any, name: str, *arguments: Any, **words: Any) -> Any:
        """Call a method of a remote object, or a function of codecbench given as `module:name`, and return the result.

        Raises the error that it raises if that is one of codecbench, and PluginFault for anything else.
        """
        self._number += 1
        number, request = self._number, {"call": name, "on": target, "with": list(arguments), "words": words}
        dropped, self.dropped = self.dropped, []
        self._send({"number": number, "limit_s": self.limit_s, "dropped": dropped, **request})
        while True:
            message = self._receive()
            if "call" in message:
                self._serve(message)
                continue
            if message.get("number") != number:
                raise PluginNonsense("it sent an invalid answer")
            if "value" in message:
                return message["value"]
            raise self._error(message, name)

    def forget(self) -> None:
        """Start a new call: errors raised by earlier ones can no longer be sent back."""
        self._raised.clear()

    def serve_forever(self) -> None:
        """Serve calls until the other side is gone."""
        with suppress(EOFError):
            while True:
                self._serve(self._receive())

    def _serve(self, message: dict[str, Any]) -> None:
        number, pid = message.get("number"), os.getpid()
        for dropped in {*(message.get("dropped") or ())} & {*range(len(self._mine))}:
            self._mine[dropped] = None
        if self.obeys and message.get("limit_s"):
            signal.alarm(math.ceil(message["limit_s"]) + _MARGIN_S)
        self._calls += 1
        try:
            if self._calls > _MOST_CALLS:
                raise RecursionError(f"more than {_MOST_CALLS} nested calls")
            answer = {"number": number, "value": self._run_call(message)}
        except BaseException as error:  # noqa: BLE001 - whatever foreign code does becomes the answer
            answer = {"number": number, **self._error_message(error)}
        finally:
            self._calls -= 1
            if os.getpid() != pid:
                os._exit(0)  # a forked copy of this process: one answer is enough
        if self.obeys:
            signal.alarm(0)
        try:
            self._send(answer)
        except (TypeError, ValueError, AttributeError, RecursionError, OSError) as error:
            # Its types cannot be sent, or it is larger than `ulimit -f`, which counts for shared memory too.
            self._send({"number": number, **self._error_message(error)})

    def _run_call(self, message: dict[str, Any]) -> Any:
        name, target, words = str(message.get("call")), message.get("on"), message.get("words") or {}
        arguments = [part.value if isinstance(part, Exposed) else part for part in message.get("with") or ()]
        module, _, function = name.partition(":")
        if function:
            if not self.obeys:
                raise WireError(f"it may not call {name}")
            subject = () if target is None else (target.value if isinstance(target, Exposed) else target,)
            return getattr(importlib.import_module(module), function)(*subject, *arguments, **words)
        if not isinstance(target, Exposed) or name not in METHODS[target.kind]:
            raise WireError(f"{name} is not a method that it may call")
        value, kind = getattr(target.value, name)(*arguments, **words), METHODS[target.kind][name]
        kind = str(arguments[0]) if kind == "created" else kind
        return Exposed(kind, value) if kind in METHODS else value

    def _error_message(self, error: BaseException) -> dict[str, Any]:
        """Convert an error to a message. raised: its number here, which the other side returns as `returned`."""
        known = next((kind.__name__ for kind in type(error).__mro__ if kind.__module__ == errors.__name__), "")
        try:
            text = str(error) if known else describe_error(error)
            trace = "".join(traceback.format_exception(error))
        except Exception as second:  # noqa: BLE001 - the exception may run foreign code to make its message
            text = trace = describe_error(second)
        if isinstance(error, StopIteration):
            known = "StopIteration"
        answer = {"error": known, "text": text[:_LONGEST_TEXT], "trace": trace[-LONGEST_TRACE:]}
        if self.obeys:
            channel, number = getattr(error, "_raised_by", (None, None))
            return {**answer, "returned": number if channel is self else None}
        self._raised.append(error)
        return {**answer, "raised": len(self._raised) - 1}

    def _error(self, message: dict[str, Any], called: str) -> BaseException:
        """Return the error in an answer; if it was one of this side passing through, that very object."""
        returned = message.get("returned")
        if isinstance(returned, int) and 0 <= returned < len(self._raised):
            return self._raised[returned]
        name, text = str(message.get("error") or ""), str(message.get("text", "it sent an invalid answer"))
        if name == "StopIteration" and called == "__next__":  # elsewhere it would silently end a loop here
            return StopIteration()
        error_class: Any = vars(errors).get(name)
        is_known = isinstance(error_class, type) and issubclass(error_class, errors.CodecbenchError)
        error: Any = error_class(text) if is_known and error_class is not errors.PluginError else PluginFault(text)
        error._raised_by = self, message.get("raised")
        if trace := message.get("trace"):
            error.add_note(f"in its host:\n{trace}")
        return error  # type: ignore[no-any-return]

    def refer(self, value: object) -> dict[str, Any] | None:
        """See `wire.Objects`."""
        place = getattr(value, "place", None) if type(value).__module__ == _REMOTE else None
        if place is not None and place[0] is self:
            return {"object": place[1], "owner": "receiver"}
        exposed = value if isinstance(value, Exposed) else None
        if not self.obeys and isinstance(value, Iterator):
            exposed = Exposed("iterator", value)
        elif not self.obeys and isinstance(value, FunctionType | MethodType | partial):
            exposed = Exposed("function", value)
        if exposed is None:
            return None
        key = exposed.kind, id(exposed.value)
        numbers = (n for n, known in enumerate(self._mine) if known and (known.kind, id(known.value)) == key)
        if (number := next(numbers, len(self._mine))) == len(self._mine):
            self._mine.append(exposed)
        facts = {name: getattr(exposed.value, name) for name in FACTS.get(exposed.kind, ())} | exposed.facts
        if exposed.kind == "codec":
            facts["params"] = exposed.value.params.model_dump(mode="json")
        return {"object": number, "owner": "sender", "kind": exposed.kind, "facts": facts}

    def resolve(self, reference: dict[str, Any]) -> Any:
        """See `wire.Objects`."""
        number = reference["object"]
        if reference.get("owner") == "receiver":
            if not (isinstance(number, int) and 0 <= number < len(self._mine) and self._mine[number]):
                raise WireError("it refers to an object that it did not receive")
            return self._mine[number]
        if (remote_object := self._theirs.get(number)) is None:
            make_remote = importlib.import_module(_REMOTE).remote  # here, because it loads all contracts
            remote_object = self._theirs[number] = make_remote(self, number, reference["kind"], reference["facts"])
        return remote_object

    def _send(self, message: dict[str, Any]) -> None:
        payload: Payload = []
        packed = pack(message, self, payload)
        size = self._sends.write(payload)
        content = json.dumps([size, packed]).encode() + b"\n"
        while content:
            self._wait(self._writes, select.POLLOUT)
            content = content[os.write(self._writes, content[: select.PIPE_BUF]) :]

    def _receive(self) -> dict[str, Any]:
        """Return the next message. Raises PluginNonsense, and EOFError if the other side is gone."""
        content = bytearray(self._left)
        while b"\n" not in content[-(1 << 16) :]:
            self._wait(self._reads, select.POLLIN)
            part = os.read(self._reads, 1 << 16)
            if not part:
                raise EOFError("the connection is closed")
            content += part
            if len(content) > _MOST_BYTES:
                raise PluginNonsense(f"its answer has more than {_MOST_BYTES >> 20} MB")
        line, _, rest = bytes(content).partition(b"\n")
        self._left = rest
        try:
            size, packed = json.loads(line)
            message = unpack(packed, self, self._receives.view(size, grows=False))
        except PluginFault:
            raise
        except Exception as error:
            raise PluginNonsense("it sent an invalid answer") from error
        if not isinstance(message, dict):
            raise PluginNonsense("it sent an invalid answer")
        return message
