"""The raw codec: layout of its bitstream, and that damage is noticed."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import pytest

from codecbench import BitstreamError
from codecbench.plugins.codecs.raw import Raw


def test_layout_is_as_documented() -> None:
    image = np.arange(24, dtype=np.uint8).reshape(2, 4, 3)
    bitstream = Raw.create().encode(image)
    assert bitstream[:13] == struct.pack("<4sBII", b"RAW1", 3, 4, 2)
    assert bitstream[13:-4] == image.tobytes()
    assert bitstream[-4:] == struct.pack("<I", zlib.crc32(bitstream[:-4]))


@pytest.mark.parametrize("shape", [(1, 1), (3, 5), (5, 3, 3)])
def test_overhead_is_17_bytes(shape: tuple[int, ...], rng: np.random.Generator) -> None:
    image = rng.integers(0, 256, shape, dtype=np.uint8)
    assert len(Raw.create().encode(image)) == image.size + 17


def test_every_flipped_bit_is_noticed(rng: np.random.Generator) -> None:
    codec = Raw.create()
    bitstream = codec.encode(rng.integers(0, 256, (3, 5), dtype=np.uint8))
    for bit in range(8 * len(bitstream)):
        damaged = bytearray(bitstream)
        damaged[bit // 8] ^= 1 << bit % 8
        with pytest.raises(BitstreamError):
            codec.decode(bytes(damaged))


def test_a_huge_size_with_a_right_checksum_is_refused() -> None:
    content = struct.pack("<4sBII", b"RAW1", 1, 1 << 31, 1 << 31)
    with pytest.raises(BitstreamError, match="needs"):
        Raw.create().decode(content + struct.pack("<I", zlib.crc32(content)))
