"""PNG against Pillow's decoder, and files that are almost right."""

from __future__ import annotations

import io
import struct
import zlib

import numpy as np
import PIL.Image
import pytest
import skimage.data

from codecbench import BitstreamError
from codecbench.core.contracts.image import png_bytes
from codecbench.plugins.codecs.png import Png

PICTURE = skimage.data.astronaut()[100:228, 150:300]


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))


def _file(width: int, height: int, pixels: bytes, *, depth: int = 8, color: int = 0, interlace: int = 0) -> bytes:
    header = struct.pack(">IIBBBBB", width, height, depth, color, 0, 0, interlace)
    chunks = _chunk(b"IHDR", header) + _chunk(b"IDAT", zlib.compress(pixels)) + _chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + chunks


@pytest.mark.parametrize("image", [PICTURE, PICTURE[..., 1]], ids=["rgb", "gray"])
def test_pillow_reads_the_same_pixels(image: np.ndarray) -> None:
    decoded = np.asarray(PIL.Image.open(io.BytesIO(Png.create().encode(image))))
    np.testing.assert_array_equal(decoded, image)


def test_the_defaults_are_the_yardstick_of_cr_percent() -> None:
    assert Png.create().encode(PICTURE) == png_bytes(PICTURE)


def test_effort_makes_files_smaller() -> None:
    sizes = [len(Png.create(effort=effort).encode(PICTURE)) for effort in (0, 1, 9)]
    assert sizes == sorted(sizes, reverse=True)
    assert sizes[0] > PICTURE.size


def test_every_flipped_bit_is_noticed() -> None:
    codec = Png.create()
    bitstream = codec.encode(PICTURE[:6, :5, 0])
    for bit in range(8 * len(bitstream)):
        damaged = bytearray(bitstream)
        damaged[bit // 8] ^= 1 << bit % 8
        with pytest.raises(BitstreamError):
            codec.decode(bytes(damaged))


@pytest.mark.parametrize(
    ("bitstream", "reason"),
    [
        (_file(3, 2, bytes(3)), "OpenCV read"),
        (_file(1 << 20, 1 << 20, bytes(10)), "pixels"),
        (_file(8000, 8000, bytes(10)), "too few"),
        (_file(0, 5, b""), "pixels"),
        (_file(3, 2, bytes(2 * 19), depth=16, color=2), "depth 16"),
        (_file(3, 2, bytes(2 * 13), color=6), "color type 6"),
        (_file(3, 2, bytes(2 * 4), interlace=1), "interlace 1"),
        (_file(3, 2, bytes(2 * 4)) + b"\0", "after the end"),
        (_file(3, 2, bytes(2 * 4)).replace(_chunk(b"IEND", b""), b""), "ends inside"),
        (
            _file(3, 2, bytes(2 * 4)).replace(b"\r\n\x1a\n", b"\r\n\x1a\n" + _chunk(b"acTL", bytes(8))),
            "IHDR comes first",
        ),
    ],
)
def test_files_that_are_almost_right_are_refused(bitstream: bytes, reason: str) -> None:
    with pytest.raises(BitstreamError, match=reason):
        Png.create().decode(bitstream)


def test_the_hand_made_files_are_right_but_for_what_is_wrong() -> None:
    image = np.array([[1, 2, 3], [4, 5, 6]], np.uint8)
    rows = b"".join(b"\0" + row.tobytes() for row in image)
    np.testing.assert_array_equal(Png.create().decode(_file(3, 2, rows)), image)
