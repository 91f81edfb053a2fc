"""Codecs that each break the contract in one way, and are right in every other."""

from __future__ import annotations

import ctypes
import os
import signal
import struct
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from itertools import count
from queue import SimpleQueue
from typing import Any, ClassVar

import numpy as np

from codecbench import BitstreamError, Capabilities, Fragment, Image, Params, PartialImage
from codecbench.core.contracts.image import check_image
from codecbench.plugins.codecs.raw import Raw


class OffsetParams(Params):
    offset: int = 1


class _Broken(Raw):
    """Starts as the raw codec, whose bitstream begins with 13 bytes of header and ends with 4 of checksum."""

    params_type = OffsetParams
    capabilities = Capabilities(lossless=True)


class KeepsEightBits(_Broken):
    """Codes the upper half of 16 bits."""

    capabilities = Capabilities((1,), bits=(16,), lossless=True)

    def encode(self, image: Image, **_: Any) -> bytes:
        return super().encode((check_image(image, (1,), (16,)) >> 8).astype(np.uint8))

    def decode(self, bitstream: bytes, **_: Any) -> Image:
        return super().decode(bitstream).astype(np.uint16) << 8


class ReturnsEightBits(KeepsEightBits):
    def decode(self, bitstream: bytes, **_: Any) -> Image:
        return Raw.decode(self, bitstream)


class KeepsTheImage(_Broken):
    """The decoder remembers what the encoder saw."""

    seen: ClassVar[dict[bytes, Image]] = {}

    def encode(self, image: Image, **_: Any) -> bytes:
        bitstream = super().encode(image)
        self.seen[bitstream[-4:]] = np.array(image)
        return bitstream[-4:]

    def decode(self, bitstream: bytes, **_: Any) -> Image:
        if bitstream not in self.seen:
            raise BitstreamError("never seen")
        return self.seen[bitstream].copy()


class DecodesByItsParams(_Broken):
    """The offset reaches the decoder outside the bytes."""

    def encode(self, image: Image, **_: Any) -> bytes:
        super().encode(image)
        return super().encode(np.ascontiguousarray(image + np.uint8(self.params.offset)))

    def decode(self, bitstream: bytes, **_: Any) -> Image:
        return super().decode(bitstream) - np.uint8(self.params.offset)


class Random(_Broken):
    def encode(self, image: Image, **_: Any) -> bytes:
        return super().encode(image) + os.urandom(2)

    def decode(self, bitstream: bytes, **_: Any) -> Image:
        return super().decode(bitstream[:-2])


class DiffersByProcess(_Broken):
    def encode(self, image: Image, **_: Any) -> bytes:
        return super().encode(image) + struct.pack("<I", os.getpid())

    def decode(self, bitstream: bytes, **_: Any) -> Image:
        return super().decode(bitstream[:-4])


class WritesIntoItsInput(_Broken):
    def encode(self, image: Image, **_: Any) -> bytes:
        bitstream = super().encode(image)
        image[0, 0] += 1
        return bitstream


class LosesARow(_Broken):
    def decode(self, bitstream: bytes, **_: Any) -> Image:
        image = super().decode(bitstream)
        return image[:-1].copy() if len(image) > 1 else image


class ReturnsFloats(_Broken):
    def decode(self, bitstream: bytes, **_: Any) -> Any:
        return super().decode(bitstream).astype(np.float32)


class PreparesAnotherSetting(_Broken):
    """The prepared instance writes a longer bitstream than the one that it was made from."""

    padding = b""

    def prepared(self, image: Image) -> PreparesAnotherSetting:
        prepared = type(self)(self.params)
        prepared.padding = b"more"
        return prepared

    def encode(self, image: Image, **_: Any) -> bytes:
        return super().encode(image) + self.padding


class IsChangedByPreparing(PreparesAnotherSetting):
    """What is found is kept in the instance that was asked, not in the one that is handed out."""

    def prepared(self, image: Image) -> IsChangedByPreparing:
        self.padding = b"more"
        return type(self)(self.params)


class NotLossless(_Broken):
    def decode(self, bitstream: bytes, **_: Any) -> Image:
        return super().decode(bitstream) & np.uint8(0xFE)


class FillsWhatIsCut(_Broken):
    def decode(self, bitstream: bytes, **_: Any) -> Image:
        if len(bitstream) < 13 or bitstream[:4] != b"RAW1":
            raise BitstreamError("foreign")
        _, channels, width, height = struct.unpack_from("<4sBII", bitstream)
        if channels not in (1, 3) or not 0 < width * height < 1 << 20:
            raise BitstreamError("damaged")
        shape = (height, width) if channels == 1 else (height, width, 3)
        pixels = np.zeros(shape, np.uint8)
        there = np.frombuffer(bitstream[13:-4], np.uint8)[: pixels.size]
        pixels.reshape(-1)[: len(there)] = there
        return pixels


class TripsOverForeignBytes(_Broken):
    def decode(self, bitstream: bytes, **_: Any) -> Image:
        struct.unpack_from("<4sBII", bitstream)
        return super().decode(bitstream)


