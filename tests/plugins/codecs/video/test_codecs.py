"""The video codecs: what their settings promise, low delay, and that they are what FFmpeg itself would write."""

from __future__ import annotations

import importlib.metadata
import io
import os
import subprocess
import sys
from fractions import Fraction
from typing import Any

import cv2
import numpy as np
import pytest
from pydantic import ValidationError
from video_pictures import gliding_pictures, psnr_db

pytest.importorskip("av", reason="the extra `video` is not installed")

import av

from codecbench import ImageError, Unsupported
from codecbench.core.conformance.checks import no_frame_is_lost_or_doubled
from codecbench.core.conformance.harness import decoded_of, packets_of
from codecbench.core.conformance.material import long_sequence
from codecbench.core.contracts.image import Layout
from codecbench.plugins.codecs.video import library
from codecbench.plugins.codecs.video.codecs import H264, Av1, Ffv1, Hevc, Mjpeg, Vp9

CODECS: list[Any] = [H264, Hevc, Av1, Vp9, Mjpeg, Ffv1]
BY_NAME = {"ids": lambda codec_class: getattr(codec_class, "name", None)}
EVERY_CODEC = pytest.mark.parametrize("codec_class", CODECS, **BY_NAME)
PREDICTING = pytest.mark.parametrize("codec_class", [H264, Hevc, Av1, Vp9], **BY_NAME)
GRAY = gliding_pictures(24, 96, 128, 1)
COLOR = gliding_pictures(12, 96, 128, 3)


def images_of(codec: Any, packets: Any) -> list[np.ndarray]:
    pictures = decoded_of(codec, packets)
    assert [picture.state for picture in pictures] == ["whole"] * len(pictures)
    return [picture.image for picture in pictures]


def size_and_psnr(codec: Any, pictures: list[np.ndarray]) -> tuple[int, float]:
    packets = packets_of(codec, pictures)
    return sum(len(packet.data) for packet in packets), psnr_db(pictures, images_of(codec, packets))


@EVERY_CODEC
@pytest.mark.parametrize("channels", [1, 3])
def test_sixty_frames_wait_for_nothing(codec_class: Any, channels: int) -> None:
    codec = codec_class.create()
    assert codec.is_low_delay()
    encoder, decoder = codec.encoder(30), codec.decoder()
    for frame, picture in enumerate(gliding_pictures(60, 48, 80, channels)):
        packets = encoder.push(picture)
        assert [packet.frame for packet in packets] == [frame]
        (shown,) = decoder.push(packets[0])
        assert (shown.frame, shown.state, shown.image.shape) == (frame, "whole", picture.shape)
    assert encoder.flush() == []
    assert decoder.flush() == []


@EVERY_CODEC
def test_nobody_becomes_real_time(codec_class: Any) -> None:
    """SVT-AV1 makes its caller so where it runs as root, and thereby all that its caller starts later."""
    codec_class.create().encoder(30).push(GRAY[0])
    assert os.sched_getscheduler(0) == os.SCHED_OTHER


@PREDICTING
def test_look_ahead_holds_pictures_back_and_says_so(codec_class: Any) -> None:
    codec = codec_class.create(latency="any")
    assert not codec.is_low_delay()
    encoder = codec.encoder(30)
    assert encoder.push(GRAY[0]) == encoder.push(GRAY[1]) == []
    frames = [packet.frame for picture in GRAY[2:] for packet in encoder.push(picture)]
    held_back = [packet.frame for packet in encoder.flush()]
    assert len(held_back) > 2
    assert sorted(frames + held_back) == list(range(len(GRAY)))


@PREDICTING
def test_verify_sees_a_stream_that_is_longer_than_the_look_ahead(codec_class: Any) -> None:
    """Packets leave before the end, but for those of `av1`, which all wait for it; none is lost there."""
    codec = codec_class.create(latency="any")
    encoder = codec.encoder(30)
    film = long_sequence(Layout(1))
    left_early = sum(len(encoder.push(picture)) for picture in film.pictures)
    assert (left_early > 0) is (codec_class is not Av1)
    no_frame_is_lost_or_doubled(codec_class, codec.params, [film])


