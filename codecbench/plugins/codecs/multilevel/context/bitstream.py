"""The container of the profile `context`, byte by byte, and the limits that a decoder enforces.

All numbers are little-endian:

    offset  size
         0     4  magic "CBML"
         4     1  version, 2
         5     1  profile, 1
         6     1  flags: bit 2 three channels, bit 3 lapped, bit 4 mixing; the others 0
         7     1  color: 0 gray, 1 rgb, 2 ycbcr444, 3 ycbcr420
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

Work is bounded as in the static profile: the encoder pads a payload with zero bytes if it has too few for its samples,
and the decoder refuses a payload without them.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.errors import BitstreamError
from codecbench.plugins.codecs.multilevel.bitstream import checked_reader, least_size
from codecbench.plugins.codecs.multilevel.context.quantization import BIAS_SIZES, BIAS_ZONES, MAX_BIAS, MIN_BIAS
from codecbench.plugins.codecs.multilevel.header import (
    COLORS,
    CONTEXT_PROFILE,
    CONTEXT_VERSION,
    MAGIC,
    Picture,
    Reader,
    check_fields,
    pack_table,
    picture_fields,
    table_number,
)

CHROMA_UNITS = 16
"""Units per 1 of the factor on the other planes' steps."""
MAX_RESTART = (1 << 16) - 1
SLICE_ROWS = 16
"""Rows of pixels per unit of `restart`."""

_THREE_CHANNELS, _LAPPED, _MIXING = 4, 8, 16
_FIXED = struct.Struct("<4sBBBBBBHIId")
_WORD = struct.Struct("<I")
_BIASES = BIAS_ZONES * BIAS_SIZES


@dataclass(frozen=True)
class ContextHeader(Picture):
    """The header of the profile `context`."""

    lapped: bool
    mixing: bool
    chroma: int
    """Steps of the other planes in 1/16 of the first plane's."""
    restart: int
    """Rows of 16 pixels in a slice, 0 for a single slice."""
    biases: NDArray[np.int32] = field(repr=False)
    """(planes, 3, 3), in 1/128."""

    @property
    def slices(self) -> int:
        """Number of slices."""
        return -(-self.height // (SLICE_ROWS * self.restart)) if self.restart else 1

    def block_rows(self, plane: int, number: int) -> range:
        """Rows of blocks of a plane in a slice; there may be none."""
        rows = self.padded_shapes[plane][0] // 8
        if not self.restart:
            return range(rows)
        halved = self.plane_shapes[plane][0] < self.height
        step = self.restart if halved and self.color == "ycbcr420" else 2 * self.restart
        return range(min(number * step, rows), min((number + 1) * step, rows))

    def slice_samples(self, number: int) -> int:
        """Number of samples of all planes in a slice."""
        return sum(8 * len(self.block_rows(plane, number)) * shape[1] for plane, shape in enumerate(self.padded_shapes))


def pack(header: ContextHeader, payloads: list[bytes]) -> bytes:
    """Serialize a bitstream."""
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
    """Read the header and the slices' payloads, and check everything that can be checked without decoding.

    Raises BitstreamError with the reason.
    """
    reader = checked_reader(bitstream, CONTEXT_VERSION)
    header, sizes = unpack_header(reader)
    payloads = []
    for number, size in enumerate(sizes):
        payload = reader.take(size, f"slice {number}")
        if header.restart and zlib.crc32(payload) != _take_word(reader, f"CRC-32 of slice {number}"):
            raise BitstreamError(f"damaged: CRC-32 of slice {number} is wrong")
        if size < least_size(header.slice_samples(number)):
            raise BitstreamError(f"slice {number}: {header.width}x{header.height} pixels cannot come from {size} bytes")
        payloads.append(payload)
    if reader.position != reader.end:
        raise BitstreamError(f"{reader.end - reader.position} trailing bytes after the slices")
    return header, payloads


def unpack_intact(bitstream: bytes) -> tuple[ContextHeader, list[bytes | None]]:
    """Read the header and the payloads of a damaged bitstream; None for payloads with a wrong checksum.

    Raises BitstreamError if the header is damaged, or there are no restart points.
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
        is_intact = len(checksum) == _WORD.size and zlib.crc32(payload) == _WORD.unpack(checksum)[0]
        payloads.append(payload if is_intact and size >= least_size(header.slice_samples(number)) else None)
    return header, payloads


def unpack_header(reader: Reader) -> tuple[ContextHeader, list[int]]:
    """Read and check the next header; returns it and the sizes of the slices' payloads."""
    fields = _FIXED.unpack(reader.take(_FIXED.size, "header"))
    magic, version, profile, flags, color, number, chroma, restart, width, height, qf = fields
    check_fields(
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
    header.check_samples()
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
    actual = zlib.crc32(reader.data[: reader.position])
    if (expected := _take_word(reader, "CRC-32 of the header")) != actual:
        raise BitstreamError(f"damaged: CRC-32 of the header is {actual:08x}, the bitstream says {expected:08x}")
    return sizes


def _take_word(reader: Reader, what: str) -> int:
    (value,) = _WORD.unpack(reader.take(_WORD.size, what))
    return int(value)
