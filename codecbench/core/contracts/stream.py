"""Packets, and the sessions that give and take them.

An encoder remembers what it sent, and a decoder what it got.

One session codes one sequence, in order, and all state is in it. Packets leave in the order in which they are decoded;
pictures are counted from 0 in the order in which they were pushed, which is the order in which they are shown.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from enum import Enum
from typing import Final, Literal

from codecbench.core.contracts.image import Image
from codecbench.core.counting.trace import NULL_TRACE, Trace

PictureState = Literal["whole", "concealed", "missing"]
"""`whole`: what the encoder meant. `concealed`: made up in part from others. `missing`: there is no picture."""


class Loss(Enum):
    """The one value that stands for a packet which never came."""

    LOST = "lost"


LOST: Final = Loss.LOST


@dataclass(frozen=True)
class Packet:
    """What is sent of one picture.

    data: every byte that the decoder needs of it, headers included. frame: which picture of the session it is; a link
    carries it as it carries time stamps, so it is not counted. starts: whether decoding can start here, with nothing
    from before. recovery_frames: of a recovery point, at which decoding can begin too, how many frames after this one
    pictures are whole again, whatever was lost before: to the bit those of the whole stream; None for other packets.
    """

    data: bytes = field(repr=False)
    frame: int
    starts: bool
    recovery_frames: int | None = None

    @property
    def whole_from(self) -> int | None:
        """The frame from which pictures are whole for who begins here; None where nobody can."""
        if self.starts:
            return self.frame
        return None if self.recovery_frames is None else self.frame + self.recovery_frames


MOST_RECOVERY_FRAMES: Final = 1 << 16


def is_recovery(value: object) -> bool:
    """Whether this can be the `recovery_frames` of a packet."""
    return value is None or (type(value) is int and 0 <= value <= MOST_RECOVERY_FRAMES)


@dataclass(frozen=True)
class Picture:
    """What a decoder makes of one picture of the session; `image` is None where it is `missing`."""

    frame: int
    state: PictureState
    image: Image | None = field(repr=False)


class StreamEncoder(ABC):
    """One sequence being encoded."""

    @abstractmethod
    def push(self, image: Image, *, trace: Trace = NULL_TRACE) -> list[Packet]:
        """The packets that are ready after this picture, which is left untouched; none while pictures are held back.

        Raises ImageError for an image outside the codec's capabilities, or of another shape than the first.
        """

    @abstractmethod
    def flush(self) -> list[Packet]:
        """The packets of pictures still held back; the session is over then."""


class StreamDecoder(ABC):
    """One stream being decoded, from a packet that `starts` on, or a recovery point; pictures before it are missing."""

    @abstractmethod
    def push(self, packet: Packet | Loss, *, trace: Trace = NULL_TRACE) -> list[Picture]:
        """The pictures that are ready after this packet, or after knowing that the next one is LOST.

        Never claims `whole` for a picture that depends on what was lost. Raises BitstreamError for damaged or foreign
        bytes that it can tell; the session goes on with the next packet that `starts` or is a recovery point.
        """

    @abstractmethod
    def flush(self) -> list[Picture]:
        """The pictures still held back; the session is over then."""
