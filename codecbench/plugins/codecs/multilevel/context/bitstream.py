"""The container of the profile `context`, byte by byte, and the limits that a decoder keeps.

All numbers are little-endian:

    offset  size
         0     4  magic "CBML"
         4     1  version, 2
         5     1  profile, 1
         6     1  flags: bit 2 three channels, bit 3 lapped, bit 4 mixing; the others 0
         7     1  colour: 0 gray, 1 rgb, 2 ycbcr444, 3 ycbcr420
         8     1  table: 0 paper, 1 standard, 2 flat, 255 custom
         9     1  steps of every plane after the first, in 1/16 of its steps, 1..255
        10     2  restart: rows of 16 pixels in a slice, 0 for a single slice
        12     4  width
        16     4  height
        20     8  qf, float64
        28   128  custom table only: 64 steps, uint16, natural order
               9  for each plane: its biases, int8, in 1/128, by zone, then by size
               -  with restart: 4 bytes for each slice, the size of its payload; then CRC-32 of everything before
               -  the slices' payloads, in order; with restart, each followed by its own CRC-32
               4  CRC-32 (IEEE 802.3) of everything before

Work is bounded as in the static profile: a payload that stands for more samples than it has bytes to account for is
filled up with zero bytes by the encoder and refused without them by the decoder.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.errors import BitstreamError
from codecbench.plugins.codecs.multilevel.bitstream import checked, least_size
from codecbench.plugins.codecs.multilevel.context.quantization import BIAS_SIZES, BIAS_ZONES, MAX_BIAS, MIN_BIAS
from codecbench.plugins.codecs.multilevel.header import (
    COLORS,
    CONTEXT_PROFILE,
    CONTEXT_VERSION,
    MAGIC,
    Picture,
    Reader,
    pack_table,
    picture_fields,
    require_fields,
    table_number,
)

CHROMA_UNITS = 16
"""In which the factor of the other planes' steps is told."""
MAX_RESTART = (1 << 16) - 1
SLICE_ROWS = 16
"""Rows of pixels in one unit of `restart`."""

_THREE_CHANNELS, _LAPPED, _MIXING = 4, 8, 16
_FIXED = struct.Struct("<4sBBBBBBHIId")
_WORD = struct.Struct("<I")
_BIASES = BIAS_ZONES * BIAS_SIZES


