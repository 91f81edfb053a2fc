"""What ROS 1 bags and MCAP files have in common: records one after another, messages in chunks with an index each.

A file is walked from record to record, and what records hold is skipped, so that opening costs a few small reads a
chunk; a file that was cut has lost its index at the end but not those. Only where a chunk has no index is it expanded.
Reads name their place (`pread`), so processes that share an open file do not disturb each other.
"""

from __future__ import annotations

import os
from abc import abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from codecbench.core.contracts.errors import DatasetError
from codecbench.plugins.datasets.bag.bag_file import BagFile, Channel
from codecbench.plugins.datasets.bag.expansion import COMPRESSIONS, MOST_BYTES, expanded

Window = Callable[[int, int], bytes]
"""Bytes from an offset, of a length; fewer where the block ends."""

OUTSIDE: Final = -1
"""The block of messages that lie in no chunk; their offsets count from the start of the file."""


class BrokenRecord(Exception):
    """A record that is cut short or none; the walk ends before it."""


@dataclass(frozen=True)
class Chunk:
    """Where the stored bytes of a chunk start, how many there are, how they are compressed and what they expand to."""

    start: int
    stored_bytes: int
    compression: str
    size_bytes: int

    @property
    def is_plain(self) -> bool:
        return self.compression in ("", "none")


class ChunkedFile(BagFile):
    """A file of records. Subclasses know what a record looks like."""

    magic: bytes

    def __init__(self, file: Path) -> None:
        super().__init__(file)
        try:
            self._stream = open(file, "rb", buffering=0)  # noqa: SIM115 - read as long as the sequence lives
        except OSError as error:
            raise DatasetError(f"{file}: cannot be read: {error.strerror}") from error
        self._size = os.fstat(self._stream.fileno()).st_size
        self._chunks: list[Chunk] = []
        self._by_id: dict[int, Channel] = {}
        self._indexed: set[int] = set()
        self._unknown: set[int] = set()
        self._held: tuple[int, bytes] = (OUTSIDE, b"")
        if self._bytes(0, len(self.magic)) != self.magic:
            raise DatasetError(f"{file}: does not begin as such a file does; fetch or copy it again")
        self._walk()
        self._scan_chunks_without_index()
        self.channels = [channel for _, channel in sorted(self._by_id.items())]

    @abstractmethod
    def _walk_record(self, position: int) -> int | None:
        """Take in the record at `position` and return where the next is, None after the last.

        Raises BrokenRecord where it is cut short or none.
        """

    @abstractmethod
    def _scan_record(self, window: Window, offset: int, block: int) -> int:
        """Take in the record at `offset` of a chunk and return where the next is. Raises BrokenRecord."""

    @abstractmethod
    def _content(self, window: Window, offset: int) -> tuple[int, int]:
        """Where the content of the message at `offset` is, and its length. Raises BrokenRecord."""

    def message(self, block: int, offset: int, most_bytes: int = MOST_BYTES) -> bytes:
        window = self._window(block)
        try:
            start, length = self._content(window, offset)
        except BrokenRecord as error:
            raise DatasetError(f"{self.file}: no message at byte {offset} of chunk {block}: {error}") from error
        if length > MOST_BYTES:
            raise self.too_large(f"the message at byte {offset} of chunk {block}", length)
        wanted = min(length, most_bytes)
        content = window(start, wanted)
        if len(content) < wanted:
            raise DatasetError(f"{self.file}: the message at byte {offset} of chunk {block} is cut short")
        return content

    def add_index(self, channel: int, entries: Iterator[tuple[int, int]]) -> None:
        """Take in the index of the last chunk for a channel: times in ns and offsets."""
        block = len(self._chunks) - 1
        if block < 0:
            raise BrokenRecord("an index before the first chunk")
        self._indexed.add(block)
        known = self._by_id.setdefault(channel, Channel("", "", ""))
        if not known.topic:
            self._unknown.add(block)
        for time_ns, offset in entries:
            known.add(time_ns, block, offset)

    def add_channel(self, number: int, topic: str, type_: str, encoding: str) -> None:
        """Take in what a channel is called."""
        known = self._by_id.setdefault(number, Channel(topic, type_, encoding))
        known.topic, known.type, known.encoding = topic, type_, encoding

    def add_chunk(self, chunk: Chunk) -> None:
        if chunk.compression not in COMPRESSIONS:
            raise DatasetError(f"{self.file}: the compression {chunk.compression[:20]!r} is not known")
        self._chunks.append(chunk)

    def _index_bytes(self, start: int, length: int) -> bytes:
        if length > MOST_BYTES:
            raise self.too_large(f"the index at byte {start}", length)
        return self._bytes(start, length)

    def _bytes(self, start: int, length: int) -> bytes:
        return os.pread(self._stream.fileno(), length, start) if 0 <= start < self._size else b""

    def _walk(self) -> None:
        position: int | None = len(self.magic)
        try:
            while position is not None:
                if position >= self._size:
                    raise BrokenRecord("the file ends without its index")
                position = self._walk_record(position)
        except BrokenRecord as error:
            self.damage = f"{self.file}: is damaged or was not closed at byte {position} of {self._size}: {error}"

    def _scan_chunks_without_index(self) -> None:
        """Expand the chunks that have no index, the last of a damaged file, and those that may name a channel."""
        last = len(self._chunks) - 1
        if self.damage is not None and last >= 0:
            self._indexed.discard(last)
            for channel in self._by_id.values():
                channel.drop_block(last)
        for block in range(len(self._chunks)):
            unnamed = block in self._unknown and not all(channel.topic for channel in self._by_id.values())
            if block not in self._indexed or unnamed:
                self._scan(block)

    def _scan(self, block: int) -> None:
        window, offset = self._window(block), 0
        try:
            while window(offset, 1):
                offset = self._scan_record(window, offset, block)
        except BrokenRecord:
            if self.damage is None:
                self.damage = f"{self.file}: chunk {block} is damaged at its byte {offset}"

    def _window(self, block: int) -> Window:
        if block == OUTSIDE:
            return self._bytes
        if not 0 <= block < len(self._chunks):
            raise DatasetError(f"{self.file}: there is no chunk {block}")
        chunk = self._chunks[block]
        if chunk.is_plain:
            return lambda offset, length: self._bytes(
                chunk.start + offset, min(length, max(chunk.stored_bytes - offset, 0))
            )
        if self._held[0] != block:
            if max(chunk.size_bytes, chunk.stored_bytes) > MOST_BYTES:
                raise self.too_large(f"chunk {block}", max(chunk.size_bytes, chunk.stored_bytes))
            self._held = OUTSIDE, b""  # before the next is there
            stored = self._bytes(chunk.start, chunk.stored_bytes)
            self._held = block, expanded(stored, chunk.compression, chunk.size_bytes)
        data = self._held[1]
        return lambda offset, length: data[offset : offset + length]