@pytest.mark.parametrize(
    ("codec_class", "better", "worse"),
    [
        (H264, {"crf": 20}, {"crf": 35}),
        (H264, {"qp": 20}, {"qp": 35}),
        (H264, {"bitrate_kbps": 400, "vbv_ms": 200}, {"bitrate_kbps": 100, "vbv_ms": 200}),
        (Hevc, {"crf": 20}, {"crf": 35}),
        (Hevc, {"qp": 20}, {"qp": 35}),
        (Hevc, {"bitrate_kbps": 400, "vbv_ms": 200}, {"bitrate_kbps": 100, "vbv_ms": 200}),
        (Av1, {"crf": 20}, {"crf": 50}),
        (Av1, {"qp": 20}, {"qp": 50}),
        (Av1, {"bitrate_kbps": 400, "vbv_ms": 200}, {"bitrate_kbps": 50, "vbv_ms": 200}),
        (Vp9, {"crf": 10}, {"crf": 60}),
        (Vp9, {"qp": 10}, {"qp": 50}),
        (Vp9, {"bitrate_kbps": 800, "vbv_ms": 200}, {"bitrate_kbps": 100, "vbv_ms": 200}),
        (Mjpeg, {"qp": 2}, {"qp": 20}),
    ],
)
def test_each_rate_trades_size_for_quality(codec_class: Any, better: dict[str, Any], worse: dict[str, Any]) -> None:
    (large, good), (small, bad) = (size_and_psnr(codec_class.create(**setting), GRAY) for setting in (better, worse))
    assert large > 1.15 * small
    assert good > bad + 0.5
    assert bad > 22


@pytest.mark.parametrize("codec_class", [H264, Hevc], **BY_NAME)
def test_a_bit_rate_is_kept(codec_class: Any) -> None:
    pictures = gliding_pictures(60, 96, 128, 1)
    size, _ = size_and_psnr(codec_class.create(bitrate_kbps=300, vbv_ms=300), pictures)
    assert size * 8 / 2 / 1000 == pytest.approx(300, rel=0.2)


@PREDICTING
@pytest.mark.parametrize(("gop", "starts"), [(7, [0, 7, 14, 21]), ("intra_only", list(range(24))), (1000, [0])])
def test_starts_come_each_gop(codec_class: Any, gop: Any, starts: list[int]) -> None:
    packets = packets_of(codec_class.create(gop=gop), GRAY)
    assert [packet.frame for packet in packets if packet.starts] == starts


@PREDICTING
def test_memory_is_worth_something(codec_class: Any) -> None:
    alone, _ = size_and_psnr(codec_class.create(gop="intra_only"), GRAY)
    with_memory, _ = size_and_psnr(codec_class.create(), GRAY)
    assert with_memory < 0.6 * alone


@EVERY_CODEC
@pytest.mark.parametrize("shape", [(1, 1), (1, 19), (23, 1), (17, 31), (64, 64), (65, 129)])
@pytest.mark.parametrize("channels", [1, 3])
def test_odd_and_small_sizes_come_back(codec_class: Any, shape: tuple[int, int], channels: int) -> None:
    pictures = gliding_pictures(3, *shape, channels)
    images = images_of(codec_class.create(), packets_of(codec_class.create(), pictures))
    assert [image.shape for image in images] == [picture.shape for picture in pictures]


def test_ffv1_keeps_every_sample_and_profits_from_memory() -> None:
    for pictures in (GRAY, COLOR):
        codec = Ffv1.create()
        assert codec.is_lossless()
        packets = packets_of(codec, pictures)
        assert all(np.array_equal(*pair) for pair in zip(images_of(codec, packets), pictures, strict=True))
        alone = packets_of(Ffv1.create(gop=1), pictures)
        assert sum(len(packet.data) for packet in packets) < sum(len(packet.data) for packet in alone)


@pytest.mark.parametrize("codec_class", [H264, Hevc, Vp9, Mjpeg], **BY_NAME)
def test_full_chroma_keeps_color_that_half_chroma_loses(codec_class: Any) -> None:
    rng = np.random.default_rng(4)
    colored = [rng.integers(0, 256, (48, 64, 3), dtype=np.uint8).repeat(2, axis=0)[:48] for _ in range(3)]
    rate = {"qp": 2} if codec_class is Mjpeg else {"qp": 12}
    full, half = (
        size_and_psnr(codec_class.create(pixel_format=pixel_format, **rate), colored)[1]
        for pixel_format in ("yuv444p", "yuv420p")
    )
    assert full > half + 8


