"""The header of a multi-level bitstream: fields and limits. The layout is in `bitstream`."""

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
"""The profile `context`: adaptive contexts instead of tables."""

MAX_LEVELS = 16
MIN_GROUP, MAX_GROUP = 2, 16
MIN_QF, MAX_QF = 1e-3, 1e6
MAX_SAMPLES = MAX_PIXELS
"""Of all planes with their padding."""
MAX_SYMBOLS = 1 << 22
"""Largest number of digits of an alphabet and of entries of a table."""

COLORS: tuple[Color, ...] = get_args(Color)
TABLES: dict[str, tuple[int, Table]] = {"paper": (0, PAPER), "standard": (1, LUMINANCE), "flat": (2, FLAT)}
CUSTOM_TABLE = 255

_SEARCH, _COEFFICIENT, _THREE_CHANNELS = 1, 2, 4
_FIXED = struct.Struct("<4sBBBBBBBxIIdiI")
_CUSTOM = struct.Struct("<64H")
HEADER_SIZE = _FIXED.size
"""Size of a header without a custom table."""
_CHECKSUM_SIZE = 4


@dataclass(frozen=True)
class Picture:
    """Header fields of both profiles."""

    width: int
    height: int
    channels: int
    color: Color
    qf: float
    table: Table = field(repr=False)
    """(8, 8) int32."""

    @property
    def plane_shapes(self) -> list[tuple[int, int]]:
        """(height, width) of every plane."""
        return plane_shapes(self.height, self.width, self.color)

    @property
    def padded_shapes(self) -> list[tuple[int, int]]:
        """(height, width) of every plane with the padding to multiples of 8."""
        return [((height + 7) // 8 * 8, (width + 7) // 8 * 8) for height, width in self.plane_shapes]

    @property
    def samples(self) -> int:
        """Number of samples of all planes with their padding."""
        return sum(height * width for height, width in self.padded_shapes)

    def check_samples(self) -> None:
        """Raise BitstreamError if there are more samples than a decoder allows."""
        if self.samples > MAX_SAMPLES:
            size = f"{self.width}x{self.height}"
            raise BitstreamError(f"header: {size} pixels are more than the {MAX_SAMPLES} samples allowed")


@dataclass(frozen=True)
class Header(Picture):
    """The header of the static profile; indices are offset..offset+radix-1."""

    levels: int
    group: int
    search: bool
    coefficient_scan: bool
    offset: int
    radix: int
    rice: bool = False
    """Whether tables are Rice codes."""


class Reader:
    """Reads a bitstream piece by piece, up to its checksum."""

    def __init__(self, bitstream: bytes) -> None:
        self.data = bitstream
        self.position = 0
        self.end = len(bitstream) - _CHECKSUM_SIZE

    def take(self, size: int, what: str) -> bytes:
        """Return the next `size` bytes. Raises BitstreamError, with `what` they are, if there are fewer."""
        if size > self.end - self.position:
            raise BitstreamError(f"truncated: {what} of {size} bytes at byte {self.position} of {len(self.data)}")
        self.position += size
        return self.data[self.position - size : self.position]


def pack_header(header: Header) -> bytes:
    """Serialize a header, with its table if that is a custom one."""
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
    """Return the number of a table in headers."""
    return next((number for number, known in TABLES.values() if np.array_equal(table, known)), CUSTOM_TABLE)


def pack_table(table: Table) -> bytes:
    """Serialize the steps of a custom table; empty for tables with a number."""
    return _CUSTOM.pack(*table.reshape(64).tolist()) if table_number(table) == CUSTOM_TABLE else b""


def unpack_header(reader: Reader) -> Header:
    """Read and check the next header. Raises BitstreamError with the field that is not allowed."""
    fields = _FIXED.unpack(reader.take(HEADER_SIZE, "header"))
    _, version, profile, flags, color, number, levels, group, width, height, qf, offset, radix = fields
    check_fields(
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
    header.check_samples()
    return header


def check_fields(*fields: tuple[str, float, bool]) -> None:
    """Raise BitstreamError for the first field, of name, value and validity, that is not allowed."""
    for what, value, allowed in fields:
        if not allowed:
            raise BitstreamError(f"header: {what} {value} is not allowed")


def picture_fields(
    reader: Reader, three_channels: int, color: int, number: int, width: int, height: int, qf: float
) -> dict[str, Any]:
    """Check the fields of both profiles; a custom table is read next from the bitstream."""
    check_fields(
        ("color", color, color < len(COLORS)),
        ("table", number, number == CUSTOM_TABLE or number < len(TABLES)),
        ("width", width, width >= 1),
        ("height", height, height >= 1),
        ("qf", qf, math.isfinite(qf) and MIN_QF <= qf <= MAX_QF),
    )
    channels = 3 if three_channels else 1
    if channels == 1 and COLORS[color] != "gray":
        raise BitstreamError(f"header: one channel with color {COLORS[color]}")
    table = unpack_table(reader, number)
    return {
        "width": width, "height": height, "channels": channels, "color": COLORS[color], "qf": qf, "table": table
    }  # fmt: skip


def unpack_table(reader: Reader, number: int) -> Table:
    """Return the table of a number, or read a custom one. Raises BitstreamError for a step of 0."""
    if number != CUSTOM_TABLE:
        return next(table for known, table in TABLES.values() if known == number)
    steps = np.array(_CUSTOM.unpack(reader.take(_CUSTOM.size, "custom table")), dtype=np.int32)
    if steps.min() < 1:
        raise BitstreamError("custom table: a step of 0")
    return steps.reshape(8, 8)
