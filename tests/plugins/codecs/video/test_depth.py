"""Depth of 16 bits in video: lossless in FFV1, quantized in HEVC and H.264, decoded from packets alone."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

pytest.importorskip("av", reason="the extra `video` is not installed")

import av

from codecbench import ImageError
from codecbench.core.conformance.harness import decoded_of, packets_of
from codecbench.core.conformance.suite import CHECKS, run_checks
from codecbench.plugins.codecs.video import library
from codecbench.plugins.codecs.video.codecs import H264, Av1, Ffv1, Hevc, Mjpeg, Vp9
from codecbench.plugins.codecs.video.header import Header
from codecbench.plugins.codecs.video.muxing import file_from_packets


def wall(frame: int, height: int = 96, width: int = 128) -> np.ndarray:
    """A slanted wall at 1 to 4.5 m, without distance in a corner, that comes nearer."""
    rows, columns = np.mgrid[0:height, 0:width]
    image = (1000 + 20 * rows + 12 * columns - 5 * frame).astype(np.uint16)
    image[: height // 4, : width // 4] = 0
    return image


FRAMES = [wall(frame) for frame in range(8)]


def decoded(codec: Any, frames: list[np.ndarray]) -> list[np.ndarray]:
    """Decoded by the class's default setting, whatever encoded."""
    return [picture.image for picture in decoded_of(type(codec).create(), packets_of(codec, frames))]


@pytest.mark.parametrize("shape", [(96, 128), (1, 1), (17, 31)])
def test_ffv1_keeps_every_bit(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(1)
    frames = [rng.integers(0, 1 << 16, shape, dtype=np.uint16) for _ in range(3)]
    for codec in (Ffv1.create(), Ffv1.create(pixel_format="gray", gop=2)):
        assert all(np.array_equal(*pair) for pair in zip(decoded(codec, frames), frames, strict=True))


def test_ffv1_keeps_every_code() -> None:
    codec = Ffv1.create(quantizer="inverse", depth_bits=12, depth_quantization=30)
    assert Ffv1.create().is_lossless()
    assert not codec.is_lossless()
    expected = [codec.params.depth_scale.pixels(codec.params.codes(frame)) for frame in FRAMES]
    assert all(np.array_equal(*pair) for pair in zip(decoded(codec, FRAMES), expected, strict=True))


@pytest.mark.parametrize(
    "codec",
    [
        Hevc.create(crf=5),
        Hevc.create(crf=5, depth_bits=10, latency="any"),
        Hevc.create(crf=5, quantizer="inverse", far_m=10, pixel_format="yuv444p"),
        H264.create(crf=5),
        H264.create(crf=5, quantizer="linear", far_m=10),
        H264.create(crf=5, intra_refresh=True, gop=4),
    ],
    ids=lambda codec: f"{codec.name} {codec.params.model_dump(exclude_defaults=True)}",
)
@pytest.mark.parametrize("shape", [(96, 128), (17, 31)])
def test_quantized_depth_comes_back_within_centimeters(codec: Any, shape: tuple[int, int]) -> None:
    frames = [wall(frame, *shape) for frame in range(8)]
    for frame, image in zip(frames, decoded(codec, frames), strict=True):
        assert (image.dtype, image.shape) == (np.uint16, shape)
        assert np.median(np.abs(image.astype(int) - frame)[frame > 0]) < 20


def test_quality_is_a_trade_for_size() -> None:
    rng, sizes, errors = np.random.default_rng(1), [], []
    noisy = [np.where(frame, frame + rng.integers(-30, 31, frame.shape), 0).astype(np.uint16) for frame in FRAMES]
    for crf in (0, 30):
        codec = Hevc.create(crf=crf)
        packets = packets_of(codec, noisy)
        sizes.append(sum(len(packet.data) for packet in packets))
        errors.append(np.abs(decoded_of(codec, packets)[5].image.astype(int) - noisy[5])[noisy[5] > 0].mean())
    assert sizes[0] > 2 * sizes[1]
    assert errors[0] < 0.7 * errors[1]


def test_only_streams_of_16_bits_carry_a_scale() -> None:
    eight = packets_of(Hevc.create(), [frame.astype(np.uint8) for frame in FRAMES])[0].data
    assert Header.parse(eight, b"V265")[0] == Header(b"V265", 128, 96, 1, is_low_delay=True)
    codec = Hevc.create(depth_bits=10, depth_unknown=65535)
    header, rest = Header.parse(packets_of(codec, FRAMES)[0].data, b"V265")
    assert header == Header(b"V265", 128, 96, 1, is_low_delay=True, depth=codec.params.depth_scale)
    assert rest.startswith(b"\0\0\0\1")


def test_a_stream_has_frames_of_one_kind() -> None:
    encoder = Ffv1.create().encoder(30)
    encoder.push(FRAMES[0])
    with pytest.raises(ImageError, match="frame of 8 bits in a stream of 16 bits"):
        encoder.push(FRAMES[0].astype(np.uint8))
    for codec_class in (Av1, Vp9, Mjpeg):
        with pytest.raises(ImageError, match="uint8"):
            codec_class.create().encoder(30).push(FRAMES[0])
        assert codec_class.create().capabilities.bits == (8,)


def test_hardware_encoders_take_eight_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(av, "Codec", lambda name, mode="r": None)
    monkeypatch.setattr("codecbench.plugins.codecs.video.codecs.open_encoder", lambda *arguments, **options: None)
    assert H264.create(encoder="h264_nvenc").capabilities.bits == (8,)
    assert H264.create().capabilities.bits == (8, 16)
    results = run_checks(H264, H264.params_type(encoder="h264_nvenc"), CHECKS[:1])
    assert [str(result.layout) for result in results] == ["gray", "color"]


@pytest.mark.parametrize(
    ("codec_class", "setting", "pattern"),
    [
        (H264, {"depth_bits": 12}, "libx264 does not support depth_bits 12, only 10"),
        (Hevc, {"depth_bits": 16}, "libx265 .* only 10, 12"),
        (Hevc, {"quantizer": "none"}, "none takes 16 bits"),
        (Av1, {"quantizer": "log"}, "quantizer"),
        (H264, {"intra_refresh": True, "pixel_format": "gray"}, "crashes on gray .* yuv420p"),
    ],
)
def test_what_an_encoder_cannot_do_is_refused(codec_class: Any, setting: dict[str, Any], pattern: str) -> None:
    with pytest.raises(ValidationError, match=pattern):
        codec_class.create(**setting)


def test_results_say_how_depth_was_quantized() -> None:
    assert "depth is quantized (log, 12 bits, 0.01 to 65.535 m)" in Hevc.create().remark_at(16)
    inverse = H264.create(quantizer="inverse", far_m=10)
    assert "(inverse, 10 bits, 0.229 to 10 m)" in inverse.remark_at(16)  # A = 240: 240 / (1023 + 23) = 0.229
    assert Ffv1.create().remark_at(16) == ""


def test_a_video_file_holds_the_samples() -> None:
    for codec in (Ffv1.create(), Hevc.create()):
        content = file_from_packets(codec, packets_of(codec, FRAMES), 30, "depth.mkv")
        with library.load_av().open(io.BytesIO(content)) as container:
            formats = {frame.format.name for frame in container.decode(video=0)}
        assert formats == {"gray16le" if codec.name == "ffv1" else "gray12le"}