@pytest.mark.parametrize("codec_class", [H264, Hevc, Ffv1], **BY_NAME)
def test_gray_drops_color_as_everything_here_does(codec_class: Any) -> None:
    rate = {} if codec_class is Ffv1 else {"qp": 10}
    codec = codec_class.create(pixel_format="gray", **rate)
    images = images_of(codec, packets_of(codec, COLOR))
    luma = [cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY) for picture in COLOR]
    luma = [np.stack([plane, plane, plane], axis=2) for plane in luma]
    if codec_class is Ffv1:
        assert all(np.array_equal(*pair) for pair in zip(images, luma, strict=True))
    else:
        assert psnr_db(luma, images) > 42


@pytest.mark.parametrize("codec_class", [H264, Hevc, Av1, Vp9], **BY_NAME)
def test_neutral_chroma_of_gray_pictures_costs_next_to_nothing(codec_class: Any) -> None:
    codec = codec_class.create()
    images = images_of(codec, packets_of(codec, GRAY))
    assert {image.ndim for image in images} == {2}
    if codec_class in (H264, Hevc):
        plain = sum(len(packet.data) for packet in packets_of(codec_class.create(pixel_format="gray"), GRAY))
        neutral = sum(len(packet.data) for packet in packets_of(codec, GRAY))
        assert neutral == pytest.approx(plain, rel=0.02)


@pytest.mark.parametrize(
    ("codec_class", "setting", "pattern"),
    [
        (H264, {"crf": 20, "qp": 20}, "and qp .* crf, qp, bitrate_kbps"),
        (H264, {"crf": 60}, r"of libx264 .* 0\.\.51, got 60"),
        (H264, {"preset": "quick"}, "'quick'; .* ultrafast, superfast"),
        (H264, {"vbv_ms": 100}, "vbv_ms .*bitrate_kbps"),
        (H264, {"pixel_format": "rgb"}, "gray, yuv420p, yuv444p"),
        (H264, {"gop": 1, "intra_refresh": True}, "gop .* 2 or more"),
        (H264, {"intra_refresh": True, "latency": "any"}, "`latency: low`"),
        (H264, {"encoder": ["libx264"]}, "encoder"),
        (H264, {"pixel_format": None}, "pixel_format"),
        (H264, {"encoder": "h264_nvenc", "preset": "veryfast"}, "nvenc .*'veryfast'; .* p1, p2"),
        (H264, {"encoder": "h264_v4l2m2m", "crf": 20}, "v4l2m2m .* crf; .* bitrate_"),
        (Hevc, {"crf": 20, "bitrate_kbps": 100}, "crf .*bitrate_kbps"),
        (Av1, {"pixel_format": "gray"}, "only yuv420p .gray"),
        (Av1, {"pixel_format": "yuv444p"}, "libsvtav1 .*'yuv444p'"),
        (Av1, {"crf": 20.5}, "libsvtav1 .*whole number"),
        (Av1, {"intra_refresh": True}, "libsvtav1 .*intra_refresh"),
        (Hevc, {"intra_refresh": True}, "libx265 .*intra_refresh"),
        (Vp9, {"bitrate_kbps": 200, "vbv_ms": 200, "latency": "any"}, "ignores vbv_ms"),
        (Av1, {"preset": "fast"}, "'fast'; .* 0, 1, 2"),
        (Vp9, {"pixel_format": "gray"}, "only yuv420p, yuv444p"),
        (Mjpeg, {"crf": 20}, "mjpeg .* crf; .* qp"),
        (Mjpeg, {"gop": 10}, "gop .* 1 .*, not 10"),
        (Mjpeg, {"latency": "any"}, "mjpeg never delays"),
        (Ffv1, {"qp": 5}, "ffv1 .* qp; .* none"),
        (Ffv1, {"preset": 3}, "ffv1 .*preset 3; .* none"),
    ],
)
def test_unsupported_settings_are_refused_with_the_supported_ones(
    codec_class: Any, setting: dict[str, Any], pattern: str
) -> None:
    with pytest.raises(ValidationError, match=pattern):
        codec_class.create(**setting)


