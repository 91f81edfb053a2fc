"""The header of a multi-level bitstream: its fields and their limits; `bitstream` has its bytes."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass, field
from typing import Any, get_args

import numpy as np

from codecbench.core.contracts.errors import BitstreamError
from codecbench.core.contracts.image import MAX_PIXELS
from codecbench.plugins.codecs.dct.planes import Color, plane_shapes
from codecbench.plugins.codecs.dct.tables import FLAT, LUMINANCE, PAPER, Table

MAGIC = b"CBML"
VERSION = 1
CONTEXT_VERSION = 2
RICE_VERSION = 3
"""The static profile with tables by Rice codes: `effort: fast`."""
STATIC_PROFILE = 0
CONTEXT_PROFILE = 1
"""Adaptive contexts in place of tables: `context`."""

MAX_LEVELS = 16
MIN_GROUP, MAX_GROUP = 2, 16
MIN_QF, MAX_QF = 1e-3, 1e6
MAX_SAMPLES = MAX_PIXELS
"""Samples of all planes with their padding."""
MAX_SYMBOLS = 1 << 22
"""Digits of an alphabet, and entries of a table."""

COLORS: tuple[Color, ...] = get_args(Color)
TABLES: dict[str, tuple[int, Table]] = {"paper": (0, PAPER), "standard": (1, LUMINANCE), "flat": (2, FLAT)}
CUSTOM_TABLE = 255

_SEARCH, _COEFFICIENT, _THREE_CHANNELS = 1, 2, 4
_FIXED = struct.Struct("<4sBBBBBBBxIIdiI")
_CUSTOM = struct.Struct("<64H")
HEADER_SIZE = _FIXED.size
"""Bytes of a header without a custom table."""
_CHECKSUM_SIZE = 4


@dataclass(frozen=True)
class Picture:
    """What is coded, in either profile. table: (8, 8) int32."""

    width: int
    height: int
    channels: int
    color: Color
    qf: float
    table: Table = field(repr=False)

    @property
    def plane_shapes(self) -> list[tuple[int, int]]:
        """(height, width) of every plane."""
        return plane_shapes(self.height, self.width, self.color)

    @property
    def padded_shapes(self) -> list[tuple[int, int]]:
        """The same with the padding to multiples of 8."""
        return [((height + 7) // 8 * 8, (width + 7) // 8 * 8) for height, width in self.plane_shapes]

    @property
    def samples(self) -> int:
        """Samples of all planes with their padding."""
        return sum(height * width for height, width in self.padded_shapes)

    def require_room(self) -> None:
        """Raise BitstreamError for more samples than a decoder allows."""
        if self.samples > MAX_SAMPLES:
            size = f"{self.width}x{self.height}"
            raise BitstreamError(f"header: {size} pixels are more than the {MAX_SAMPLES} samples allowed")


@dataclass(frozen=True)
class Header(Picture):
    """What stands before the tables. offset, radix: indices are offset..offset+radix-1. rice: how tables are coded."""

    levels: int
    group: int
    search: bool
    coefficient_scan: bool
    offset: int
    radix: int
    rice: bool = False


class Reader:
    """Takes pieces off a bitstream; never beyond its checksum."""

    def __init__(self, bitstream: bytes) -> None:
        self.data = bitstream
        self.position = 0
        self.end = len(bitstream) - _CHECKSUM_SIZE

    def take(self, size: int, what: str) -> bytes:
        """The next `size` bytes. Raises BitstreamError where there are fewer; `what` names them in it."""
        if size > self.end - self.position:
            raise BitstreamError(f"truncated: {what} of {size} bytes at byte {self.position} of {len(self.data)}")
        self.position += size
        return self.data[self.position - size : self.position]


def pack_header(header: Header) -> bytes:
    """The bytes of a header, with its table where that is a custom one."""
    number = table_number(header.table)
    flags = _SEARCH * header.search + _COEFFICIENT * header.coefficient_scan + _THREE_CHANNELS * (header.channels == 3)
    fixed = _FIXED.pack(
        MAGIC,
        RICE_VERSION if header.rice else VERSION,
        STATIC_PROFILE,
        flags,
        COLORS.index(header.color),
        number,
        header.levels,
        header.group,
        header.width,
        header.height,
        header.qf,
        header.offset,
        header.radix,
    )
    return fixed + pack_table(header.table)


def table_number(table: Table) -> int:
    """The number by which a header names a table."""
    return next((number for number, known in TABLES.values() if np.array_equal(table, known)), CUSTOM_TABLE)


def pack_table(table: Table) -> bytes:
    """The steps of a custom table; nothing for those that have a number."""
    return _CUSTOM.pack(*table.reshape(64).tolist()) if table_number(table) == CUSTOM_TABLE else b""


def unpack_header(reader: Reader) -> Header:
    """The header that comes next, checked. Raises BitstreamError with the field that is not allowed."""
    fields = _FIXED.unpack(reader.take(HEADER_SIZE, "header"))
    _, version, profile, flags, color, number, levels, group, width, height, qf, offset, radix = fields
    require_fields(
        ("profile", profile, profile == STATIC_PROFILE),
        ("flags", flags, flags < 8 and not (version == RICE_VERSION and flags & _SEARCH)),
        ("levels", levels, 1 <= levels <= MAX_LEVELS),
        ("group", group, MIN_GROUP <= group <= MAX_GROUP),
        ("reserved byte", reader.data[11], reader.data[11] == 0),
        ("number of digits", radix, 1 <= radix <= MAX_SYMBOLS),
        ("offset", offset, -radix < offset <= 0),
    )
    header = Header(
        **picture_fields(reader, flags & _THREE_CHANNELS, color, number, width, height, qf),
        levels=levels,
        group=group,
        search=bool(flags & _SEARCH),
        coefficient_scan=bool(flags & _COEFFICIENT),
        offset=offset,
        radix=radix,
        rice=version == RICE_VERSION,
    )
    header.require_room()
    return header


def require_fields(*fields: tuple[str, float, bool]) -> None:
    """Raise BitstreamError for the first field, given by name and value, that is not allowed."""
    for what, value, allowed in fields:
        if not allowed:
            raise BitstreamError(f"header: {what} {value} is not allowed")


def picture_fields(
    reader: Reader, three_channels: int, color: int, number: int, width: int, height: int, qf: float
) -> dict[str, Any]:
    """What every profile says of the picture, checked; a table of its own comes next in the bitstream."""
    require_fields(
        ("colour", color, color < len(COLORS)),
        ("table", number, number == CUSTOM_TABLE or number < len(TABLES)),
        ("width", width, width >= 1),
        ("height", height, height >= 1),
        ("qf", qf, math.isfinite(qf) and MIN_QF <= qf <= MAX_QF),
    )
    channels = 3 if three_channels else 1
    if channels == 1 and COLORS[color] != "gray":
        raise BitstreamError(f"header: one channel with colour {COLORS[color]}")
    table = unpack_table(reader, number)
    return {
        "width": width, "height": height, "channels": channels, "color": COLORS[color], "qf": qf, "table": table
    }  # fmt: skip


def unpack_table(reader: Reader, number: int) -> Table:
    """The table of a number, or the custom one that comes next. Raises BitstreamError for a step of 0."""
    if number != CUSTOM_TABLE:
        return next(table for known, table in TABLES.values() if known == number)
    steps = np.array(_CUSTOM.unpack(reader.take(_CUSTOM.size, "custom table")), dtype=np.int32)
    if steps.min() < 1:
        raise BitstreamError("custom table: a step of 0")
    return steps.reshape(8, 8)
