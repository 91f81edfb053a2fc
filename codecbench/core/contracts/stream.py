"""Packets, and the sessions that encode and decode them.

One session codes one sequence, in order, and holds all state. Packets leave in decoding order; frames are numbered from
0 in the order in which they were pushed, which is display order.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from enum import Enum
from typing import Final, Literal

from codecbench.core.contracts.image import Image
from codecbench.core.counting.trace import NULL_TRACE, Trace

PictureState = Literal["whole", "concealed", "missing"]
"""`whole`: as the encoder intended. `concealed`: partly reconstructed from other frames. `missing`: no frame."""


class Loss(Enum):
    """Stands in for a packet that never arrived."""

    LOST = "lost"


LOST: Final = Loss.LOST


@dataclass(frozen=True)
class Packet:
    """The coded data of one frame."""

    data: bytes = field(repr=False)
    """Every byte that the decoder needs of the frame, headers included."""
    frame: int
    """Number of the frame in the session; a link carries it like a timestamp, so its bytes are not counted."""
    starts: bool
    """Whether it is a keyframe (IDR): decoding can start here (random access) without anything before it."""
    recovery_frames: int | None = None
    """Of a recovery point, how many frames after this one decoding is exact again, whatever was lost before.

    From there on frames equal those of the complete stream to the bit, and decoding can start here too. None for other
    packets."""

    @property
    def whole_from(self) -> int | None:
        """First frame that is whole if decoding starts here; None if it cannot start here."""
        if self.starts:
            return self.frame
        return None if self.recovery_frames is None else self.frame + self.recovery_frames


MOST_RECOVERY_FRAMES: Final = 1 << 16
"""Largest `recovery_frames` of a packet."""


def is_recovery(value: object) -> bool:
    """Return whether this can be the `recovery_frames` of a packet."""
    return value is None or (type(value) is int and 0 <= value <= MOST_RECOVERY_FRAMES)


@dataclass(frozen=True)
class Picture:
    """A frame that a decoder returns."""

    frame: int
    """Number of the frame in the session."""
    state: PictureState
    image: Image | None = field(repr=False)
    """None if the frame is `missing`."""


class StreamEncoder(ABC):
    """An encoding session for one sequence."""

    @abstractmethod
    def push(self, image: Image, *, trace: Trace = NULL_TRACE) -> list[Packet]:
        """Encode the next frame, without writing to it; return the packets that are ready, if any.

        Raises ImageError for an image outside the codec's capabilities, or of another shape than the first.
        """

    @abstractmethod
    def flush(self) -> list[Packet]:
        """Return the packets of frames that the encoder still held back, and end the session."""


class StreamDecoder(ABC):
    """A decoding session for one stream. It starts at a keyframe or a recovery point; frames before it are missing."""

    @abstractmethod
    def push(self, packet: Packet | Loss, *, trace: Trace = NULL_TRACE) -> list[Picture]:
        """Decode the next packet, or LOST in its place; return the frames that are ready, if any.

        A frame that depends on a lost one is never `whole`. Raises BitstreamError if it detects damaged or foreign
        bytes; the session resumes at the next keyframe or recovery point.
        """

    @abstractmethod
    def flush(self) -> list[Picture]:
        """Return the frames that the decoder still held back, and end the session."""
