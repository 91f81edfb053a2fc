"""A recording: its files, the topics in them, and random access to a topic's messages.

rosbags reads bags of ROS 1 and SQLite files of ROS 2, mcap reads MCAP files of any profile. Their `AnyReader` and
decoders are not used: these turn the definitions in a bag into Python code, and a bag may be untrusted.
"""

from __future__ import annotations

import os
import re
import struct
import sys
from abc import ABC, abstractmethod
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from heapq import merge
from itertools import islice
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np
from mcap.reader import make_reader
from numpy.typing import NDArray
from rosbags.rosbag1 import Reader as Ros1Reader
from rosbags.rosbag2 import Reader as Ros2Reader

from codecbench.core.contracts.errors import DatasetError
from codecbench.plugins.datasets.bag.messages import deserialize, kind_of, stamp_ns
from codecbench.plugins.datasets.folder import natural_key

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

Integers = NDArray[np.int64]
Stamped = tuple[int, bytes]
"""The time when a message was recorded, in ns, and its bytes."""

_IN_FOLDERS: Final = (".mcap", ".db3")
"""Suffixes of the files in a ROS 2 bag's folder."""
_NUMBER: Final = re.compile(r"(^|_)\d+$")
_MOST_NAMES: Final = 20
_HEAD_BYTES: Final = 12
_MOST_BYTES: Final = 1 << 28
"""256 MiB: the most that a compressed message may expand to."""
_ZSTD_MAGIC: Final = b"\x28\xb5\x2f\xfd"
_OPEN_AT_ONCE: Final = 4


@dataclass(frozen=True)
class Topic:
    """A topic; its length is the number of its messages."""

    name: str
    type: str
    """Message type, such as `sensor_msgs/msg/Image` or `foxglove.RawImage`."""
    encoding: str
    """How messages are serialized, such as `cdr`, `ros1`, `protobuf` or `json`."""
    count: int

    def __len__(self) -> int:
        return self.count

    @property
    def kind(self) -> str:
        """The ROS type whose fields its deserialized messages have; empty if they cannot be deserialized."""
        return kind_of(self.type, self.encoding)


class BagFile(ABC):
    """A file of messages."""

    kind: ClassVar[str]
    """Name of the file format."""
    remedy: ClassVar[str]
    """Command that repairs such a file."""

    @abstractmethod
    def __init__(self, file: Path) -> None:
        """Open a file and read its index; exceptions of the libraries for a damaged file pass through."""

    @abstractmethod
    def topics(self) -> Iterator[Topic]:
        """Yield the topics of the file, once for each publisher."""

    @abstractmethod
    def messages(self, topic: str, start_ns: int) -> Iterator[Stamped]:
        """Yield a topic's messages recorded at `start_ns` or later, in the order of their times."""


class _RosFile(BagFile):
    reader: ClassVar[type[Any]]

    def __init__(self, file: Path) -> None:
        self._reader = self.reader(file)
        self._reader.open()

    def topics(self) -> Iterator[Topic]:
        for connection in self._reader.connections:
            encoding = getattr(connection.ext, "serialization_format", "ros1")
            yield Topic(connection.topic, type_from_name(connection.msgtype), encoding, connection.msgcount)

    def messages(self, topic: str, start_ns: int) -> Iterator[Stamped]:
        connections = [connection for connection in self._reader.connections if connection.topic == topic]
        if connections:
            for _, time_ns, content in self._reader.messages(connections, start=start_ns):
                yield time_ns, content


class _Ros1File(_RosFile):
    kind, remedy, reader = "ROS 1 bag", "rosbag reindex {name}", Ros1Reader


class _SqliteFile(_RosFile):
    kind, remedy, reader = "SQLite bag", "sqlite3 {name} .recover | sqlite3 whole.db3", Ros2Reader


class _McapFile(BagFile):
    kind, remedy = "MCAP file", "mcap recover {name} -o whole.mcap"

    def __init__(self, file: Path) -> None:
        self._reader = make_reader(open(file, "rb"))  # noqa: SIM115 - open as long as the sequence lives
        summary = self._reader.get_summary()
        if summary is None or summary.statistics is None:
            raise ValueError("it has no index at its end")
        counts = summary.statistics.channel_message_counts
        self._topics = []
        for number, channel in summary.channels.items():
            schema = summary.schemas.get(channel.schema_id)
            type_ = type_from_name(schema.name) if schema is not None else ""
            self._topics.append(Topic(channel.topic, type_, channel.message_encoding, counts.get(number, 0)))

    def topics(self) -> Iterator[Topic]:
        return iter(self._topics)

    def messages(self, topic: str, start_ns: int) -> Iterator[Stamped]:
        for _, _, message in self._reader.iter_messages([topic], starting_at=start_ns):
            yield message.log_time, message.data


