"""PNG against Pillow's decoder, and files that are almost right."""

from __future__ import annotations

import io
import struct
import zlib

import cv2
import numpy as np
import PIL.Image
import pytest
import skimage.data
from pydantic import ValidationError

from codecbench import BitstreamError, Scene
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


def test_inverse_depth_is_what_ros_sends() -> None:
    """Header of compressed_depth_image_transport: INV_DEPTH (0), A = 100 101 = 10100, B = 1 - 10100 / 10 = -1009."""
    codec, depth_mm = Png.create(quantizer="inverse"), np.array([[0, 1000, 2000], [7000, 9999, 10000]], np.uint16)
    bitstream = codec.encode(depth_mm)
    assert bitstream[:12] == np.int32(0).tobytes() + np.array([10100, -1009], "<f4").tobytes()
    codes = cv2.imdecode(np.frombuffer(bitstream[12:], np.uint8), cv2.IMREAD_UNCHANGED)
    assert codes.tolist() == [[0, 9091, 4041], [433, 1, 0]]
    assert Png.create().decode(bitstream).tolist() == [[0, 1000, 2000], [7004, 10000, 0]]
    assert not codec.is_lossless()
    assert "inverse, 16 bits, 0.152 to 10 m" in codec.remark_at(16)
    gray = np.arange(12, dtype=np.uint8).reshape(3, 4)
    assert codec.encode(gray) == Png.create().encode(gray)
    for bad in (bytes(12) + bitstream[12:], bitstream[:12] + Png.create().encode(gray), bytes(12)):
        with pytest.raises(BitstreamError, match="png: "):
            codec.decode(bad)
    (transport, *_) = codec.recipes(Scene(480, 640, 1, 30.0, 16))
    assert "depth_max: 10.0\n        format: png\n" in transport.text
    assert "depth_quantization: 100.0" in transport.text
    with pytest.raises(ValidationError, match="far_m and depth_quantization are for inverse depth"):
        Png.create(far_m=5)