def test_two_spellings_of_a_setting_are_one() -> None:
    assert H264.create().params == H264.create(crf=23, preset="veryfast").params
    assert Hevc.create(gop="intra_only").params == Hevc.create(gop=1).params
    assert Vp9.create(qp=20).params.crf is None
    assert H264.create(crf=None, preset=None).params == H264.create().params


@EVERY_CODEC
def test_a_picture_of_another_shape_is_refused(codec_class: Any) -> None:
    encoder = codec_class.create().encoder(30)
    encoder.push(GRAY[0])
    with pytest.raises(ImageError, match=r"\(96, 100\) .* stream .*\(96, 128\)"):
        encoder.push(np.ascontiguousarray(GRAY[0][:, :100]))


def plainly_encoded(encoder: str, options: dict[str, str], pictures: list[np.ndarray]) -> tuple[int, list[np.ndarray]]:
    """What FFmpeg writes and reads by itself: its own conversion of color, its own demuxer's packets."""
    file = io.BytesIO()
    form = {"libx264": "h264", "libx265": "hevc"}.get(encoder, "ivf")
    with av.open(file, "w", format=form) as container, library.preserve_scheduling():
        stream = container.add_stream(encoder, rate=30, options=options)
        stream.width, stream.height = pictures[0].shape[1], pictures[0].shape[0]
        stream.pix_fmt, stream.codec_context.thread_count = "yuv420p", 1
        stream.codec_context.color_range, stream.codec_context.colorspace = 2, 5
        for picture in pictures:
            frame = av.VideoFrame.from_ndarray(picture, "gray" if picture.ndim == 2 else "rgb24")
            frame = frame.reformat(format="yuv420p", dst_colorspace="ITU601", dst_color_range="JPEG",
                                   src_color_range="JPEG")  # fmt: skip
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    file.seek(0)
    with av.open(file, format=form) as container:
        size = sum(packet.size for packet in container.demux(video=0))
    file.seek(0)
    with av.open(file, format=form) as container:
        decoded = [frame.to_ndarray(format="yuv420p" if frame.format.name != "yuvj420p" else "yuvj420p")
                   for frame in container.decode(video=0)]  # fmt: skip
    height = pictures[0].shape[0]
    return size, [frame[:height] for frame in decoded]


@pytest.mark.parametrize(
    ("codec", "encoder", "options"),
    [
        (H264.create(crf=28, gop=12), "libx264",
         {"crf": "28", "preset": "veryfast", "tune": "zerolatency", "g": "12", "sc_threshold": "0"}),
        (Hevc.create(crf=30, gop=12), "libx265",
         {"crf": "30", "preset": "veryfast", "tune": "zerolatency", "g": "12",
          "x265-params": "frame-threads=1:pools=none:log-level=none:info=0:open-gop=0:scenecut=0:min-keyint=12"}),
        (Av1.create(crf=35, gop=12), "libsvtav1",
         {"crf": "35", "preset": "8", "g": "12", "svtav1-params": "lp=1:scd=0:pred-struct=1:lookahead=0"}),
        (Vp9.create(qp=40, gop=12), "libvpx-vp9",
         {"crf": "40", "b": "0", "qmin": "40", "qmax": "40", "deadline": "realtime", "cpu-used": "7",
          "lag-in-frames": "0", "g": "12", "keyint_min": "12", "row-mt": "0"}),
    ],
    ids=["h264", "hevc", "av1", "vp9"],
)  # fmt: skip
def test_ffmpeg_by_itself_writes_as_much_and_as_well(codec: Any, encoder: str, options: dict[str, str]) -> None:
    pictures = gliding_pictures(36, 240, 320, 1)
    size, decoded = plainly_encoded(encoder, options, pictures)
    ours, ours_db = size_and_psnr(codec, pictures)
    assert ours == pytest.approx(size, rel=0.01)
    assert ours_db == pytest.approx(psnr_db(pictures, decoded), abs=0.05)


@EVERY_CODEC
def test_libraries_are_recorded_with_their_versions(codec_class: Any) -> None:
    libraries = codec_class.create().libraries()
    assert libraries["av"] == importlib.metadata.version("av")
    assert libraries["libavcodec"].count(".") == 2