@dataclass(frozen=True)
class ContextHeader(Picture):
    """What stands before the payloads. chroma: the other planes' steps, in 1/16 of the first's.

    restart: rows of 16 pixels in a slice, or 0. biases: (planes, 3, 3) int32, in 1/128.
    """

    lapped: bool
    mixing: bool
    chroma: int
    restart: int
    biases: NDArray[np.int32] = field(repr=False)

    @property
    def slices(self) -> int:
        """How many slices there are."""
        return -(-self.height // (SLICE_ROWS * self.restart)) if self.restart else 1

    def block_rows(self, plane: int, number: int) -> range:
        """The rows of blocks of a plane that are in a slice; it may have none."""
        rows = self.padded_shapes[plane][0] // 8
        if not self.restart:
            return range(rows)
        halved = self.plane_shapes[plane][0] < self.height
        step = self.restart if halved and self.color == "ycbcr420" else 2 * self.restart
        return range(min(number * step, rows), min((number + 1) * step, rows))

    def slice_samples(self, number: int) -> int:
        """Samples of all planes in a slice."""
        return sum(8 * len(self.block_rows(plane, number)) * shape[1] for plane, shape in enumerate(self.padded_shapes))


def pack(header: ContextHeader, payloads: list[bytes]) -> bytes:
    """The bytes of a bitstream."""
    flags = _THREE_CHANNELS * (header.channels == 3) + _LAPPED * header.lapped + _MIXING * header.mixing
    body = _FIXED.pack(
        MAGIC,
        CONTEXT_VERSION,
        CONTEXT_PROFILE,
        flags,
        COLORS.index(header.color),
        table_number(header.table),
        header.chroma,
        header.restart,
        header.width,
        header.height,
        header.qf,
    )
    body += pack_table(header.table) + header.biases.astype(np.int8).tobytes()
    if header.restart:
        body += b"".join(_WORD.pack(len(payload)) for payload in payloads)
        body += _WORD.pack(zlib.crc32(body))
        payloads = [payload + _WORD.pack(zlib.crc32(payload)) for payload in payloads]
    body += b"".join(payloads)
    return body + _WORD.pack(zlib.crc32(body))


def unpack(bitstream: bytes) -> tuple[ContextHeader, list[bytes]]:
    """The header and the slices' payloads, with everything checked that can be without decoding.

    Raises BitstreamError with the reason.
    """
    reader = checked(bitstream, CONTEXT_VERSION)
    header, sizes = unpack_header(reader)
    payloads = []
    for number, size in enumerate(sizes):
        payload = reader.take(size, f"slice {number}")
        if header.restart and zlib.crc32(payload) != _word(reader, f"CRC-32 of slice {number}"):
            raise BitstreamError(f"damaged: CRC-32 of slice {number} is wrong")
        if size < least_size(header.slice_samples(number)):
            raise BitstreamError(f"slice {number}: {header.width}x{header.height} pixels cannot come from {size} bytes")
        payloads.append(payload)
    if reader.position != reader.end:
        raise BitstreamError(f"{reader.end - reader.position} trailing bytes after the slices")
    return header, payloads


def unpack_intact(bitstream: bytes) -> tuple[ContextHeader, list[bytes | None]]:
    """The header and the payloads whose own checksums are right, None for the others: what damage has left.

    Raises BitstreamError where the header is damaged, and where there are no restart points.
    """
    reader = Reader(bytes(bitstream))
    header, sizes = unpack_header(reader)
    if not header.restart:
        raise BitstreamError("damaged, and there are no restart points; encode with `restart`")
    payloads: list[bytes | None] = []
    for number, size in enumerate(sizes):
        data = reader.data[reader.position : reader.position + size + _WORD.size]
        reader.position += size + _WORD.size
        payload, checksum = data[:size], data[size:]
        intact = len(checksum) == _WORD.size and zlib.crc32(payload) == _WORD.unpack(checksum)[0]
        payloads.append(payload if intact and size >= least_size(header.slice_samples(number)) else None)
    return header, payloads


def unpack_header(reader: Reader) -> tuple[ContextHeader, list[int]]:
    """The header that comes next, checked, and the sizes of the slices' payloads."""
    fields = _FIXED.unpack(reader.take(_FIXED.size, "header"))
    magic, version, profile, flags, color, number, chroma, restart, width, height, qf = fields
    require_fields(
        ("magic", magic, magic == MAGIC),
        ("version", version, version == CONTEXT_VERSION),
        ("profile", profile, profile == CONTEXT_PROFILE),
        ("flags", flags, flags & ~(_THREE_CHANNELS | _LAPPED | _MIXING) == 0),
        ("chroma steps", chroma, chroma >= 1),
    )
    header = ContextHeader(
        **picture_fields(reader, flags & _THREE_CHANNELS, color, number, width, height, qf),
        lapped=bool(flags & _LAPPED),
        mixing=bool(flags & _MIXING),
        chroma=chroma,
        restart=restart,
        biases=_unpack_biases(reader, 1 if COLORS[color] == "gray" else 3),
    )
    header.require_room()
    return header, _unpack_sizes(reader, header)


def _unpack_biases(reader: Reader, planes: int) -> NDArray[np.int32]:
    data = np.frombuffer(reader.take(planes * _BIASES, "biases"), np.int8).astype(np.int32)
    if data.min() < MIN_BIAS or data.max() > MAX_BIAS:
        raise BitstreamError(f"biases: {data.min()} to {data.max()}; allowed: {MIN_BIAS} to {MAX_BIAS}")
    return data.reshape(planes, BIAS_ZONES, BIAS_SIZES)


def _unpack_sizes(reader: Reader, header: ContextHeader) -> list[int]:
    if not header.restart:
        return [reader.end - reader.position]
    sizes = list(struct.unpack(f"<{header.slices}I", reader.take(header.slices * _WORD.size, "sizes of slices")))
    found = zlib.crc32(reader.data[: reader.position])
    if (expected := _word(reader, "CRC-32 of the header")) != found:
        raise BitstreamError(f"damaged: CRC-32 of the header is {found:08x}, the bitstream says {expected:08x}")
    return sizes


def _word(reader: Reader, what: str) -> int:
    (value,) = _WORD.unpack(reader.take(_WORD.size, what))
    return int(value)
