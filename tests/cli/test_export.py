"""`codecbench export`: files that other programs read, with the very pictures that evaluators see."""

from __future__ import annotations

import io
import shutil
import subprocess
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from click.testing import CliRunner, Result

pytest.importorskip("av", reason="the extra `video` is not installed")

import av
from video_pictures import gliding_pictures

from codecbench import Packet, ParamsError
from codecbench.cli import cli
from codecbench.core.conformance.harness import decoded_of, packets_of
from codecbench.core.engine.plugins.registry import installed
from codecbench.core.engine.running.coding.coded_frames import CodedFrames
from codecbench.core.engine.running.coding.position import WorkPosition
from codecbench.core.engine.storage.bitstream_file import BitstreamFile
from codecbench.core.engine.storage.store import Store
from codecbench.plugins.codecs.video.codecs import H264, Av1, Ffv1, Hevc, Mjpeg, Vp9
from codecbench.plugins.codecs.video.color import image_from_frame
from codecbench.plugins.codecs.video.header import Header
from codecbench.plugins.codecs.video.muxing import file_from_packets

FRAMES = 10
MATRIX = f"""
version: 1
name: moving
sequences: [{{use: synthetic, params: {{frames: {FRAMES}}}}}]
codecs:
  - {{use: h264, params: {{gop: {{grid: [4, 30]}}}}}}
  - {{use: jpeg}}
  - {{use: raw}}
evaluators: [quality]
run: {{workers: 1}}
"""


def payloads(packets: list[Packet], magic: bytes) -> list[bytes]:
    return [Header.parse(packet.data, magic)[1] if packet.starts else packet.data for packet in packets]


def frames_of(content: bytes, form: str | None = None) -> list[Any]:
    with av.open(io.BytesIO(content), format=form) as file:
        return list(file.decode(video=0))


@pytest.mark.parametrize(
    ("codec_class", "suffix"),
    [(H264, ".h264"), (Hevc, ".hevc"), (Av1, ".obu"), (Mjpeg, ".mjpeg")],
    ids=lambda value: getattr(value, "name", value),
)
def test_an_elementary_stream_is_what_was_sent_byte_for_byte(codec_class: Any, suffix: str) -> None:
    codec = codec_class.create(**({} if codec_class is Mjpeg else {"gop": 4}))
    packets = packets_of(codec, gliding_pictures(9, 96, 128, 1))
    assert file_from_packets(codec, packets, 30, f"x{suffix}") == b"".join(payloads(packets, codec.magic))


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("suffix", [".mp4", ".mkv"])
@pytest.mark.parametrize(
    ("codec_class", "latency"),
    [
        *((codec_class, "low") for codec_class in (H264, Hevc, Av1, Vp9, Mjpeg, Ffv1)),
        *((codec_class, "any") for codec_class in (H264, Hevc, Av1, Vp9)),  # the others have no look-ahead
    ],
    ids=lambda value: getattr(value, "name", value),
)
def test_a_demuxer_finds_the_pictures_and_their_times(
    codec_class: Any, latency: Any, suffix: str, channels: int
) -> None:
    codec = codec_class.create(latency=latency)
    packets = packets_of(codec, gliding_pictures(9, 66, 98, channels))
    content = file_from_packets(codec, packets, 20, f"x{suffix}")
    frames = frames_of(content)
    for picture, frame in zip(decoded_of(codec, packets), frames, strict=True):
        shown = image_from_frame(frame, channels)
        assert shown is not None
        assert np.array_equal(shown[:66, :98], picture.image)
    assert [frame.time for frame in frames] == pytest.approx([index / 20 for index in range(9)], abs=0.002)
    sent = sum(map(len, payloads(packets, codec.magic)))
    with av.open(io.BytesIO(content)) as file:
        kept = sum(packet.size for packet in file.demux(video=0))
    assert kept == pytest.approx(sent, abs=4 * len(packets)), "containers spell start codes and delimiters otherwise"
    if codec_class in (Vp9, Mjpeg, Ffv1):
        assert kept == sent


@pytest.mark.parametrize("suffix", [".mp4", ".mkv"])
@pytest.mark.parametrize("codec_class", [H264, Hevc], ids=lambda codec_class: codec_class.name)
def test_a_file_with_pictures_sent_before_their_turn_begins_at_zero(codec_class: Any, suffix: str) -> None:
    codec = codec_class.create(latency="any")
    packets = packets_of(codec, gliding_pictures(24, 96, 128, 1))
    assert [packet.frame for packet in packets] != list(range(24)), "B-frames are sent after what they lie before"
    content = file_from_packets(codec, packets, 30, f"x{suffix}")
    assert [frame.time for frame in frames_of(content)] == pytest.approx(np.arange(24) / 30, abs=0.001)
    with av.open(io.BytesIO(content)) as file:
        assert (file.start_time, file.streams.video[0].start_time) == (0, 0)
        assert file.duration / 1e6 == pytest.approx(24 / 30, abs=0.04)
    if ffprobe := shutil.which("ffprobe"):
        asked = [ffprobe, "-v", "error", "-show_entries", "format=start_time", "-of", "csv=p=0", "-"]
        said = subprocess.run(asked, input=content, capture_output=True, check=True).stdout
        assert float(said) == 0.0