_KINDS: Final[dict[str, type[BagFile]]] = {".bag": _Ros1File, ".mcap": _McapFile, ".db3": _SqliteFile}


class Recording:
    """A ROS 1 bag, a ROS 2 bag of one or several files, or an MCAP file.

    kind: name of the format. remarks: notes on parts that are not read.
    """

    def __init__(self, path: Path, files: list[Path]) -> None:
        self.path = path
        self._paths = files
        self._process = 0
        self._indexes: dict[str, tuple[Integers, Integers, str | None]] = {}
        open_files = self._files()
        self.kind = "ROS 2 bag" if path.is_dir() else open_files[0].kind
        self.topics = {topic.name: topic for topic in self._merge_topics(open_files)}
        logs = [file.with_name(f"{file.name}-wal") for file in files]
        self.remarks = [
            f"messages that are only in {log.name} are not read: "
            f"`sqlite3 {log.name.removesuffix('-wal')} 'PRAGMA wal_checkpoint'` puts it into the bag"
            for log in logs
            if log.exists() and log.stat().st_size
        ]

    def raw(self, topic: Topic, number: int) -> bytes:
        """The bytes of a message; reading in order is fast. Raises DatasetError."""
        self._files()
        if self._next != (topic.name, number):
            times_ns = self.index(topic)[0] if number else np.zeros(1, np.int64)
            start_ns = int(times_ns[number])
            before = number - int(np.searchsorted(times_ns, start_ns))
            self._cursor = islice(self._stream(topic, start_ns), before, None)
        self._next = ("", -1)
        _, content = next(self._cursor, (0, None))
        if content is None:
            raise DatasetError(f"{self.where(topic, number)}: no longer exists")
        self._next = (topic.name, number + 1)
        return content

    def message(self, topic: Topic, number: int) -> Any:
        """A deserialized message. Raises DatasetError."""
        return deserialize(self.raw(topic, number), topic.type, topic.encoding, self.where(topic, number))

    def messages(self, topic: Topic) -> Iterator[tuple[int, Any]]:
        """Yield the recording time in ns and the deserialized message, for each in order. Raises DatasetError."""
        for number, (time_ns, content) in enumerate(self._stream(topic, 0)):
            yield time_ns, deserialize(content, topic.type, topic.encoding, self.where(topic, number))

    def where(self, topic: Topic, number: int) -> str:
        """Name of a message in errors."""
        return f"{self.path}: {topic.name}[{number}]"

    def index(self, topic: Topic) -> tuple[Integers, Integers, str | None]:
        """Recording times and header times of a topic's messages in ns, and the damage that ends both early, or None.

        The whole topic is read, once. Raises DatasetError if the first message is damaged.
        """
        if topic.name not in self._indexes:
            times_ns: list[int] = []
            headers_ns: list[int] = []
            damage = None
            try:
                for number, (time_ns, content) in enumerate(self._stream(topic, 0)):
                    headers_ns.append(_header_time_ns(content, topic, self.where(topic, number)))
                    times_ns.append(time_ns)
            except DatasetError as error:
                if not times_ns:
                    raise
                damage = str(error)
            self._indexes[topic.name] = np.array(times_ns, np.int64), np.array(headers_ns, np.int64), damage
        return self._indexes[topic.name]

    def _files(self) -> list[BagFile]:
        """The open files; a forked process reopens them, because forks share the position in an open file."""
        if self._process != os.getpid():
            self._next, self._cursor = ("", -1), iter(())
            open_files = []
            for file in self._paths:
                with _damage_of(file):
                    open_files.append(_KINDS[file.suffix](file))
            self._open_files, self._process = open_files, os.getpid()
        return self._open_files

    _open_files: list[BagFile]
    _next: tuple[str, int]
    _cursor: Iterator[Stamped]

    def _stream(self, topic: Topic, start_ns: int) -> Iterator[Stamped]:
        """Yield a topic's messages of all files from `start_ns` on, in the order of their times."""
        parts = [
            _expand_messages(path, file.messages(topic.name, start_ns))
            for path, file in zip(self._paths, self._files(), strict=True)
        ]
        return merge(*parts, key=lambda stamped: stamped[0])

    def _merge_topics(self, files: list[BagFile]) -> Iterator[Topic]:
        """Merge the topics of all files by name. Raises DatasetError if a topic has two types."""
        parts: dict[str, list[Topic]] = {}
        for file in files:
            for topic in file.topics():
                parts.setdefault(topic.name, []).append(topic)
        for name, topics in sorted(parts.items()):
            kinds = sorted({(topic.type, topic.encoding) for topic in topics})
            if len(kinds) > 1 and any(topic.kind for topic in topics):
                raise DatasetError(
                    f"{self.path}: topic {name} has messages of {kinds}; only topics of one type are supported"
                )
            yield Topic(name, *kinds[0], sum(topic.count for topic in topics))


