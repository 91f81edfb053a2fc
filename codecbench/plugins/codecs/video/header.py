"""What packets of video say of themselves: the few bytes of ours in front of one at which decoding can begin, and
where intra refresh has made pictures whole again.

Little-endian: magic (4), what is coded (1): 1 low delay, 2 colour; width (2), height (2), length of the decoder's own
header (2), that header. Every other packet, and what follows here, is what the encoder wrote.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Final, Self

from codecbench.core.contracts.errors import BitstreamError
from codecbench.core.contracts.image import MAX_PIXELS
from codecbench.core.contracts.stream import is_recovery

_FIXED: Final = struct.Struct("<4sBHHH")
_LOW_DELAY, _COLOUR = 1, 2
MAX_SIDE: Final = 0xFFFF
_START_CODE: Final = b"\0\0\1"
_SEI_UNIT: Final = 6
_RECOVERY_POINT: Final = 6


@dataclass(frozen=True)
class Header:
    """What a decoder has to know before the first picture: `width` and `height` are those that went in."""

    magic: bytes
    width: int
    height: int
    channels: int
    is_low_delay: bool
    extradata: bytes = b""

    def to_bytes(self) -> bytes:
        """The header as it is sent."""
        what = _LOW_DELAY * self.is_low_delay + _COLOUR * (self.channels == 3)
        return _FIXED.pack(self.magic, what, self.width, self.height, len(self.extradata)) + self.extradata

    @classmethod
    def taken_from(cls, data: bytes, magic: bytes) -> tuple[Self, bytes]:
        """The header in front of a packet, and the rest. Raises BitstreamError for what is none of this codec's."""
        if len(data) < _FIXED.size or not data.startswith(magic):
            raise BitstreamError(f"not the start of a stream of this codec: {data[:4]!r} instead of {magic!r}")
        _, what, width, height, length = _FIXED.unpack_from(data)
        if what > _LOW_DELAY + _COLOUR:
            raise BitstreamError(f"the header of the stream is damaged: {what:#x} says what no encoder writes")
        if not 0 < width * height <= MAX_PIXELS:
            raise BitstreamError(f"{width}x{height} is not within 1..{MAX_PIXELS} pixels")
        content = _FIXED.size + length
        if len(data) <= content:
            raise BitstreamError(f"a packet of {len(data)} bytes ends within its header of {content}")
        channels = 3 if what & _COLOUR else 1
        header = cls(magic, width, height, channels, bool(what & _LOW_DELAY), data[_FIXED.size : content])
        return header, data[content:]


def frames_to_recovery(data: bytes) -> int | None:
    """How many frames after this packet pictures are exact whatever was lost before, or None if it promises nothing.

    Recovery point messages of H.264 (ITU-T H.264, D.2.8) say so.
    """
    for unit in data.split(_START_CODE)[1:]:
        if unit and unit[0] & 31 == _SEI_UNIT:
            return _frames_from_message(unit[1:].replace(b"\0\0\3", b"\0\0"))
    return None


def _frames_from_message(message: bytes) -> int | None:
    """The `recovery_frame_cnt` of a message that says that the match will be exact."""
    if len(message) < 3 or message[0] != _RECOVERY_POINT:
        return None
    bits = "".join(f"{byte:08b}" for byte in message[2 : 2 + message[1]])
    zeros = bits.find("1")
    code, exact = bits[zeros : 2 * zeros + 1], bits[2 * zeros + 1 : 2 * zeros + 2]
    if zeros < 0 or len(code) <= zeros or exact != "1":
        return None
    frames = int(code, 2) - 1
    return frames if is_recovery(frames) else None
