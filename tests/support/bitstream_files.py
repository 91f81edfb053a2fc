"""Files of bitstreams, read whole and broken in every place."""

from __future__ import annotations

from typing import Final

import pytest

from codecbench.core.engine.storage.bitstream_file import BitstreamDamage, BitstreamFile

JOB: Final = "0f" * 16


def read_all(content: bytes) -> list[bytes]:
    """The bitstreams of all frames in the order of frames."""
    file = BitstreamFile(content, JOB)
    return [file.read(frame) for frame in range(len(file))]


def require_damage_noticed(content: bytes) -> None:
    """Fail where a flipped bit, or an end that is missing, goes unnoticed."""
    for position in range(len(content) * 8):
        broken = bytearray(content)
        broken[position // 8] ^= 1 << position % 8
        with pytest.raises(BitstreamDamage):
            read_all(bytes(broken))
    for length in range(len(content)):
        with pytest.raises(BitstreamDamage):
            BitstreamFile(content[:length], JOB)
