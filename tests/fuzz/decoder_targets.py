"""What is fuzzed: our decoders, bitstreams to start from, and how to make a checksum right again.

A mutation that the checksum refuses has tested the checksum. So every target can repair an input: the checksum
of a mutated bitstream is computed anew, and what lies behind it is reached.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

Repair = Callable[[bytes], bytes]

_JPEG_QF_PREFIX_BYTES = 28
_JP2_COMMENT = b"codecbench CRC-32: "
_PNG_SIGNATURE_BYTES = 8
_CONTEXT_BYTES = 28


@dataclass(frozen=True)
class Target:
    """A decoder to fuzz: the codec's name in the registry, and its repair."""

    name: str
    repair: Repair

    def codec(self) -> Any:
        """An instance at the codec's first example setting."""
        cls = self.codec_class()
        return cls.create(**cls.examples[0])

    def codec_class(self) -> Any:
        from codecbench.core.engine.plugins.registry import installed

        return installed().load("codec", self.name)

    def seeds(self, shapes: tuple[tuple[int, ...], ...]) -> list[bytes]:
        """Bitstreams of pictures of these shapes, of 8 and 16 bits, at every example setting that takes them."""
        from codecbench import ImageError, Unsupported

        cls, bitstreams = self.codec_class(), []
        for example in cls.examples:
            for seed, shape in enumerate(shapes):
                picture = _picture(shape, seed)
                for image in (picture * np.uint16(250), picture):
                    try:
                        bitstreams.append(cls.create(**example).encode(image))
                    except (ImageError, Unsupported):
                        continue
        return bitstreams


def _picture(shape: tuple[int, ...], seed: int) -> Any:
    """A slope with an edge and some noise."""
    rows, columns = np.indices(shape[:2])
    plane = 3 * rows + 5 * columns + 80 * (columns > rows)
    noise = np.random.default_rng(seed).integers(0, 12, shape)
    return ((plane.reshape(plane.shape + (1,) * (len(shape) - 2)) + noise) % 256).astype(np.uint8)


def _unrepaired(data: bytes) -> bytes:
    return data


def _trailing_crc(data: bytes) -> bytes:
    return data[:-4] + struct.pack("<I", zlib.crc32(data[:-4])) if len(data) > 4 else data


def _multilevel_crcs(data: bytes) -> bytes:
    """The last checksum; of the profile `context` with restart points, those of header and slices before it too."""
    repaired = bytearray(data)
    restart = int.from_bytes(data[10:12], "little") if data[4:6] == b"\2\1" else 0
    if restart and len(data) > _CONTEXT_BYTES:
        height = int.from_bytes(data[16:20], "little")
        start = _CONTEXT_BYTES + 128 * (data[8] == 255) + (9 if data[7] == 0 else 27)
        end = start + 4 * -(-height // (16 * restart))
        if end + 4 <= len(data):
            sizes = struct.unpack(f"<{(end - start) // 4}I", data[start:end])
            _put_crc(repaired, 0, end)
            for size in sizes:
                start, end = end + 4, end + 4 + size
                _put_crc(repaired, start, end)
    return _trailing_crc(bytes(repaired))


def _put_crc(data: bytearray, start: int, end: int) -> None:
    if end + 4 <= len(data):
        data[end : end + 4] = struct.pack("<I", zlib.crc32(data[start:end]))


def _jpeg_qf_crc(data: bytes) -> bytes:
    before, after = data[:_JPEG_QF_PREFIX_BYTES], data[_JPEG_QF_PREFIX_BYTES + 4 :]
    return before + struct.pack(">I", zlib.crc32(before + after)) + after


def _jp2_crc(data: bytes) -> bytes:
    place = data.find(_JP2_COMMENT)
    if place < 0:
        return data
    before, after = data[: place + len(_JP2_COMMENT)], data[place + len(_JP2_COMMENT) + 8 :]
    return before + f"{zlib.crc32(before + after):08x}".encode() + after


def _png_crcs(data: bytes) -> bytes:
    repaired, position = bytearray(data), _PNG_SIGNATURE_BYTES
    while position + 12 <= len(data):
        end = position + 8 + int.from_bytes(data[position : position + 4], "big")
        if end + 4 > len(data):
            break
        repaired[end : end + 4] = struct.pack(">I", zlib.crc32(data[position + 4 : end]))
        position = end + 4
    return bytes(repaired)


TARGETS = {
    target.name: target
    for target in (
        Target("raw", _trailing_crc),
        Target("png", _png_crcs),
        Target("jpeg", _unrepaired),
        Target("jpeg_qf", _jpeg_qf_crc),
        Target("jpeg2000", _jp2_crc),
        Target("multilevel", _multilevel_crcs),
        Target("rvl", _unrepaired),
    )
}
