"""JPEG through OpenCV against Pillow's libjpeg, and files that are cut, damaged or hostile."""

from __future__ import annotations

import importlib.metadata
import io

import cv2
import numpy as np
import PIL.Image
import pytest
import skimage.data
from pydantic import ValidationError
from skimage.metrics import peak_signal_noise_ratio

from codecbench import BitstreamError, ImageError
from codecbench.plugins.codecs.dct.tables import LUMINANCE, ZIGZAG
from codecbench.plugins.codecs.jpeg import Jpeg

PICTURE = skimage.data.astronaut()[100:228, 150:300]
GRAY = np.ascontiguousarray(PICTURE[..., 1])


def _segments(bitstream: bytes) -> dict[int, bytes]:
    """First segment of each marker, read by a walk of its own."""
    found, position = {}, 2
    while bitstream[position + 1] != 0xDA:
        length = int.from_bytes(bitstream[position + 2 : position + 4], "big")
        found.setdefault(bitstream[position + 1], bitstream[position + 4 : position + 2 + length])
        position += 2 + length
    return found


@pytest.mark.parametrize("image", [PICTURE, GRAY], ids=["rgb", "gray"])
@pytest.mark.parametrize("options", [{}, {"progressive": True}, {"optimize": True, "subsampling": "444"}])
def test_pillow_reads_the_same_picture(image: np.ndarray, options: dict[str, object]) -> None:
    codec = Jpeg.create(quality=80, **options)
    bitstream = codec.encode(image)
    decoded = codec.decode(bitstream)
    theirs = np.asarray(PIL.Image.open(io.BytesIO(bitstream)))
    assert theirs.shape == image.shape
    assert np.abs(theirs.astype(int) - decoded).max() <= 1
    assert peak_signal_noise_ratio(image, decoded) > 27


@pytest.mark.parametrize("quality", [1, 25, 50, 75, 100])
def test_quality_scales_the_table_as_libjpeg_does(quality: int) -> None:
    quantisers = _segments(Jpeg.create(quality=quality).encode(GRAY))[0xDB]
    scale = 5000 // quality if quality < 50 else 200 - 2 * quality
    expected = np.clip((LUMINANCE.reshape(64) * scale + 50) // 100, 1, 255)
    assert list(quantisers[1:65]) == list(expected[ZIGZAG])


@pytest.mark.parametrize(("subsampling", "factors"), [("444", 0x11), ("422", 0x21), ("420", 0x22)])
def test_subsampling_is_in_the_file(subsampling: str, factors: int) -> None:
    frame = _segments(Jpeg.create(subsampling=subsampling).encode(PICTURE))[0xC0]
    assert frame[7] == factors
    assert frame[10] == frame[13] == 0x11


def test_progressive_and_optimised_files_are_what_they_say() -> None:
    plain, optimised = (Jpeg.create(optimize=flag).encode(PICTURE) for flag in (False, True))
    assert len(optimised) < len(plain)
    assert 0xC2 in _segments(Jpeg.create(progressive=True).encode(PICTURE))
    assert 0xC0 in _segments(plain)


def test_every_cut_is_noticed() -> None:
    for options in ({}, {"progressive": True}):
        codec = Jpeg.create(quality=30, **options)
        bitstream = codec.encode(PICTURE)
        for length in range(len(bitstream)):
            with pytest.raises(BitstreamError):
                codec.decode(bitstream[:length])


def test_a_cut_file_that_was_given_an_end_again_is_noticed_where_blocks_outnumber_bits() -> None:
    bitstream = Jpeg.create(quality=30).encode(np.repeat(np.repeat(PICTURE, 8, 0), 8, 1))
    start = bitstream.index(b"\xff\xda")
    with pytest.raises(BitstreamError, match="cannot be coded"):
        Jpeg.create().decode(bitstream[: start + 40] + b"\xff\xd9")


@pytest.mark.parametrize(
    ("size", "reason"),
    [((65500, 65500), "65500x65500 .*pixels"), ((1 << 13, 1 << 13), "blocks cannot be"), ((0, 10), "10x0 .*pixels")],
)
def test_a_header_that_claims_too_much_is_refused(size: tuple[int, int], reason: str) -> None:
    bitstream = bytearray(Jpeg.create().encode(GRAY))
    place = bytes(bitstream).index(b"\xff\xc0") + 5
    bitstream[place : place + 4] = size[0].to_bytes(2, "big") + size[1].to_bytes(2, "big")
    with pytest.raises(BitstreamError, match=reason):
        Jpeg.create().decode(bytes(bitstream))


def test_progressive_files_stay_below_half_a_gigabyte() -> None:
    """libjpeg holds the coefficients of a progressive picture, so fewer pixels are allowed, to both sides."""
    progressive = bytearray(Jpeg.create(progressive=True).encode(np.zeros((16, 16, 3), np.uint8)))
    frame = progressive.index(b"\xff\xc2")
    progressive[frame + 5 : frame + 9] = b"\x20\x00\x20\x00"
    with pytest.raises(BitstreamError, match=r"8192x8192 in scans .*33554432"):
        Jpeg.create().decode(bytes(progressive))
    large = np.broadcast_to(np.uint8(0), (8192, 8192))
    with pytest.raises(ImageError, match="33554432 pixels"):
        Jpeg.create(progressive=True).encode(large)


def test_many_scans_are_refused() -> None:
    bitstream = Jpeg.create(progressive=True).encode(GRAY)
    start = bitstream.rindex(b"\xff\xda")
    scan = bitstream[start:-2]
    with pytest.raises(BitstreamError, match="scans"):
        Jpeg.create().decode(bitstream[:-2] + 40 * scan + b"\xff\xd9")


def test_libraries_are_those_that_opencv_was_built_with() -> None:
    (line,) = (line for line in cv2.getBuildInformation().splitlines() if line.split()[:1] == ["JPEG:"])
    before, _, version = line.rstrip(")").rpartition("(ver ")
    assert "jpeg" in before
    libraries = Jpeg.create().libraries()
    assert set(libraries) == {"opencv", "libjpeg-turbo"}
    assert libraries["libjpeg-turbo"] == version
    wheel = importlib.metadata.packages_distributions()["cv2"][0]
    assert importlib.metadata.version(wheel).split(".")[:3] == libraries["opencv"].split(".")


@pytest.mark.parametrize(
    ("information", "version"),
    [
        ("  PNG:   libpng.so (ver 1.6.58)\n  JPEG:  build-libjpeg-turbo (ver 3.1.2-70)\n", "3.1.2-70"),
        ("  JPEG 2000:  build (ver 2.5.3)\n  JPEG:  /usr/lib/libjpeg.so (ver 80)\n", "80"),
        ("  JPEG 2000:  build (ver 2.5.3)\n  JPEG:  NO\n", "unknown"),
        ("", "unknown"),
    ],
)
def test_the_version_is_that_of_the_jpeg_row(information: str, version: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cv2, "getBuildInformation", lambda: information)
    assert Jpeg.create().libraries()["libjpeg-turbo"] == version


@pytest.mark.parametrize("values", [{"quality": 0}, {"quality": 101}, {"subsampling": "411"}, {"qualty": 5}])
def test_bad_parameters_are_refused(values: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        Jpeg.create(**values)
