"""The header of ours in front of keyframe packets, recovery points of intra refresh, and checksums of FFV1.

Little-endian: magic (4), flags (1): 1 low delay, 2 color, 4 frames of 16 bits; width (2), height (2), length of the
decoder's own header (2); with 16 bits a `DepthScale`; that header. The rest of the packet, and every other packet, is
what the encoder wrote.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from typing import Final, Self

from codecbench.core.contracts.errors import BitstreamError
from codecbench.core.contracts.image import MAX_PIXELS
from codecbench.core.contracts.stream import is_recovery
from codecbench.plugins.codecs.quantizer import DepthScale

_FIXED: Final = struct.Struct("<4sBHHH")
_LOW_DELAY, _COLOR, _DEPTH = 1, 2, 4
MAX_SIDE: Final = 0xFFFF
_START_CODE: Final = b"\0\0\1"
_SEI_UNIT: Final = 6
_RECOVERY_POINT: Final = 6
_SLICE_FOOTER: Final = 8
_MIRRORED_BITS: Final = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


@dataclass(frozen=True)
class Header:
    """Properties of a stream that a decoder needs before the first frame."""

    magic: bytes
    """Four bytes that identify the codec."""
    width: int
    """Of the images before padding."""
    height: int
    channels: int
    is_low_delay: bool
    extradata: bytes = b""
    """The decoder's own header, if the encoder does not write it into packets."""
    depth: DepthScale | None = None
    """What the codes of 16-bit frames stand for; None for frames of 8 bits."""

    def to_bytes(self) -> bytes:
        """Serialize the header."""
        flags = _LOW_DELAY * self.is_low_delay + _COLOR * (self.channels == 3)
        depth = b"" if self.depth is None else self.depth.to_bytes()
        flags += _DEPTH * bool(depth)
        return _FIXED.pack(self.magic, flags, self.width, self.height, len(self.extradata)) + depth + self.extradata

    @classmethod
    def parse(cls, data: bytes, magic: bytes) -> tuple[Self, bytes]:
        """Split a packet into its header and the rest. Raises BitstreamError if it has no header of this codec."""
        if len(data) < _FIXED.size or not data.startswith(magic):
            raise BitstreamError(f"not a keyframe of this codec: {data[:4]!r} instead of {magic!r}")
        _, flags, width, height, length = _FIXED.unpack_from(data)
        if flags > _LOW_DELAY + _DEPTH:
            raise BitstreamError(f"the header of the stream is damaged: {flags:#x} is not what an encoder writes")
        if not 0 < width * height <= MAX_PIXELS:
            raise BitstreamError(f"{width}x{height} is not within 1..{MAX_PIXELS} pixels")
        start = _FIXED.size + (DepthScale.RECORD.size if flags & _DEPTH else 0)
        content = start + length
        if len(data) <= content:
            raise BitstreamError(f"a packet of {len(data)} bytes ends within its header of {content}")
        channels = 3 if flags & _COLOR else 1
        depth = DepthScale.parse(data[_FIXED.size : start]) if flags & _DEPTH else None
        header = cls(magic, width, height, channels, bool(flags & _LOW_DELAY), data[start:content], depth)
        return header, data[content:]


def frames_to_recovery(data: bytes) -> int | None:
    """Number of frames until frames are exact whatever was lost before; None if the packet does not promise it.

    Recovery point messages of H.264 promise it (ITU-T H.264, D.2.8).
    """
    for unit in data.split(_START_CODE)[1:]:
        if unit and unit[0] & 31 == _SEI_UNIT:
            return _frames_from_message(unit[1:].replace(b"\0\0\3", b"\0\0"))
    return None


def _frames_from_message(message: bytes) -> int | None:
    """Read `recovery_frame_cnt` of a message that promises an exact match."""
    if len(message) < 3 or message[0] != _RECOVERY_POINT:
        return None
    bits = "".join(f"{byte:08b}" for byte in message[2 : 2 + message[1]])
    zeros = bits.find("1")
    code, exact = bits[zeros : 2 * zeros + 1], bits[2 * zeros + 1 : 2 * zeros + 2]
    if zeros < 0 or len(code) <= zeros or exact != "1":
        return None
    frames = int(code, 2) - 1
    return frames if is_recovery(frames) else None


def check_slices(data: bytes, slices: int) -> None:
    """Raise BitstreamError if a packet of FFV1 is not so many slices with right checksums; FFmpeg decodes it anyway.

    A slice ends with the size of what is before these 8 bytes (3), a status (1) and a CRC-32 (4), with which the CRC of
    the slice is 0 (RFC 9043, 4.9). It begins with 0 and takes upper bits first; zlib's does so over mirrored bytes.
    """
    ends = [len(data)]
    while ends[-1] > 0 and len(ends) <= slices:
        footer = ends[-1] - _SLICE_FOOTER
        ends.append(footer - int.from_bytes(data[max(footer, 0) : footer + 3]))
    if ends[-1] != 0 or len(ends) != slices + 1:
        raise BitstreamError(f"a packet of {len(data)} bytes does not consist of {slices} slices")
    for start, end in zip(ends[1:], ends, strict=False):
        if zlib.crc32(data[start:end].translate(_MIRRORED_BITS), 0xFFFFFFFF) != 0xFFFFFFFF:
            raise BitstreamError(f"the checksum of bytes {start} to {end} of a packet is wrong")
