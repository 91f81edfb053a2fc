"""Codecs that misbehave when they are constructed, or when they are asked what they are."""

from __future__ import annotations

import math
import os
import signal
import sys
import time
from typing import Any

import numpy as np

from codecbench import NULL_TRACE, Capabilities, Codec, Image, NoParams, Params, Trace
from codecbench_zoo.tame import TameCodec


class Exits(TameCodec):
    def __init__(self, params: NoParams) -> None:
        sys.exit(0)


class Leaves(TameCodec):
    def __init__(self, params: NoParams) -> None:
        os._exit(0)


class Raises(TameCodec):
    def __init__(self, params: NoParams) -> None:
        raise KeyboardInterrupt("as if somebody had pressed it")


class StopsIterating(TameCodec):
    def __init__(self, params: NoParams) -> None:
        raise StopIteration


class Dies(TameCodec):
    def __init__(self, params: NoParams) -> None:
        os.kill(os.getpid(), signal.SIGKILL)


class Hangs(TameCodec):
    def __init__(self, params: NoParams) -> None:
        time.sleep(3600)


class Mumbles(TameCodec):
    """Raises an exception that cannot be told."""

    def __init__(self, params: NoParams) -> None:
        class Untold(Exception):
            def __str__(self) -> str:
                raise ValueError("no words")

        raise Untold


class Screams(TameCodec):
    def __init__(self, params: NoParams) -> None:
        raise ValueError("\x1b[31m" + "a" * 5_000_000)


class Twins(TameCodec):
    """Goes on in two processes."""

    def __init__(self, params: NoParams) -> None:
        super().__init__(params)
        os.fork()


class Babbles(TameCodec):
    """Answers in the place of codecbench on every descriptor that it finds."""

    def __init__(self, params: NoParams) -> None:
        super().__init__(params)
        for descriptor in range(3, 64):
            try:
                os.write(descriptor, b'{"value": {"version": "1", "params": {}}}\n')
            except OSError:
                continue


class Slams(TameCodec):
    """Closes the connection to who asks."""

    def __init__(self, params: NoParams) -> None:
        super().__init__(params)
        os.closerange(3, 1024)


class Printed(TameCodec):
    """Talks to the terminal of whoever constructs it."""

    def __init__(self, params: NoParams) -> None:
        super().__init__(params)
        os.write(1, b"hello from a codec\n" * 1000)


class Vague(Codec[Any]):
    """Has no capabilities."""

    name, version, params_type = "vague", "1", NoParams

    def encode(self, image: Image, *, trace: Trace = NULL_TRACE) -> bytes:
        return b"?"

    def decode(self, bitstream: bytes, *, trace: Trace = NULL_TRACE) -> Any:
        return None


class Unfinished(Codec[Any]):
    """Cannot decode."""

    name, version, params_type, capabilities = "unfinished", "1", NoParams, Capabilities()

    def encode(self, image: Image, *, trace: Trace = NULL_TRACE) -> bytes:
        return b"?"


class Stranger:
    """No codec at all."""

    name = "stranger"


class Renamed(TameCodec):
    pass


Renamed.name = "jpeg"


class Odd(TameCodec):
    version = 2.5  # type: ignore[assignment]


class Boastful(TameCodec):
    capabilities = "everything"  # type: ignore[assignment]


class Colorless(TameCodec):
    """Takes no layout."""

    capabilities = Capabilities(channels=())


class Formless(TameCodec):
    params_type = None  # type: ignore[assignment]


class _NotANumber(Params):
    quality: float = math.nan


class BadDefault(TameCodec):
    """Has a default that its own parameters do not allow."""

    params_type = _NotANumber


class _Objects(Params, arbitrary_types_allowed=True):
    table: Any = np.zeros(3)


class Tabular(TameCodec):
    """Has a parameter that is no JSON."""

    params_type = _Objects


class _Endless(Params):
    def identity(self) -> dict[str, Any]:
        return {"quality": math.inf}


class Unidentified(TameCodec):
    """Is told apart by a number that has no spelling."""

    params_type = _Endless


class _Moody(Params):
    tables: list[int] = [1, 2]

    def identity(self) -> dict[str, Any]:
        self.tables.append(time.monotonic_ns())
        return super().identity()


class Moody(TameCodec):
    """Is another setting each time that it is asked."""

    params_type = _Moody


class Bloated(TameCodec):
    """Is of a version of ten thousand letters with control characters among them."""

    version = "1\x1b[2J\n" * 2000
