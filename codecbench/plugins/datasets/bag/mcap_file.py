"""MCAP files of ROS 2, and of ROS 1. Source: the MCAP specification, mcap.dev/spec."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from codecbench.plugins.datasets.bag.bag_file import type_from_name
from codecbench.plugins.datasets.bag.chunked_file import OUTSIDE, BrokenRecord, Chunk, ChunkedFile, Window
from codecbench.plugins.datasets.bag.expansion import MOST_BYTES, ZSTD_MAGIC, expanded

_HEADER, _FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _INDEX = range(1, 8)
_RECORD = struct.Struct("<BQ")
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_CHUNK_HEAD = struct.Struct("<QQQII")
_INDEX_ENTRY = struct.Struct("<QQ")
_LONGEST_DESCRIPTION: Final = 1 << 20
_LATEST_NS: Final = (1 << 63) - 1


class McapFile(ChunkedFile):
    """An `.mcap` file."""

    kind = "MCAP file"
    magic = b"\x89MCAP0\r\n"

    def __init__(self, file: Path) -> None:
        self._schemas: dict[int, str] = {}
        super().__init__(file)

    def message(self, block: int, offset: int, most_bytes: int = MOST_BYTES) -> bytes:
        content = super().message(block, offset, most_bytes)
        if content.startswith(ZSTD_MAGIC):  # each message compressed for itself: neither CDR nor ROS 1 begins so
            return expanded(super().message(block, offset), "zstd", most_bytes)
        return content

    def _walk_record(self, position: int) -> int | None:
        kind, start, length = _record(self._bytes, position)
        end = start + length
        if kind == _CHUNK:
            self._add_chunk(start, length)
        if end > self._size:
            raise BrokenRecord("the file ends inside a record")
        if kind == _INDEX:
            self._add_index(self._index_bytes(start, length))
        elif kind in (_SCHEMA, _CHANNEL, _MESSAGE):
            self._scan_record(self._bytes, position, OUTSIDE)
        elif kind == _FOOTER:
            if self._bytes(end, len(self.magic)) != self.magic:
                raise BrokenRecord("no end mark after the footer")
            return None
        elif kind == 0:
            raise BrokenRecord("there is no record of kind 0")
        return end

    def _add_chunk(self, start: int, length: int) -> None:
        head = self._bytes(start, _CHUNK_HEAD.size)
        if len(head) < _CHUNK_HEAD.size:
            raise BrokenRecord("the file ends inside a chunk's header")
        _, _, size, _, name_bytes = _CHUNK_HEAD.unpack(head)
        name = self._bytes(start + _CHUNK_HEAD.size, min(name_bytes, 20))
        data = start + _CHUNK_HEAD.size + name_bytes + 8
        stored = self._bytes(data - 8, 8)
        if len(stored) < 8 or name_bytes > 20:
            raise BrokenRecord("a chunk without a compression")
        stored_bytes = int.from_bytes(stored, "little")
        if stored_bytes > start + length - data:
            raise BrokenRecord(f"a chunk of {stored_bytes} bytes in a record of {length}")
        chunk = Chunk(data, min(stored_bytes, self._size - data), name.decode(errors="replace"), size)
        self.add_chunk(chunk)

    def _add_index(self, content: bytes) -> None:
        if len(content) < 6 or (len(content) - 6) % _INDEX_ENTRY.size:
            raise BrokenRecord(f"an index of {len(content)} bytes")
        self.add_index(int.from_bytes(content[:2], "little"), _index_entries(content[6:]))

    def _scan_record(self, window: Window, offset: int, block: int) -> int:
        kind, start, length = _record(window, offset)
        if length and not window(start + length - 1, 1):
            raise BrokenRecord("it ends inside a record")
        if kind in (_SCHEMA, _CHANNEL):
            content = window(start, min(length, _LONGEST_DESCRIPTION))
            (self._add_schema if kind == _SCHEMA else self._add_channel)(content)
        elif kind == _MESSAGE and block not in self._indexed:
            head = window(start, _MESSAGE_HEAD.size)
            if len(head) < _MESSAGE_HEAD.size:
                raise BrokenRecord("a message without a head")
            number, _, time_ns, _ = _MESSAGE_HEAD.unpack(head)
            if number not in self._by_id:
                raise BrokenRecord(f"a message of channel {number}, which is not described")
            self._by_id[number].add(_checked_ns(time_ns), block, offset)
        return start + length

    def _add_schema(self, content: bytes) -> None:
        name, _ = _text(content, 2)
        self._schemas[int.from_bytes(content[:2], "little")] = name

    def _add_channel(self, content: bytes) -> None:
        number, schema = (int.from_bytes(content[place : place + 2], "little") for place in (0, 2))
        topic, position = _text(content, 4)
        encoding, _ = _text(content, position)
        self.add_channel(number, topic, type_from_name(self._schemas.get(schema, "")), encoding)

    def _content(self, window: Window, offset: int) -> tuple[int, int]:
        kind, start, length = _record(window, offset)
        if kind != _MESSAGE or length < _MESSAGE_HEAD.size:
            raise BrokenRecord("the index points to something else")
        return start + _MESSAGE_HEAD.size, length - _MESSAGE_HEAD.size


def _record(window: Window, offset: int) -> tuple[int, int, int]:
    """The kind of a record, where its content starts and how long it is. Raises BrokenRecord."""
    head = window(offset, _RECORD.size)
    if len(head) < _RECORD.size:
        raise BrokenRecord("it ends inside a record's head")
    kind, length = _RECORD.unpack(head)
    return kind, offset + _RECORD.size, length


def _text(content: bytes, position: int) -> tuple[str, int]:
    """A string with its length before it, and where it ends. Raises BrokenRecord."""
    end = position + 4 + int.from_bytes(content[position : position + 4], "little")
    if end > len(content):
        raise BrokenRecord("a text that is cut short")
    return content[position + 4 : end].decode(errors="replace"), end


def _index_entries(content: bytes) -> Iterator[tuple[int, int]]:
    for time_ns, offset in _INDEX_ENTRY.iter_unpack(content):
        yield _checked_ns(time_ns), _checked_ns(offset)


def _checked_ns(number: int) -> int:
    if number > _LATEST_NS:
        raise BrokenRecord(f"{number} is no time or place")
    return int(number)
