"""The header, the recovery points and the conversion of color, each against what is known of it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

pytest.importorskip("av", reason="the extra `video` is not installed")

import av

from codecbench import BitstreamError
from codecbench.plugins.codecs.video.codecs import H264, Ffv1
from codecbench.plugins.codecs.video.color import fill_frame, image_from_frame, pad_image, planes_from_image
from codecbench.plugins.codecs.video.header import Header, frames_to_recovery


def test_a_header_is_eleven_bytes_and_comes_back() -> None:
    header = Header(b"TEST", 641, 480, 3, is_low_delay=True)
    sent = header.to_bytes()
    assert sent.hex() == "54455354038102e0010000"
    assert Header.parse(sent + b"rest", b"TEST") == (header, b"rest")
    apart = Header(b"TEST", 1, 2, 1, is_low_delay=False, extradata=b"xyz")
    assert Header.parse(apart.to_bytes() + b"r", b"TEST") == (apart, b"r")


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (b"", "not a keyframe"),
        (b"OTHR" + bytes(20), "b'OTHR' .*b'TEST'$"),
        (b"TEST" + bytes(20), "^0x0 .*pixels"),
        (b"TEST\x08\x01\x00\x01\x00\x00\x00x", "0x8 is"),
        (b"TEST\x06\x01\x00\x01\x00\x00\x00" + bytes(48), "0x6 is"),
        (b"TEST\x04\x01\x00\x01\x00\x00\x00" + bytes(48), "scale is damaged: kind 0, 0 bits"),
        (b"TEST\x04\x01\x00\x01\x00\x00\x00x", "12 bytes .*header of 55"),
        (b"TEST\x00\xff\xff\xff\xff\x00\x00x", "^65535x65535 .*pixels"),
        (b"TEST\x00\x01\x00\x01\x00\x05\x00xyz", "14 bytes .*header of 16"),
    ],
)
def test_a_header_that_no_encoder_writes_is_refused(data: bytes, said: str) -> None:
    with pytest.raises(BitstreamError, match=said):
        Header.parse(data, b"TEST")


def test_recovery_points_are_read_as_the_standard_writes_them() -> None:
    """0x13 0x10: ue(v) 0001001 = 8, exact_match_flag 1, then broken_link_flag and changing_slice_group_idc."""
    assert frames_to_recovery(bytes.fromhex("0000010606021310 80 000001419be6")) == 8
    assert frames_to_recovery(bytes.fromhex("00000106060112 80")) is None, "exact_match_flag is 0"
    assert frames_to_recovery(bytes.fromhex("000001060601c4 80")) == 0
    assert frames_to_recovery(bytes.fromhex("0000016764000bac 00000168ef")) is None
    assert frames_to_recovery(bytes.fromhex("000001060602")) is None
    assert frames_to_recovery(b"") is None


@pytest.mark.parametrize("pixel_format", ["gray", "yuv420p", "yuv444p", "rgb"])
@pytest.mark.parametrize("channels", [1, 3])
def test_smooth_pictures_survive_the_conversion(pixel_format: str, channels: int) -> None:
    rows, columns = np.mgrid[0:48, 0:64]
    layers = [80 + columns + rows, 200 - 2 * columns, 60 + 3 * rows][:channels]
    image = np.stack(layers, axis=2).astype(np.uint8)
    image = np.ascontiguousarray(image[..., 0]) if channels == 1 else image
    frame = av.VideoFrame(64, 48, "bgr0" if pixel_format == "rgb" else pixel_format)
    fill_frame(frame, planes_from_image(image, pixel_format))  # type: ignore[arg-type]
    back = image_from_frame(frame, channels)
    assert back is not None
    assert back.shape == image.shape
    if pixel_format == "gray" and channels == 3:
        image = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)[..., None].repeat(3, axis=2)
    assert np.abs(back.astype(int) - image).max() <= (0 if channels == 1 or pixel_format in ("rgb", "gray") else 3)


def test_color_is_full_range_bt601() -> None:
    """Y = 0.299 R + 0.587 G + 0.114 B, Cb = 128 + 0.564 (B - Y), Cr = 128 + 0.713 (R - Y)."""
    colors = np.array([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 255]]], np.uint8)
    luma, blue, red = planes_from_image(colors, "yuv444p")
    assert luma.ravel().tolist() == [76, 150, 29, 255]
    assert blue.ravel() == pytest.approx([85, 44, 255, 128], abs=1)
    assert red.ravel() == pytest.approx([255, 21, 107, 128], abs=1)


def test_padding_repeats_the_edge() -> None:
    image = np.arange(6, dtype=np.uint8).reshape(2, 3)
    assert pad_image(image, 3, 2) is image
    assert pad_image(image, 4, 4).tolist() == [[0, 1, 2, 2], [3, 4, 5, 5], [3, 4, 5, 5], [3, 4, 5, 5]]


def test_results_say_what_becomes_of_color() -> None:
    said = {pixel_format: H264.create(pixel_format=pixel_format).remark() for pixel_format in ("gray", "yuv420p")}
    assert "not coded (gray)" in said["gray"]
    assert "half size (yuv420p)" in said["yuv420p"]
    assert Ffv1.create().remark() == ""