@pytest.mark.parametrize("codec_class", [Av1, Vp9], ids=lambda codec_class: codec_class.name)
def test_an_ivf_file_has_the_times_of_its_frame_rate(codec_class: Any) -> None:
    codec = codec_class.create(latency="any")
    packets = packets_of(codec, gliding_pictures(9, 66, 98, 1))
    times_s = [frame.time for frame in frames_of(file_from_packets(codec, packets, 20, "x.ivf"))]
    assert times_s == pytest.approx(np.arange(9) / 20, abs=0.001)


def test_a_file_that_takes_no_such_codec_is_refused() -> None:
    packets = packets_of(H264.create(), gliding_pictures(2, 96, 128, 1))
    with pytest.raises(ParamsError, match=r"^x\.hevc: .* h264"):
        file_from_packets(H264.create(), packets, 30, "x.hevc")
    with pytest.raises(ParamsError, match=r"^x\.avi: .* \.mp4, \.mkv"):
        file_from_packets(H264.create(), packets, 30, "x.avi")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("export")
    (folder / "moving.yaml").write_text(MATRIX)
    done = CliRunner().invoke(cli, ["run", str(folder / "moving.yaml"), "--out", str(folder / "run")])
    assert done.exit_code == 0, done.output
    return folder / "run"


def export(run: Path, *words: str) -> Result:
    return CliRunner().invoke(cli, ["export", str(run), *words])


@pytest.mark.thorough
def test_the_file_shows_what_evaluators_see(run: Path, tmp_path: Path) -> None:
    out = tmp_path / "office.mp4"
    done = export(run, "--codec", "h264", "--setting", "gop=4", "--out", str(out))
    assert done.exit_code == 0, done.output
    assert f"{out}: {FRAMES} frames" in done.output
    store = Store(run)
    (job,) = [job for job in store.read_plan().jobs if job.codec.params.get("gop") == 4]
    sequence = installed().create("dataset", job.sequence.dataset.name, job.sequence.dataset.params).open()
    codec = installed().create("codec", "h264", job.codec.params)
    bitstreams = BitstreamFile(store.coded_path(job.id), job.id)
    coded = CodedFrames(sequence, codec, bitstreams, WorkPosition())
    frames = frames_of(out.read_bytes())
    assert len(frames) == FRAMES
    for seen, frame in zip(coded, frames, strict=True):
        assert np.array_equal(image_from_frame(frame, sequence.channels), seen.decoded)
    with av.open(str(out)) as file:
        assert float(file.streams.video[0].average_rate) == pytest.approx(sequence.frame_rate_hz, rel=0.01)
    capture = cv2.VideoCapture(str(out))
    assert capture.get(cv2.CAP_PROP_FRAME_COUNT) == FRAMES


@pytest.mark.thorough
@pytest.mark.parametrize(
    "words",
    [
        ["table"],
        ["table", "--all"],
        *(["table", "--format", form] for form in ("csv", "json", "markdown", "latex")),
        ["table", "--tidy", "--format", "csv"],
        ["table", "--columns", "*psnr*", "--format", "csv"],
        *(["report", "--format", form] for form in ("html", "markdown", "latex")),
        ["rank", "--format", "markdown"],
    ],
    ids=" ".join,
)
def test_every_table_says_the_pixel_format(run: Path, words: list[str], tmp_path: Path) -> None:
    command, *options = words
    out = tmp_path / "out"
    done = CliRunner().invoke(cli, [command, str(run), *options, *(["--out", str(out)] if command == "report" else [])])
    assert done.exit_code == 0, done.output
    assert "half size (yuv420p)" in (out.read_text() if command == "report" else " ".join(done.output.split()))


@pytest.mark.thorough
def test_bitstreams_of_pictures_become_a_file_each(run: Path, tmp_path: Path) -> None:
    assert export(run, "--codec", "jpeg", "--out", str(tmp_path / "jpeg")).exit_code == 0
    files = sorted((tmp_path / "jpeg").iterdir())
    assert [file.name for file in files] == [f"{frame:06}.jpg" for frame in range(FRAMES)]
    assert cv2.imread(str(files[0]), cv2.IMREAD_UNCHANGED).shape[:2] == (480, 640)
    assert export(run, "--codec", "raw", "--out", str(tmp_path / "raw")).exit_code == 0
    assert {file.suffix for file in (tmp_path / "raw").iterdir()} == {".bin"}


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("words", "fact"),
    [
        (["--codec", "h264", "--out", "x.mp4"], "--setting and --sequence: h264"),
        (["--codec", "h264", "--setting", "gop=5", "--out", "x.mp4"], "no h264 gop=5"),
        (["--codec", "jpeg", "--out", "x.mkv"], "not a video codec"),
        (["--codec", "jpeg", "--sequence", "elsewhere", "--out", "x"], "on elsewhere"),
        (["--codec", "jpeg", "--out", "."], "already exists"),
    ],
)
def test_wrong_options_are_usage_errors(run: Path, words: list[str], fact: str) -> None:
    done = export(run, *words)
    assert done.exit_code == 2
    assert fact in done.output
