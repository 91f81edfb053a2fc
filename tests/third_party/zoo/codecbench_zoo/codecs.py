"""Codecs that misbehave when they are constructed, asked or run."""

from __future__ import annotations

import ctypes
import os
import shutil
import sys
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from codecbench import NULL_TRACE, Capabilities, Codec, Image, NoParams, Trace


class _Plain(Codec[NoParams]):
    """Keeps the upper half of each sample."""

    version = "1"
    params_type = NoParams
    capabilities = Capabilities(channels=(1,))

    def encode(self, image: Image, *, trace: Trace = NULL_TRACE) -> bytes:
        self.misbehave()
        height, width = image.shape
        return height.to_bytes(2, "big") + width.to_bytes(2, "big") + (image & 0xF0).tobytes()

    def decode(self, bitstream: bytes, *, trace: Trace = NULL_TRACE) -> Image:
        shape = int.from_bytes(bitstream[:2], "big"), int.from_bytes(bitstream[2:4], "big")
        return np.frombuffer(bitstream[4:], np.uint8).reshape(shape).copy()

    def misbehave(self) -> None:
        pass


class Exits(_Plain):
    name = "exits"

    def __init__(self, params: NoParams) -> None:
        sys.exit(0)


class Leaves(_Plain):
    name = "leaves"

    def __init__(self, params: NoParams) -> None:
        os._exit(0)


class Raises(_Plain):
    name = "raises"

    def __init__(self, params: NoParams) -> None:
        raise KeyboardInterrupt("as if somebody had pressed it")


class Hangs(_Plain):
    name = "hangs"

    def __init__(self, params: NoParams) -> None:
        time.sleep(3600)


class Vague(Codec[NoParams]):
    """Has no capabilities."""

    name, version, params_type = "vague", "1", NoParams

    def encode(self, image: Image, *, trace: Trace = NULL_TRACE) -> bytes:
        return b"?"

    def decode(self, bitstream: bytes, *, trace: Trace = NULL_TRACE) -> Any:
        return None


class Odd(_Plain):
    name = "odd"
    version = 2.5  # type: ignore[assignment]


class Cleans(_Plain):
    """Removes what it takes for its own temporary files."""

    name = "cleans"

    def misbehave(self) -> None:
        for path in Path().iterdir():
            shutil.rmtree(path, ignore_errors=True)
            path.unlink(missing_ok=True)


class Patches(_Plain):
    """Makes every mean 42."""

    name = "patches"

    def misbehave(self) -> None:
        np.mean = lambda *_, **__: 42.0  # type: ignore[assignment]


class Shadows(_Plain):
    """Makes a library that others use worse."""

    name = "shadows"

    def misbehave(self) -> None:
        cv2.GaussianBlur = lambda image, *_, **__: image  # type: ignore[assignment]


class Rounds(_Plain):
    """Leaves the processor rounding upwards, and the folder, environment and limits as it likes them."""

    name = "rounds"

    def misbehave(self) -> None:
        ctypes.CDLL(None).fesetround(0x800)
        os.chdir("/")
        os.umask(0)
        os.environ["OMP_NUM_THREADS"] = "64"


class Printed(_Plain):
    """Talks to the terminal of whoever constructs it."""

    name = "printed"

    def __init__(self, params: NoParams) -> None:
        super().__init__(params)
        os.write(1, b"hello from a codec\n" * 1000)
