"""ROS 1 bags, version 2.0. Source: the ROS wiki's page "Bags/Format/2.0"."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Final

from codecbench.plugins.datasets.bag.bag_file import type_from_name
from codecbench.plugins.datasets.bag.chunked_file import OUTSIDE, BrokenRecord, Chunk, ChunkedFile, Window

_MESSAGE, _BAG_HEADER, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION = range(2, 8)
_LONGEST_HEADER: Final = 1 << 16
_U32 = struct.Struct("<I")
_INDEX_ENTRY = struct.Struct("<III")
Fields = dict[bytes, bytes]


class Ros1File(ChunkedFile):
    """A `.bag` file of ROS 1."""

    kind = "ROS 1 bag"
    magic = b"#ROSBAG V2.0\n"

    def _walk_record(self, position: int) -> int | None:
        fields, start, length = _record(self._bytes, position)
        op, end = _byte(fields, b"op"), start + length
        if op == _CHUNK:
            compression = fields.get(b"compression", b"").decode(errors="replace")
            self.add_chunk(Chunk(start, min(length, self._size - start), compression, _number(fields, b"size")))
        if end > self._size:
            raise BrokenRecord("the file ends inside a record")
        if op == _INDEX:
            entries = self._index_bytes(start, length)
            if len(entries) % _INDEX_ENTRY.size:
                raise BrokenRecord(f"an index of {length} bytes")
            self.add_index(_number(fields, b"conn"), _index_entries(entries))
        elif op in (_MESSAGE, _CONNECTION):
            self._scan_record(self._bytes, position, OUTSIDE)
        elif op not in (_BAG_HEADER, _CHUNK, _CHUNK_INFO):
            raise BrokenRecord(f"there is no record of kind {op}")
        return None if end == self._size and op in (_CHUNK_INFO, _CONNECTION) else end

    def _scan_record(self, window: Window, offset: int, block: int) -> int:
        fields, start, length = _record(window, offset)
        op, number = _byte(fields, b"op"), _number(fields, b"conn")
        if length and not window(start + length - 1, 1):
            raise BrokenRecord("it ends inside a record")
        if op == _CONNECTION:
            inner = _fields(window(start, min(length, _LONGEST_HEADER * 16)))
            topic = fields.get(b"topic", b"").decode(errors="replace")
            self.add_channel(number, topic, type_from_name(inner.get(b"type", b"").decode(errors="replace")), "ros1")
        elif op == _MESSAGE and block not in self._indexed:
            channel = self._by_id.get(number)
            if channel is None:
                raise BrokenRecord(f"a message of connection {number}, which is not described")
            time = fields.get(b"time", b"")
            if len(time) != 8:
                raise BrokenRecord("a message without a time")
            channel.add(_nanoseconds(*struct.unpack("<II", time)), block, offset)
        return start + length

    def _content(self, window: Window, offset: int) -> tuple[int, int]:
        fields, start, length = _record(window, offset)
        while _byte(fields, b"op") == _CONNECTION:
            fields, start, length = _record(window, start + length)
        if _byte(fields, b"op") != _MESSAGE:
            raise BrokenRecord("the index points to something else")
        return start, length


def _record(window: Window, offset: int) -> tuple[Fields, int, int]:
    """The header's fields of a record, where its data start and how long they are. Raises BrokenRecord."""
    head = window(offset, 4)
    header_bytes = _U32.unpack(head)[0] if len(head) == 4 else 0
    if not 0 < header_bytes <= _LONGEST_HEADER:
        raise BrokenRecord(f"a record's header of {header_bytes} bytes")
    content = window(offset + 4, header_bytes + 4)
    if len(content) < header_bytes + 4:
        raise BrokenRecord("it ends inside a record's header")
    (length,) = _U32.unpack_from(content, header_bytes)
    return _fields(content[:header_bytes]), offset + 8 + header_bytes, length


def _fields(content: bytes) -> Fields:
    fields: Fields = {}
    position = 0
    while position + 4 <= len(content):
        (length,) = _U32.unpack_from(content, position)
        name, found, value = content[position + 4 : position + 4 + length].partition(b"=")
        if not found:
            raise BrokenRecord("a field without a value")
        fields[name] = value
        position += 4 + length
    return fields


def _byte(fields: Fields, name: bytes) -> int:
    value = fields.get(name, b"")
    if len(value) != 1:
        raise BrokenRecord(f"a record without `{name.decode()}`")
    return value[0]


def _number(fields: Fields, name: bytes) -> int:
    value = fields.get(name, b"")
    if len(value) != 4:
        raise BrokenRecord(f"a record without `{name.decode()}`")
    return int(_U32.unpack(value)[0])


def _index_entries(content: bytes) -> Iterator[tuple[int, int]]:
    for seconds, nanoseconds, offset in _INDEX_ENTRY.iter_unpack(content):
        yield _nanoseconds(seconds, nanoseconds), offset


def _nanoseconds(seconds: int, nanoseconds: int) -> int:
    return seconds * 1_000_000_000 + nanoseconds
