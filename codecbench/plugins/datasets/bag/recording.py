"""A recording: one or more files, the topics in them, and any message of a topic by its number."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from codecbench.core.contracts.errors import DatasetError
from codecbench.plugins.datasets.bag.bag_file import BagFile, Integers
from codecbench.plugins.datasets.bag.mcap_file import McapFile
from codecbench.plugins.datasets.bag.messages import ENCODINGS, deserialized
from codecbench.plugins.datasets.bag.ros1_file import Ros1File
from codecbench.plugins.datasets.bag.sqlite_file import SqliteFile
from codecbench.plugins.datasets.folder import natural_key

_KINDS: Final[dict[str, type[BagFile]]] = {".bag": Ros1File, ".mcap": McapFile, ".db3": SqliteFile}
_IN_FOLDERS: Final = (".mcap", ".db3")
"""What ROS 2 puts into the folder of a bag."""
_NUMBER: Final = re.compile(r"(^|_)\d+$")
_MOST_NAMES: Final = 20
_HEAD_BYTES: Final = 12
_OPEN_AT_ONCE: Final = 4


@dataclass(frozen=True)
class Topic:
    """The messages of a topic in the order in which they were recorded.

    places: (N, 4) time in ns, number of the file, block and offset in it.
    """

    name: str
    type: str
    encoding: str
    places: Integers

    def __len__(self) -> int:
        return len(self.places)


class Recording:
    """A ROS 1 bag, a ROS 2 bag of one or several files, or an MCAP file.

    kind: what it is called. damage: for each file that is damaged, what is wrong and how far it is read.
    """

    def __init__(self, path: Path, files: list[Path]) -> None:
        self.path = path
        self._files = [_KINDS[file.suffix](file) for file in files]
        self.damage = [file.damage for file in self._files if file.damage is not None]
        self.kind = "ROS 2 bag" if path.is_dir() else self._files[0].kind
        self.topics = {topic.name: topic for topic in self._merged()}

    def raw(self, topic: Topic, number: int) -> bytes:
        """A message as it was recorded. Raises DatasetError."""
        _, file, block, offset = (int(place) for place in topic.places[number])
        return self._files[file].message(block, offset)

    def message(self, topic: Topic, number: int) -> Any:
        """A message, deserialised. Raises DatasetError."""
        return deserialized(self.raw(topic, number), topic.type, topic.encoding, self.where(topic, number))

    def messages(self, topic: Topic) -> Iterator[Any]:
        """All messages of a topic. Raises DatasetError."""
        return (self.message(topic, number) for number in range(len(topic)))

    def where(self, topic: Topic, number: int) -> str:
        """What to call a message in errors."""
        return f"{self._files[topic.places[number, 1]].file}: {topic.name}[{number}]"

    def header_times_ns(self, topic: Topic) -> tuple[Integers, str | None]:
        """The times in the headers of messages that begin with one, up to the first that is damaged, and what it is.

        Only the headers are read. Raises DatasetError where the first is damaged.
        """
        times_ns: list[int] = []
        for number in range(len(topic)):
            try:
                times_ns.append(self._header_time_ns(topic, number))
            except DatasetError as error:
                if not times_ns:
                    raise
                return np.array(times_ns, np.int64), str(error)
        return np.array(times_ns, np.int64), None

    def _header_time_ns(self, topic: Topic, number: int) -> int:
        _, file, block, offset = (int(place) for place in topic.places[number])
        head = self._files[file].message(block, offset, _HEAD_BYTES)
        if len(head) < _HEAD_BYTES:
            raise DatasetError(f"{self.where(topic, number)}: {len(head)} bytes are too few for a header")
        big = topic.encoding == "cdr" and head[1] == 0
        # CDR has its 4 bytes of encapsulation where ROS 1 has the header's sequence number.
        seconds, nanoseconds = struct.unpack(">iI" if big else "<iI", head[4:])
        return int(seconds) * 1_000_000_000 + int(nanoseconds)

    def _merged(self) -> Iterator[Topic]:
        """Topics from the channels of all files. Raises DatasetError where a topic has two types."""
        parts: dict[str, list[tuple[str, str, Integers]]] = {}
        for number, file in enumerate(self._files):
            for channel in file.channels:
                found = channel.places
                places = np.insert(found, 1, number, axis=1)
                if channel.topic and channel.encoding in ENCODINGS:
                    parts.setdefault(channel.topic, []).append((channel.type, channel.encoding, places))
        for name, channels in sorted(parts.items()):
            kinds = sorted({(type_, encoding) for type_, encoding, _ in channels})
            if len(kinds) > 1:
                raise DatasetError(f"{self.path}: topic {name} has messages of {kinds}; a topic of one type is read")
            places = np.concatenate([part for _, _, part in channels])
            yield Topic(name, *kinds[0], places[np.argsort(places[:, 0], kind="stable")])


def _several(files: list[Path]) -> bool:
    """Whether files are of several recordings: those of one are numbered, `walk_0.db3`, `walk_1.db3`."""
    return len({(_NUMBER.sub("", file.stem), file.suffix) for file in files}) > 1


def is_called_a_bag(path: Path) -> bool:
    """Whether a file's name, or those of a folder's files, say that it is one."""
    if not path.is_dir():
        return path.suffix in _KINDS and path.is_file()
    return any(file.suffix in _IN_FOLDERS and file.is_file() for file in path.iterdir())


def recording(path: Path) -> Recording:
    """The recording at `path`, indexed once a process while its files stay as they are. Raises DatasetError."""
    files = _files(path)
    try:
        versions = tuple((file, file.stat().st_size, file.stat().st_mtime_ns) for file in files)
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read: {error.strerror}") from error
    return _recording(path, versions)


@lru_cache(maxsize=_OPEN_AT_ONCE)
def _recording(path: Path, versions: tuple[tuple[Path, int, int], ...]) -> Recording:
    return Recording(path, [file for file, _, _ in versions])


def _files(path: Path) -> list[Path]:
    """The files of a recording in natural order. Raises DatasetError for what is no bag."""
    if not path.is_dir():
        if not path.exists():
            raise DatasetError(f"{path}: is not there; `path` names a .bag, .mcap or .db3 file or a ROS 2 bag's folder")
        if path.suffix not in _KINDS:
            raise DatasetError(
                f"{path}: ends in {path.suffix!r}; .bag, .mcap, .db3 and folders of the last two are read"
            )
        return [path]
    files = sorted((file for file in path.iterdir() if file.suffix in _KINDS and file.is_file()), key=natural_key)
    if _several(files):
        names = ", ".join(file.name for file in files[:_MOST_NAMES]) + (", ..." if len(files) > _MOST_NAMES else "")
        raise DatasetError(f"{path}: holds several recordings; `path` names one of them: {names}")
    if files and files[0].suffix in _IN_FOLDERS:
        return files
    packed = next((file.name for file in sorted(path.iterdir()) if file.suffix == ".zstd"), None)
    if packed is not None:
        raise DatasetError(f"{path / packed}: is compressed as a whole; expand the folder's files with `zstd -d` first")
    raise DatasetError(f"{path}: holds no .mcap or .db3 file; `path` names a .bag file or a ROS 2 bag's folder")