class Crashes(_Broken):
    def decode(self, bitstream: bytes, **_: Any) -> Image:
        if len(bitstream) > 100 and not bitstream.startswith(b"RAW1"):
            ctypes.string_at(0)
        return super().decode(bitstream)


class _TrustsItsHeader(_Broken):
    """Acts on the header before checking anything else."""

    def decode(self, bitstream: bytes, **_: Any) -> Image:
        if len(bitstream) > 13 and bitstream.startswith(b"RAW1"):
            self.act(*struct.unpack_from("<II", bitstream, 5))
        return super().decode(bitstream)

    def act(self, width: int, height: int) -> None:
        raise NotImplementedError("each of these codecs acts in its own way")


class Hangs(_TrustsItsHeader):
    def act(self, width: int, height: int) -> None:
        if width * height > 1 << 26:
            time.sleep(3600)


class Allocates(_TrustsItsHeader):
    def act(self, width: int, height: int) -> None:
        if 1 << 26 < width * height < 1 << 40:
            np.ones(width * height, np.uint8)


class SharesABuffer(_Broken):
    """The first image of another thread waits in a buffer until the next one has taken its place."""

    comers: ClassVar[Iterator[int]] = count()
    buffer: ClassVar[SimpleQueue[Image]] = SimpleQueue()

    def encode(self, image: Image, **_: Any) -> bytes:
        if threading.current_thread() is threading.main_thread():
            type(self).comers = count()
        elif (order := next(self.comers)) == 0:
            image = self.buffer.get()
        elif order == 1:
            self.buffer.put(image)
        return super().encode(image)


class AcceptsAnything(_Broken):
    def encode(self, image: Image, **_: Any) -> bytes:
        return super().encode(np.asarray(image).astype(np.uint8))


class WrapsRound(_Broken):
    """Overshoots by a few levels at edges, and forgets that samples end at 0 and 255."""

    capabilities = Capabilities(lossless=False)

    def decode(self, bitstream: bytes, **_: Any) -> Image:
        image = super().decode(bitstream).astype(np.int16)
        image[:, 1:] += np.sign(np.diff(image, axis=1)) * 8
        return (image % 256).astype(np.uint8)


class ClaimsTooMuchOfParts(FillsWhatIsCut):
    """Fills up what is missing with zeros, and says that all is as it was."""

    capabilities = Capabilities(lossless=True, partial_decoding=True)

    def decode_partial(self, fragments: Sequence[Fragment], **_: Any) -> PartialImage:
        bitstream = bytearray(fragments[-1].end)
        for fragment in fragments:
            bitstream[fragment.offset : fragment.end] = fragment.data
        return PartialImage.of_whole(self.decode(bytes(bitstream)))


class ClaimsPartsAndHasNone(_Broken):
    capabilities = Capabilities(lossless=True, partial_decoding=True)


class ClaimsToCount(_Broken):
    capabilities = Capabilities(lossless=True, counts_operations=True)


class ForgetsAParameter(_Broken):
    class _Params(OffsetParams):
        def model_dump(self, **_: Any) -> dict[str, Any]:
            return {}

    params_type = _Params


class Exits(_Broken):
    def encode(self, image: Image, **_: Any) -> bytes:
        sys.exit(0)


class EndsItsProcess(_Broken):
    def encode(self, image: Image, **_: Any) -> bytes:
        os._exit(0)


class KillsItself(_Broken):
    def encode(self, image: Image, **_: Any) -> bytes:
        os.kill(os.getpid(), signal.SIGKILL)
        return b""


class Interrupts(_Broken):
    def encode(self, image: Image, **_: Any) -> bytes:
        raise KeyboardInterrupt


class Segfaults(_Broken):
    def encode(self, image: Image, **_: Any) -> bytes:
        return ctypes.string_at(0)


class NeverEnds(_Broken):
    """Sleeps deaf to what ends other programs."""

    def encode(self, image: Image, **_: Any) -> bytes:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        while True:
            time.sleep(3600)


class EndsWhenConstructed(_Broken):
    def __init__(self, params: Any) -> None:
        os._exit(0)


BROKEN: dict[type[Any], str] = {
    KeepsTheImage: "self_contained",
    DecodesByItsParams: "self_contained",
    Random: "stateless",
    DiffersByProcess: "deterministic",
    WritesIntoItsInput: "untouched",
    LosesARow: "shape",
    KeepsEightBits: "lossless",
    ReturnsEightBits: "shape",
    WrapsRound: "range",
    ReturnsFloats: "shape",
    PreparesAnotherSetting: "prepared",
    IsChangedByPreparing: "prepared",
    NotLossless: "lossless",
    FillsWhatIsCut: "cut",
    TripsOverForeignBytes: "foreign",
    Crashes: "foreign",
    Hangs: "bombs",
    Allocates: "bombs",
    SharesABuffer: "threads",
    AcceptsAnything: "bad_images",
    ClaimsToCount: "counting",
    ForgetsAParameter: "params",
    ClaimsTooMuchOfParts: "partial",
    ClaimsPartsAndHasNone: "partial",
}
"""Each with the check that is meant to catch it."""
