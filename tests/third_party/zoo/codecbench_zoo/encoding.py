"""Codecs that misbehave in `encode`."""

from __future__ import annotations

import ctypes
import os
import signal
import sys
import time
from contextlib import suppress
from typing import Any

import numpy as np

from codecbench import NULL_TRACE, Image, Trace, Unsupported
from codecbench_zoo.tame import TameCodec


class _Encoder(TameCodec):
    def encode(self, image: Image, *, trace: Trace = NULL_TRACE) -> Any:
        return self.made(image, super().encode(image))

    def made(self, image: Image, bitstream: bytes) -> Any:
        raise NotImplementedError


class Segfaults(_Encoder):
    def made(self, image: Image, bitstream: bytes) -> Any:
        return ctypes.string_at(0)


class KillsItself(_Encoder):
    def made(self, image: Image, bitstream: bytes) -> Any:
        os.kill(os.getpid(), signal.SIGKILL)


class KillsItsParent(_Encoder):
    def made(self, image: Image, bitstream: bytes) -> Any:
        os.kill(os.getppid(), signal.SIGKILL)
        time.sleep(3600)


class Terminates(_Encoder):
    def made(self, image: Image, bitstream: bytes) -> Any:
        os.kill(os.getpid(), signal.SIGTERM)
        return bitstream


class Aborts(_Encoder):
    def made(self, image: Image, bitstream: bytes) -> Any:
        os.abort()


class Stops(_Encoder):
    def made(self, image: Image, bitstream: bytes) -> Any:
        os.kill(os.getpid(), signal.SIGSTOP)


class Sleeps(_Encoder):
    def made(self, image: Image, bitstream: bytes) -> Any:
        time.sleep(3600)


class LeavesWell(_Encoder):
    def made(self, image: Image, bitstream: bytes) -> Any:
        os._exit(0)


class LeavesLikeOurs(_Encoder):
    """Leaves with the status with which our workers ask for a fresh one."""

    def made(self, image: Image, bitstream: bytes) -> Any:
        os._exit(86)


class LeavesAnHeir(_Encoder):
    """Leaves while another process holds all that it held."""

    def made(self, image: Image, bitstream: bytes) -> Any:
        if os.fork() == 0:
            time.sleep(3600)
        os._exit(3)


class ExitsLate(_Encoder):
    def made(self, image: Image, bitstream: bytes) -> Any:
        sys.exit(0)


class Interrupts(_Encoder):
    def made(self, image: Image, bitstream: bytes) -> Any:
        raise KeyboardInterrupt


class StopsTheGenerator(_Encoder):
    def made(self, image: Image, bitstream: bytes) -> Any:
        raise GeneratorExit("no more")


class StopsIteration(_Encoder):
    def made(self, image: Image, bitstream: bytes) -> Any:
        raise StopIteration("no more")


class _Private(BaseException):
    """Neither pickles nor is an Exception."""

    def __reduce__(self) -> Any:
        raise TypeError("stays here")


class RaisesOfItsOwn(_Encoder):
    def made(self, image: Image, bitstream: bytes) -> Any:
        raise _Private("of its own kind")


class _Silent(Exception):
    def __str__(self) -> str:
        raise ValueError("no words")

    __repr__ = __str__


class RaisesUntold(_Encoder):
    def made(self, image: Image, bitstream: bytes) -> Any:
        raise _Silent


class RaisesMuch(_Encoder):
    def made(self, image: Image, bitstream: bytes) -> Any:
        raise ValueError("\x1b[31m\x00" + "a" * 5_000_000)


class RaisesInCircles(_Encoder):
    def made(self, image: Image, bitstream: bytes) -> Any:
        first, second = ValueError("first"), ValueError("second")
        first.__cause__, second.__cause__ = second, first
        raise first


class Declines(_Encoder):
    def made(self, image: Image, bitstream: bytes) -> Any:
        raise Unsupported("not on a Sunday")


class Recurses(_Encoder):
    def made(self, image: Image, bitstream: bytes) -> Any:
        return self.made(image, bitstream)


class Hogs(_Encoder):
    def made(self, image: Image, bitstream: bytes) -> Any:
        return b"".join([bytes(64 << 20) for _ in range(64)])


class HogsInChildren(_Encoder):
    """Takes its memory where the limit of its own process does not count it."""

    def made(self, image: Image, bitstream: bytes) -> Any:
        for _ in range(4):
            if os.fork() == 0:
                room = np.ones(120 << 20, np.uint8)
                time.sleep(3600)
                os._exit(int(room[0]))
        time.sleep(3600)


class ReturnsNone(_Encoder):
    def made(self, image: Image, bitstream: bytes) -> Any:
        return None


class ReturnsText(_Encoder):
    def made(self, image: Image, bitstream: bytes) -> Any:
        return "bits"


class ReturnsView(_Encoder):
    def made(self, image: Image, bitstream: bytes) -> Any:
        return memoryview(bitstream)


class ReturnsBytearray(_Encoder):
    def made(self, image: Image, bitstream: bytes) -> Any:
        return bytearray(bitstream)


class ReturnsNothing(_Encoder):
    def made(self, image: Image, bitstream: bytes) -> Any:
        return b""


class _Light(bytes):
    def __len__(self) -> int:
        return 1


class ReturnsLight(_Encoder):
    """Bytes that say that they are one byte."""

    def made(self, image: Image, bitstream: bytes) -> Any:
        return _Light(bitstream)


class Forks(_Encoder):
    """Comes back twice."""

    def made(self, image: Image, bitstream: bytes) -> Any:
        os.fork()
        return bitstream


class ClosesEverything(_Encoder):
    def made(self, image: Image, bitstream: bytes) -> Any:
        os.closerange(3, 4096)
        return bitstream


class ClosesAndStays(_Encoder):
    def made(self, image: Image, bitstream: bytes) -> Any:
        os.closerange(3, 4096)
        time.sleep(3600)


class AnswersForUs(_Encoder):
    """Writes into every descriptor that it finds."""

    times = 1

    def made(self, image: Image, bitstream: bytes) -> Any:
        for _ in range(self.times):
            for descriptor in range(3, 32):
                with suppress(OSError):
                    os.write(descriptor, b"not what you are waiting for" * 2000 + b"\n" * (self.times == 1))
        return bitstream


class AnswersWithoutEnd(AnswersForUs):
    times = 1300


class FillsThePipe(_Encoder):
    """Prints more than anybody wants to keep."""

    def made(self, image: Image, bitstream: bytes) -> Any:
        for _ in range(200):
            os.write(1, b"\x1b[2J" + b"x" * (1 << 20))
        return bitstream
