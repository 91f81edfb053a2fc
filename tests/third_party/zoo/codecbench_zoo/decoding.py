"""Codecs that misbehave in `decode`."""

from __future__ import annotations

import ctypes
import os
import shutil
import signal
import sys
import tempfile
import time
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from codecbench import NULL_TRACE, BitstreamError, Image, Trace
from codecbench_zoo.tame import TameCodec


class _Decoder(TameCodec):
    def decode(self, bitstream: bytes, *, trace: Trace = NULL_TRACE) -> Any:
        return self.seen(super().decode(bitstream))

    def seen(self, image: Image) -> Any:
        raise NotImplementedError


class DecodesNone(_Decoder):
    def seen(self, image: Image) -> Any:
        return None


class DecodesLists(_Decoder):
    def seen(self, image: Image) -> Any:
        return image.tolist()


class DecodesFloats(_Decoder):
    def seen(self, image: Image) -> Any:
        return np.full(image.shape, np.nan, np.float32)


class DecodesObjects(_Decoder):
    def seen(self, image: Image) -> Any:
        return image.astype(object)


class DecodesTurned(_Decoder):
    def seen(self, image: Image) -> Any:
        return image.T


class DecodesColor(_Decoder):
    def seen(self, image: Image) -> Any:
        return np.stack([image] * 3, axis=-1)


class DecodesNothing(_Decoder):
    def seen(self, image: Image) -> Any:
        return image[:0]


class _Pretender:
    """Says that it is an array, and becomes one of another kind."""

    __class__ = np.ndarray  # type: ignore[assignment]
    dtype = np.dtype(np.uint8)

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.shape = shape

    def __array__(self, *_: Any, **__: Any) -> Any:
        return np.full(self.shape, np.nan)


class DecodesPretenders(_Decoder):
    def seen(self, image: Image) -> Any:
        return _Pretender(image.shape)


class _Shy(np.ndarray):
    """An array with arithmetic of its own."""

    def __array_ufunc__(self, *_: Any, **__: Any) -> Any:
        return 42.0


class DecodesShy(_Decoder):
    def seen(self, image: Image) -> Any:
        return image.view(_Shy)


class DecodesBackwards(_Decoder):
    """An array that is not contiguous and cannot be written."""

    def seen(self, image: Image) -> Any:
        view = np.ascontiguousarray(image[::-1, ::-1])[::-1, ::-1]
        view.flags.writeable = False
        return view


class DecodeSegfaults(_Decoder):
    def seen(self, image: Image) -> Any:
        return ctypes.string_at(0)


class DecodeKills(_Decoder):
    def seen(self, image: Image) -> Any:
        os.kill(os.getpid(), signal.SIGKILL)


class DecodeSleeps(_Decoder):
    def seen(self, image: Image) -> Any:
        time.sleep(3600)


class DecodeExits(_Decoder):
    def seen(self, image: Image) -> Any:
        sys.exit("enough")


class DecodeRefuses(_Decoder):
    def seen(self, image: Image) -> Any:
        raise BitstreamError("I do not know these bytes")


class DecodeBlames(_Decoder):
    """Says that our file of bitstreams is damaged."""

    def seen(self, image: Image) -> Any:
        from codecbench.core.engine.storage.bitstream_file import BitstreamDamage

        raise BitstreamDamage("it was like this when I came")


class Remembers(TameCodec):
    """Keeps the pictures and sends their numbers."""

    kept: ClassVar[dict[int, Image]] = {}

    def encode(self, image: Image, *, trace: Trace = NULL_TRACE) -> Any:
        self.kept[len(self.kept)] = image.copy()
        return bytes([len(self.kept)])

    def decode(self, bitstream: bytes, *, trace: Trace = NULL_TRACE) -> Any:
        return self.kept[bitstream[0] - 1]


class Rolls(_Decoder):
    """Never decodes the same twice."""

    def seen(self, image: Image) -> Any:
        return np.frombuffer(os.urandom(image.size), np.uint8).reshape(image.shape)


class RemovesItsFolder(_Decoder):
    """Removes the folders that it stands in and all temporary ones."""

    def seen(self, image: Image) -> Any:
        shutil.rmtree(Path.cwd(), ignore_errors=True)
        shutil.rmtree(tempfile.gettempdir(), ignore_errors=True)
        return image


class LibrariesOfObjects(TameCodec):
    """Names libraries that no other process could read."""

    def libraries(self) -> Any:
        return {"zlib": object()}


class LibrariesOfCode(TameCodec):
    """Names libraries that would run where they are read."""

    def libraries(self) -> Any:
        class Version(str):
            def __reduce__(self) -> Any:
                return os._exit, (0,)

        return {"zlib": Version("1.3")}


class LibrariesFail(TameCodec):
    def libraries(self) -> Any:
        raise RuntimeError("who knows")
