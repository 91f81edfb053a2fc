"""Where intra refresh has made pictures whole again: the recovery point messages of H.264 (ITU-T H.264, D.2.8)."""

from __future__ import annotations

from typing import Final

from codecbench.core.contracts.stream import is_recovery

_START_CODE: Final = b"\0\0\1"
_SEI_UNIT: Final = 6
_RECOVERY_POINT: Final = 6


def frames_to_recovery(data: bytes) -> int | None:
    """How many frames after this packet pictures are exact whatever was lost before, or None if it promises nothing."""
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
