"""The container of a multi-level bitstream, byte by byte, and the limits that a decoder enforces.

All numbers are little-endian. A bitstream is a header, one section a level, the payload and a checksum:

    offset  size  header
         0     4  magic "CBML"
         4     1  version, 1, or 3 if tables are Rice codes (header mode only)
         5     1  profile: 0 static, as described here; 1 is reserved for `context`
         6     1  flags: bit 0 search mode, bit 1 coefficient scan, bit 2 three channels; the others 0
         7     1  color: 0 gray, 1 rgb, 2 ycbcr444, 3 ycbcr420
         8     1  table: 0 paper, 1 standard, 2 flat, 255 custom
         9     1  levels, 1..16
        10     1  group, 2..16
        11     1  reserved, 0
        12     4  width
        16     4  height
        20     8  qf, float64
        28     4  offset: the smallest index, or 0 if none is negative; int32
        32     4  R, the number of digits at level 1
        36   128  custom table only: 64 steps, uint16, natural order

    a level, from the first
               4  U, the number of entries
               4  size of the coded table
             8 g  search mode only: the keys, int64
               -  the table; at the last level its counts too

    payload
               4  size
               -  the last level's ranks

               4  CRC-32 (IEEE 802.3) of everything before

The size of a section bounds the decoder's work: the encoder pads a section with zero bytes if it has too few for its
items, and the decoder refuses a section without them.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.errors import BitstreamError
from codecbench.plugins.codecs.multilevel.arithmetic import UNWRITTEN
from codecbench.plugins.codecs.multilevel.header import (
    CONTEXT_VERSION,
    MAGIC,
    MAX_SYMBOLS,
    RICE_VERSION,
    VERSION,
    Header,
    Reader,
    pack_header,
    unpack_header,
)

FREE_ITEMS = 1 << 20
ITEMS_PER_BYTE = 1 << 10

_LEVEL = struct.Struct("<II")
_WORD = struct.Struct("<I")
_SHORTEST = 28 + _WORD.size
"""Size of the fixed fields of all versions and the checksum."""


@dataclass(frozen=True)
class Level:
    """One level's section."""

    entries: int
    table: bytes = field(repr=False)
    """The coded table."""
    keys: NDArray[np.int64]
    """(g,), empty in header mode."""


@dataclass(frozen=True)
class Bitstream:
    """The parts of a bitstream."""

    header: Header
    levels: list[Level]
    payload: bytes = field(repr=False)


def least_size(items: int) -> int:
    """Smallest size in bytes of a section of so many items."""
    return max(0, -(-(items - FREE_ITEMS) // ITEMS_PER_BYTE))


def pad_section(section: bytes, items: int) -> bytes:
    """Pad a section with zero bytes to its smallest size; coders read zeros after its end anyway."""
    return section.ljust(least_size(items), b"\0")


def pack(parts: Bitstream) -> bytes:
    """Serialize a bitstream."""
    chunks = [pack_header(parts.header)]
    for level in parts.levels:
        chunks += [_LEVEL.pack(level.entries, len(level.table)), level.keys.astype("<i8").tobytes(), level.table]
    chunks += [_WORD.pack(len(parts.payload)), parts.payload]
    body = b"".join(chunks)
    return body + _WORD.pack(zlib.crc32(body))


def version_of(bitstream: bytes) -> int:
    """Read the version of a bitstream. Raises BitstreamError if it is not of this codec."""
    data = bytes(bitstream[:_SHORTEST])
    if data[:4] != MAGIC[: len(data)] or not data:
        raise BitstreamError(
            f"not a multi-level bitstream: starts with {data[:4].hex() or 'nothing'}, not {MAGIC.hex()}"
        )
    if len(data) < _SHORTEST:
        raise BitstreamError(f"truncated: {len(data)} bytes, the shortest header has {_SHORTEST}")
    if data[4] not in (VERSION, CONTEXT_VERSION, RICE_VERSION):
        raise BitstreamError(
            f"version {data[4]} is not supported, only {VERSION}, {CONTEXT_VERSION} and {RICE_VERSION}"
        )
    return data[4]


def checked_reader(bitstream: bytes, *versions: int) -> Reader:
    """Check the version and checksum of a bitstream and return a reader. Raises BitstreamError with the reason."""
    data = bytes(bitstream)
    if version_of(data) not in versions:
        raise BitstreamError(f"version {data[4]}, expected {' or '.join(map(str, versions))}")
    (expected,) = _WORD.unpack(data[-_WORD.size :])
    if (actual := zlib.crc32(data[: -_WORD.size])) != expected:
        raise BitstreamError(f"damaged: CRC-32 is {actual:08x}, the bitstream says {expected:08x}")
    return Reader(data)


def check_end(section: bytes, read: int, items: int, what: str) -> None:
    """Raise BitstreamError if a section is not exactly as long as its encoder would have made it.

    read: bytes that the decoder consumed, UNWRITTEN of them beyond the written ones.
    """
    written = read - UNWRITTEN
    if len(section) < written:
        raise BitstreamError(f"{what}: truncated")
    if len(section) > max(written, least_size(items)) or any(section[written:]):
        raise BitstreamError(f"{what}: trailing bytes")


def unpack(bitstream: bytes) -> Bitstream:
    """Split a bitstream into its parts and check everything that can be checked without decoding.

    Raises BitstreamError with the reason.
    """
    reader = checked_reader(bitstream, VERSION, RICE_VERSION)
    header = unpack_header(reader)
    levels = _unpack_levels(reader, header)
    (size,) = _WORD.unpack(reader.take(_WORD.size, "payload size"))
    payload = reader.take(size, "payload")
    if header.samples > FREE_ITEMS + ITEMS_PER_BYTE * size:
        raise BitstreamError(f"{header.width}x{header.height} pixels cannot come from a payload of {size} bytes")
    if reader.position != reader.end:
        raise BitstreamError(f"{reader.end - reader.position} trailing bytes after the payload")
    return Bitstream(header, levels, payload)


def _unpack_levels(reader: Reader, header: Header) -> list[Level]:
    levels = []
    groups = header.samples
    for number in range(1, header.levels + 1):
        groups = -(-groups // header.group)
        entries, size = _LEVEL.unpack(reader.take(_LEVEL.size, f"head of level {number}"))
        if not 1 <= entries <= min(groups, MAX_SYMBOLS):
            raise BitstreamError(f"level {number}: {entries} table entries for {groups} groups")
        keys = np.zeros(0, np.int64)
        if header.search:
            data = reader.take(8 * header.group, f"keys of level {number}")
            keys = np.frombuffer(data, dtype="<i8").astype(np.int64)
            if keys.min() < 1:
                raise BitstreamError(f"level {number}: key {keys.min()} is not positive")
        table = reader.take(size, f"table of level {number}")
        if entries > FREE_ITEMS + ITEMS_PER_BYTE * size:
            raise BitstreamError(f"level {number}: {entries} table entries cannot come from {size} bytes")
        levels.append(Level(entries, table, keys))
    return levels
