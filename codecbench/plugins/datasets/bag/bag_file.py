"""One file of a recording: which topics it holds, and where the messages of each lie."""

from __future__ import annotations

from abc import ABC, abstractmethod
from array import array
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.errors import DatasetError
from codecbench.plugins.datasets.bag.expansion import MOST_BYTES

Integers = NDArray[np.int64]


@dataclass
class Channel:
    """The messages of one topic from one publisher, in the order of the file.

    type: such as `sensor_msgs/msg/Image`. encoding: `cdr` or `ros1`, or another that is not read. times_ns: when they
    were recorded. blocks, offsets: where they lie; what these mean is the file's business.
    """

    topic: str
    type: str
    encoding: str
    times_ns: array[int] = field(default_factory=lambda: array("q"))
    blocks: array[int] = field(default_factory=lambda: array("q"))
    offsets: array[int] = field(default_factory=lambda: array("q"))

    def add(self, time_ns: int, block: int, offset: int) -> None:
        self.times_ns.append(time_ns)
        self.blocks.append(block)
        self.offsets.append(offset)

    def drop_last(self) -> None:
        for numbers in (self.times_ns, self.blocks, self.offsets):
            numbers.pop()

    def clear(self) -> None:
        for numbers in (self.times_ns, self.blocks, self.offsets):
            del numbers[:]

    def drop_block(self, block: int) -> None:
        """Forget the messages of a block that came last."""
        while self.blocks and self.blocks[-1] == block:
            self.drop_last()

    @property
    def places(self) -> Integers:
        """(N, 3) time in ns, block and offset."""
        columns = [np.frombuffer(numbers, np.int64) for numbers in (self.times_ns, self.blocks, self.offsets)]
        return np.stack(columns, axis=1) if len(self.times_ns) else np.empty((0, 3), np.int64)


class BagFile(ABC):
    """A file of messages; opening it finds where they lie and reads none.

    kind: what such a file is called. damage: what is wrong with the file and how far it is read, or None.
    """

    kind: ClassVar[str]
    damage: str | None = None

    def __init__(self, file: Path) -> None:
        self.file = file
        self.channels: list[Channel] = []

    @abstractmethod
    def message(self, block: int, offset: int, most_bytes: int = MOST_BYTES) -> bytes:
        """The first `most_bytes` of a message. Raises DatasetError where it is damaged or larger than is read."""

    def too_large(self, what: str, size_bytes: int) -> DatasetError:
        """The error for something that claims more than MOST_BYTES."""
        return DatasetError(f"{self.file}: {what} claims {size_bytes} bytes; at most {MOST_BYTES} are read")


def type_from_name(name: str) -> str:
    """A message type as ROS 2 spells it: `sensor_msgs/Image` becomes `sensor_msgs/msg/Image`."""
    package, _, last = name.partition("/")
    return name if "/" in last or not last else f"{package}/msg/{last}"