def test_a_missing_encoder_is_said_with_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    real = av.Codec

    def without_x265(name: str, mode: str = "r") -> Any:
        if name == "libx265":
            raise ValueError("UnknownCodecError('libx265')")
        return real(name, mode)

    monkeypatch.setattr(av, "Codec", without_x265)
    H264.create()
    with pytest.raises(Unsupported, match=r"no libx265; .*pip"):
        Hevc.create()


def test_a_missing_library_is_said_with_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    library.load_av.cache_clear()
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(Unsupported, match=r"pip install .*\[video\]"):
        H264.create()
    monkeypatch.undo()
    library.load_av.cache_clear()


@pytest.mark.parametrize("encoder", ["h264_nvenc", "h264_v4l2m2m", "h264_vaapi"])
def test_hardware_is_used_where_it_is_and_refused_with_a_reason_where_not(encoder: str) -> None:
    try:
        codec = H264.create(encoder=encoder)
    except Unsupported as unsupported:
        reason = str(unsupported)
    else:
        packets = packets_of(codec, gliding_pictures(4, 240, 320, 1))
        assert [picture.frame for picture in decoded_of(codec, packets)] == [0, 1, 2, 3]
        return
    assert encoder in reason
    assert "set encoder: libx264" in reason
    assert "avcodec_open2" not in reason


HARDWARE = {"h264_nvenc": "NVIDIA GPU", "h264_v4l2m2m": "/dev/video", "h264_vaapi": "/dev/dri"}


@pytest.mark.parametrize("encoder", HARDWARE)
def test_without_its_hardware_an_encoder_says_what_it_needs(encoder: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """On every machine: nothing can be opened here."""

    class Shut:
        def open(self) -> None:
            raise av.FFmpegError(1, "Operation not permitted")

    monkeypatch.setattr(av, "Codec", lambda name, mode="r": None)
    monkeypatch.setattr(library.load_av(), "CodecContext", type("Opener", (), {"create": lambda name, mode: Shut()}))
    said = rf"^{encoder} .* 640x480 \(Operation not permitted\): .*{HARDWARE[encoder]}.*; .*set encoder: libx264"
    with pytest.raises(Unsupported, match=said):
        H264.create(encoder=encoder)


@pytest.mark.parametrize("encoder", HARDWARE)
def test_a_build_without_a_hardware_encoder_is_no_matter_of_reinstalling(
    encoder: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def without(name: str, mode: str = "r") -> Any:
        raise ValueError(f"UnknownCodecError({name!r})")

    monkeypatch.setattr(av, "Codec", without)
    with pytest.raises(Unsupported, match=f"no {encoder}; .*wheels .*encoder: libx264") as refused:
        H264.create(encoder=encoder)
    assert "pip install" not in str(refused.value)


_NOISY = """
import numpy as np
from codecbench.core.conformance.harness import decoded_of, packets_of
from codecbench.core.contracts.stream import LOST
from codecbench.plugins.codecs.video.codecs import Av1, Ffv1, H264, Hevc, Mjpeg, Vp9
rng = np.random.default_rng(1)
pictures = [rng.integers(0, 256, (64, 80), dtype=np.uint8) for _ in range(6)]
for codec_class in (H264, Hevc, Av1, Vp9, Mjpeg, Ffv1):
    codec = codec_class.create()
    packets = packets_of(codec, pictures)
    decoded_of(codec, [packets[0], LOST, *packets[2:]])
"""


def test_libraries_say_nothing_on_standard_error() -> None:
    environment = {name: value for name, value in os.environ.items() if name != "SVT_LOG"}
    done = subprocess.run([sys.executable, "-c", _NOISY], capture_output=True, text=True, check=True, env=environment)
    assert (done.stdout, done.stderr) == ("", "")


def test_frame_rates_that_are_no_whole_numbers_are_taken() -> None:
    codec = H264.create(bitrate_kbps=200)
    assert len(packets_of(codec, GRAY)) == len(GRAY)
    for rate in (29.97, 30000 / 1001, 7.5, 0.5, 120.0):
        encoder = codec.encoder(rate)
        assert len(encoder.push(GRAY[0])) == 1
    assert Fraction(30000 / 1001).limit_denominator(1001) == Fraction(30000, 1001)
