"""The sqlite3 files of ROS 2 bags. Source: rosbag2's schema, versions 1 to 4."""

from __future__ import annotations

import os
import sqlite3
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from codecbench.core.contracts.errors import DatasetError
from codecbench.plugins.datasets.bag.bag_file import BagFile, Channel, type_from_name
from codecbench.plugins.datasets.bag.expansion import MOST_BYTES, ZSTD_MAGIC, expanded
from codecbench.plugins.datasets.bag.sqlite_pages import BrokenRowError, Pages, page_bytes_of

_MAGIC: Final = b"SQLite format 3\0"
_ERRORS: Final = (sqlite3.Error, UnicodeDecodeError, BrokenRowError)
"""What reading a damaged file raises; Python cannot spell every message of SQLite's."""


class SqliteFile(BagFile):
    """A `.db3` file. Blocks are always 0; offsets are rows, or where these lie in a file whose tree is broken."""

    kind = "ROS 2 bag"

    def __init__(self, file: Path) -> None:
        super().__init__(file)
        try:
            with open(file, "rb") as stream:
                head = stream.read(100)
            self._wal_bytes = os.path.getsize(f"{file}-wal") if os.path.exists(f"{file}-wal") else 0
            size = os.path.getsize(file)
        except OSError as error:
            raise DatasetError(f"{file}: cannot be read: {error.strerror}") from error
        if not head.startswith(_MAGIC):
            raise DatasetError(f"{file}: is not an SQLite file; fetch or copy it again")
        self._connection: tuple[int, sqlite3.Connection] | None = None
        self._pages: Pages | None = None
        self._find_damage(head, size)
        try:
            self._read_index()
        except _ERRORS as error:
            raise DatasetError(f"{file}: is not a bag, or damaged where its topics are listed: {error}") from error

    def message(self, block: int, offset: int, most_bytes: int = MOST_BYTES) -> bytes:
        where = f"the message of row {offset}" if self._pages is None else f"the message at byte {offset}"
        try:
            size, content = self._stored(offset, most_bytes)
            if size > MOST_BYTES:
                raise self.too_large(where, size)
            if content.startswith(ZSTD_MAGIC):
                return expanded(self._stored(offset, MOST_BYTES)[1], "zstd", most_bytes)
            return content
        except _ERRORS as error:
            raise DatasetError(f"{self.file}: {where} is damaged: {error}") from error

    def _stored(self, offset: int, most_bytes: int) -> tuple[int, bytes]:
        """The size of a message, and its first bytes, none of one that is too large."""
        if self._pages is not None:
            size = self._pages.size(offset)
            return size, self._pages.message(offset, most_bytes) if size <= MOST_BYTES else b""
        with self._opened().blobopen("messages", "data", offset, readonly=True) as blob:
            size = len(blob)
            return size, blob.read(min(size, most_bytes)) if size <= MOST_BYTES else b""

    def _find_damage(self, head: bytes, size_bytes: int) -> None:
        wanted = int.from_bytes(head[28:32], "big") * page_bytes_of(head)
        self._is_whole = size_bytes >= wanted
        if not self._is_whole:
            self.damage = f"{self.file}: is cut short: {size_bytes} of {wanted} bytes"
        elif self._wal_bytes:
            remedy = f"`sqlite3 {self.file.name} 'PRAGMA wal_checkpoint'` on a copy of both puts it in"
            self.damage = f"{self.file}: was not closed; what is only in {self.file.name}-wal is not read: {remedy}"

    def _opened(self) -> sqlite3.Connection:
        """The connection of this process: a fork must not use its parent's."""
        if self._connection is None or self._connection[0] != os.getpid():
            where = f"{self.file.resolve().as_uri()}?mode=ro&immutable=1"
            connection = sqlite3.connect(where, uri=True, check_same_thread=False)
            connection.text_factory = lambda text: text.decode(errors="replace")
            connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MOST_BYTES)
            connection.execute("PRAGMA trusted_schema = OFF")
            connection.execute("PRAGMA cell_size_check = ON")
            if self.damage is not None:  # else SQLite reads nothing of a file that is shorter than it says
                connection.execute("PRAGMA writable_schema = ON")
            self._connection = os.getpid(), connection
        return self._connection[1]

    def _read_index(self) -> None:
        connection = self._opened()
        tables = {name for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
        if not {"topics", "messages"} <= tables:
            more = f"; {self.damage}" if self.damage else ""
            raise DatasetError(f"{self.file}: holds no tables `topics` and `messages`, as a ROS 2 bag does{more}")
        by_id: dict[Any, Channel] = {}
        for number, topic, type_, encoding in connection.execute(
            "SELECT id, name, type, serialization_format FROM topics"
        ):
            by_id[number] = Channel(str(topic), type_from_name(str(type_)), str(encoding))
        self.channels = list(by_id.values())
        if self._is_whole:
            try:
                for row, number, time_ns in connection.execute(
                    "SELECT rowid, topic_id, timestamp FROM messages ORDER BY rowid"
                ):
                    if number in by_id and isinstance(time_ns, int):
                        by_id[number].add(time_ns, 0, row)
            except _ERRORS as error:
                self.damage, self._is_whole = f"{self.file}: is damaged: {error}", False
        if not self._is_whole:
            self._find_what_is_left(by_id)
        if self.damage is not None:
            for channel in self.channels:
                self._drop_unreadable(channel)

    def _find_what_is_left(self, by_id: dict[Any, Channel]) -> None:
        """The index of a file whose tree is broken, in place of what was read of it."""
        self._pages = Pages(self.file)
        for channel in self.channels:
            channel.clear()
        rows = {row.rowid: row for row in self._pages.messages() if row.topic in by_id}
        kept = sorted(rows.values(), key=lambda row: row.rowid)
        # The last message may lie on a page that is lost, or is left as zeros, which nothing shows.
        for row in kept[:-1]:
            by_id[row.topic].add(row.time_ns, 0, row.place)
        self.damage = f"{self.damage}; what is left is read"

    def _drop_unreadable(self, channel: Channel) -> None:
        """Forget messages at the end whose pages are gone."""
        while channel.offsets:
            with suppress(DatasetError):
                self.message(0, channel.offsets[-1])
                return
            channel.drop_last()