@contextmanager
def _damage_of(file: Path) -> Iterator[None]:
    """Turn exceptions of the libraries into a DatasetError that names a command to repair the file."""
    try:
        yield
    except DatasetError:
        raise
    except Exception as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        remedy = _KINDS[file.suffix].remedy.format(name=file.name)
        raise DatasetError(
            f"{file}: cannot be read, is damaged or was not closed ({reason}); `{remedy}` recovers what is left"
        ) from error


def _expand_messages(file: Path, messages: Iterator[Stamped]) -> Iterator[Stamped]:
    """Yield the messages, decompressed if need be. Raises DatasetError for a damaged file."""
    with _damage_of(file):
        for time_ns, content in messages:
            packed = content[:4] == _ZSTD_MAGIC
            yield time_ns, zstd.ZstdDecompressor().decompress(content, max_length=_MOST_BYTES) if packed else content


def type_from_name(name: str) -> str:
    """Spell a message type as ROS 2 does: `sensor_msgs/Image` becomes `sensor_msgs/msg/Image`."""
    package, _, last = name.partition("/")
    return name if "/" in last or not last else f"{package}/msg/{last}"


def _header_time_ns(content: bytes, topic: Topic, where: str) -> int:
    """The time in ns in the header at a message's beginning. Raises DatasetError, naming `where`."""
    if topic.encoding not in ("cdr", "ros1"):
        return stamp_ns(deserialize(content, topic.type, topic.encoding, where).header)
    if len(content) < _HEAD_BYTES:
        raise DatasetError(f"{where}: {len(content)} bytes are too few for a header")
    big = topic.encoding == "cdr" and content[1] == 0
    # CDR begins with 4 bytes of encapsulation, ROS 1 with the header's sequence number.
    seconds, nanoseconds = struct.unpack(">iI" if big else "<iI", content[4:_HEAD_BYTES])
    return int(seconds) * 1_000_000_000 + int(nanoseconds)


def _are_several_recordings(files: list[Path]) -> bool:
    """Whether files belong to several recordings; those of one are numbered: `walk_0.db3`, `walk_1.db3`."""
    return len({(_NUMBER.sub("", file.stem), file.suffix) for file in files}) > 1


def has_bag_name(path: Path) -> bool:
    """Whether the suffix of a file, or of a file in a folder, is that of a bag."""
    if not path.is_dir():
        return path.suffix in _KINDS and path.is_file()
    return any(file.suffix in _IN_FOLDERS and file.is_file() for file in path.iterdir())


def open_recording(path: Path) -> Recording:
    """Open the recording at `path`; the process caches it until its files change. Raises DatasetError."""
    files = _files(path)
    try:
        versions = tuple((file, file.stat().st_size, file.stat().st_mtime_ns) for file in files)
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read: {error.strerror}") from error
    return _open_version(path, versions)


@lru_cache(maxsize=_OPEN_AT_ONCE)
def _open_version(path: Path, versions: tuple[tuple[Path, int, int], ...]) -> Recording:
    return Recording(path, [file for file, _, _ in versions])


def _files(path: Path) -> list[Path]:
    """The files of a recording in natural order. Raises DatasetError if it is no bag."""
    if not path.is_dir():
        if not path.exists():
            raise DatasetError(
                f"{path}: does not exist; set `path` to a .bag, .mcap or .db3 file or a ROS 2 bag's folder"
            )
        if path.suffix not in _KINDS:
            raise DatasetError(
                f"{path}: ends in {path.suffix!r}; .bag, .mcap, .db3 and folders of the last two are supported"
            )
        return [path]
    files = sorted((file for file in path.iterdir() if file.suffix in _KINDS and file.is_file()), key=natural_key)
    if _are_several_recordings(files):
        names = ", ".join(file.name for file in files[:_MOST_NAMES]) + (", ..." if len(files) > _MOST_NAMES else "")
        raise DatasetError(f"{path}: contains several recordings; set `path` to one of them: {names}")
    if files and files[0].suffix in _IN_FOLDERS:
        return files
    packed = next((file.name for file in sorted(path.iterdir()) if file.suffix == ".zstd"), None)
    if packed is not None:
        raise DatasetError(f"{path / packed}: is compressed as a whole; expand the folder's files with `zstd -d` first")
    raise DatasetError(f"{path}: contains no .mcap or .db3 file; set `path` to a .bag file or a ROS 2 bag's folder")
