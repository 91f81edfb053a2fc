"""Rows of an SQLite file whose tree is broken, found page by page. Source: sqlite.org/fileformat2.html.

The pages of a table lie in the order in which they were needed, and what leads to the first of them may lie behind the
last: of a file that is cut, the tree may reach nothing although rows before the cut are there. A few rows begin on each
page; of those whose page is lost nothing says where they are. SQLite's own recovery is an extension that neither
Python's sqlite3 nor apsw is built with.
"""

from __future__ import annotations

import os
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

_LEAF: Final = 13
_LEAF_HEAD = struct.Struct(">BHHHB")
_FILE_HEAD_BYTES: Final = 100
_INTEGER_BYTES: Final = {1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8, 8: 0, 9: 0}
"""Of the types of integers; 8 and 9 are the numbers 0 and 1."""
_LONGEST_HEAD: Final = 64
"""Bytes of a cell before its message: two lengths, the types of four columns, a topic and a time."""


class BrokenRowError(Exception):
    """A row of which a part is missing or makes no sense."""


@dataclass(frozen=True)
class Row:
    """A row of the table `messages`. place: where its cell lies in the file."""

    rowid: int
    topic: int
    time_ns: int
    place: int


@dataclass(frozen=True)
class _Cell:
    """Where a message lies: after `skipped` bytes of a payload, of which `local` are at `start`."""

    row: Row
    start: int
    payload: int
    local: int
    skipped: int


def page_bytes_of(head: bytes) -> int:
    """The size of a page, from the first bytes of a file."""
    size = int.from_bytes(head[16:18], "big")
    return 65536 if size == 1 else size


class Pages:
    """The pages of a file that are there whole."""

    def __init__(self, file: Path) -> None:
        self._handle = os.open(file, os.O_RDONLY)
        head = os.pread(self._handle, _FILE_HEAD_BYTES, 0)
        self._page_bytes = max(page_bytes_of(head), 512)
        self._usable = max(self._page_bytes - head[20], 480)
        self._count = os.fstat(self._handle).st_size // self._page_bytes

    def __del__(self) -> None:
        if hasattr(self, "_handle"):
            os.close(self._handle)

    def messages(self) -> Iterator[Row]:
        """The rows that look like those of `messages`: a key that is the row's number, two integers and bytes."""
        for page in range(1, self._count):  # the first holds what tables there are
            start = page * self._page_bytes
            kind, _, cells, _, _ = _LEAF_HEAD.unpack(os.pread(self._handle, _LEAF_HEAD.size, start))
            if kind != _LEAF or not 0 < cells <= self._page_bytes // 4:
                continue
            places = os.pread(self._handle, 2 * cells, start + _LEAF_HEAD.size)
            for (place,) in struct.iter_unpack(">H", places):
                try:
                    yield self._cell(start + place).row
                except BrokenRowError:
                    continue

    def size(self, place: int) -> int:
        """How many bytes the message of a row has. Raises BrokenRowError."""
        cell = self._cell(place)
        return cell.payload - cell.skipped

    def message(self, place: int, most_bytes: int) -> bytes:
        """The first bytes of the message of a row. Raises BrokenRowError."""
        cell = self._cell(place)
        wanted = min(cell.payload, cell.skipped + most_bytes)
        parts = [os.pread(self._handle, min(cell.local, wanted), cell.start)]
        found = len(parts[0])
        link = cell.start + cell.local
        while found < wanted:
            number = int.from_bytes(os.pread(self._handle, 4, link), "big")
            if not 1 < number <= self._count:
                raise BrokenRowError(f"page {number} is not there")
            link = (number - 1) * self._page_bytes
            parts.append(os.pread(self._handle, min(self._usable - 4, wanted - found), link + 4))
            found += len(parts[-1])
        return b"".join(parts)[cell.skipped :]

    def _cell(self, place: int) -> _Cell:
        head = os.pread(self._handle, _LONGEST_HEAD, place)
        payload, position = _varint(head, 0)
        rowid, position = _varint(head, position)
        start = position
        types_bytes, position = _varint(head, position)
        end = start + types_bytes
        types = []
        while position < end:
            type_, position = _varint(head, position)
            types.append(type_)
        if len(types) != 4 or types[0] != 0 or types[3] < 12 or types[3] % 2 or position != end:
            raise BrokenRowError("not a row of messages")
        topic, position = _integer(head, end, types[1])
        time_ns, position = _integer(head, position, types[2])
        if position - start + (types[3] - 12) // 2 != payload:
            raise BrokenRowError("a row whose length is not that of its columns")
        return _Cell(Row(rowid, topic, time_ns, place), place + start, payload, self._local(payload), position - start)

    def _local(self, payload: int) -> int:
        """How many bytes of a payload lie in the cell itself."""
        if payload <= self._usable - 35:
            return payload
        least = (self._usable - 12) * 32 // 255 - 23
        local = least + (payload - least) % (self._usable - 4)
        return local if local <= self._usable - 35 else least


def _varint(content: bytes, position: int) -> tuple[int, int]:
    """A number of 1 to 9 bytes, and where it ends."""
    value = 0
    for count, byte in enumerate(content[position : position + 9], start=1):
        if count == 9:
            return value << 8 | byte, position + 9
        value = value << 7 | byte & 0x7F
        if byte < 0x80:
            return value, position + count
    raise BrokenRowError("a number that does not end")


def _integer(content: bytes, position: int, type_: int) -> tuple[int, int]:
    """An integer column, and where it ends."""
    size = _INTEGER_BYTES.get(type_)
    if size is None or position + size > len(content):
        raise BrokenRowError("a column that is no integer")
    value = int.from_bytes(content[position : position + size], "big", signed=True) if size else type_ - 8
    return value, position + size
