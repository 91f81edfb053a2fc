"""MCAP files, read with the library and the decoder that Foxglove publishes."""

from __future__ import annotations

import json
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

pytest.importorskip("mcap_protobuf", reason="the extra `bag` is not installed")
pytest.importorskip("av", reason="the extra `video` is not installed")

import av
from exported_run import COUNT, TIMES_NS, export, frames
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from measured_runs import cell_result
from memory_sequence import CodedInMemory, MemorySequence

from codecbench.core.contracts.errors import CodecbenchError
from codecbench.core.contracts.sequence import Depth
from codecbench.core.engine.planning.model import CodingJob
from codecbench.exporting import mcap_file
from codecbench.exporting.coded_run import CodedRun

Messages = dict[str, list[tuple[int, Any]]]
"""Times in nanoseconds and messages, by topic."""


def messages(path: Path) -> Messages:
    found: Messages = defaultdict(list)
    with path.open("rb") as stream:
        for schema, channel, message, decoded in make_reader(
            stream, decoder_factories=[DecoderFactory(), JsonDecoderFactory()]
        ).iter_decoded_messages():
            assert schema is not None
            assert message.publish_time == message.log_time
            found[channel.topic].append((message.log_time, decoded))
    return found


class JsonDecoderFactory:
    def decoder_for(self, encoding: str, schema: Any) -> Any:
        return json.loads if (encoding, schema.encoding) == ("json", "jsonschema") else None


def pixels(message: Any) -> np.ndarray:
    assert (message.encoding, message.step, message.width) == ("mono8", 98, 98)
    return np.frombuffer(message.data, np.uint8).reshape(message.height, 98)


def test_decoded_frames_are_those_of_another_decoder_at_their_times(run: Path, tmp_path: Path) -> None:
    assert export(run, "--codec", "jpeg", "--out", str(tmp_path / "jpeg")).exit_code == 0
    done = export(run, "--codec", "jpeg", "--out", str(tmp_path / "jpeg.mcap"))
    assert done.exit_code == 0, done.output
    assert "no estimated path: the run has no trajectory" in done.output
    shown = messages(tmp_path / "jpeg.mcap")
    shown_frames = shown["/camera/decoded"]
    assert [time for time, _ in shown_frames] == TIMES_NS
    assert [message.timestamp.ToNanoseconds() for _, message in shown_frames] == TIMES_NS
    files = sorted((tmp_path / "jpeg").iterdir())
    for file, (_, message) in zip(files, shown_frames, strict=True):
        assert np.array_equal(pixels(message), cv2.imread(str(file), cv2.IMREAD_UNCHANGED))
    assert [values for _, values in shown["/values/codec"]] == [{"size_bytes": file.stat().st_size} for file in files]
    psnr_db = [values["psnr_gray_db"] for _, values in shown["/values/quality"]]
    raw = frames()
    assert psnr_db == pytest.approx(
        [cv2.PSNR(image, pixels(m)) for image, (_, m) in zip(raw, shown_frames, strict=True)]
    )


def test_the_true_path_is_that_during_the_frames(run: Path, tmp_path: Path) -> None:
    assert export(run, "--codec", "raw", "--out", str(tmp_path / "raw.mcap")).exit_code == 0
    shown = messages(tmp_path / "raw.mcap")
    assert [time for time, _ in shown["/truth/pose"]] == TIMES_NS
    assert [message.pose.position.x for _, message in shown["/truth/pose"]] == list(range(1, COUNT + 1))
    ((time, path),) = shown["/truth/path"]
    assert time == TIMES_NS[0]
    assert list(map(str, path.poses)) == [str(message.pose) for _, message in shown["/truth/pose"]]
    turn = path.poses[0].orientation
    assert (turn.x, turn.y, turn.z, turn.w) == pytest.approx((0, 0, 0.6, 0.8))
    assert "psnr_gray_db" not in shown["/values/quality"][0][1], "it is infinite"
    assert [[time for time, _ in topic] for topic in shown.values()] == [
        sorted(time for time, _ in topic) for topic in shown.values()
    ]


def played(decoder: str, contents: list[bytes]) -> list[np.ndarray]:
    """The luma of each picture, as FFmpeg decodes a stream; as OpenCV decodes an image if there is no decoder."""
    if not decoder:
        return [cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) for data in contents]
    player = av.CodecContext.create(decoder, "r")
    packets = [*map(av.Packet, contents), None]
    return [frame.to_ndarray()[:66, :98] for packet in packets for frame in player.decode(packet)]


@pytest.mark.parametrize(
    ("words", "name", "decoder"),
    [
        ("--codec h264 --setting latency=low", "h264", "h264"),
        ("--codec hevc", "h265", "hevc"),
        ("--codec av1", "av1", "libdav1d"),
        ("--codec vp9", "vp9", "vp9"),
        ("--codec jpeg", "jpeg", ""),
    ],
)
def test_a_player_decodes_the_coded_stream_to_the_decoded_frames(
    run: Path, tmp_path: Path, words: str, name: str, decoder: str
) -> None:
    for option, file in (("--coded", "coded.mcap"), ("--repeat=0", "decoded.mcap")):
        done = export(run, *words.split(), option, "--out", str(tmp_path / file))
        assert done.exit_code == 0, done.output
    coded = messages(tmp_path / "coded.mcap")["/camera/coded"]
    decoded = [pixels(message) for _, message in messages(tmp_path / "decoded.mcap")["/camera/decoded"]]
    assert [time for time, _ in coded] == TIMES_NS
    assert {message.format for _, message in coded} == {name}
    for start in (0, 3):  # the second group has all that a player needs to join there
        for shown, image in zip(played(decoder, [m.data for _, m in coded[start:]]), decoded[start:], strict=True):
            assert np.array_equal(shown, image)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--codec h264 --setting latency=any --coded", "B-frames, which Foxglove does not decode"),
        ("--codec raw --coded", "does not decode the bitstreams of raw on"),
        ("--codec jpeg --evaluator trajectory", "the run has no trajectory"),
        ("--codec jpeg --sequences-from nowhere", "not in nowhere"),
    ],
)
def test_what_cannot_be_written_is_a_sentence_and_no_file(run: Path, tmp_path: Path, words: str, said: str) -> None:
    done = export(run, *words.split(), "--out", str(tmp_path / "x.mcap"))
    assert isinstance(done.exception, CodecbenchError), done.output
    assert said in str(done.exception)
    assert list(tmp_path.iterdir()) == []


def test_a_missing_library_is_named_with_its_extra(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "codecbench.exporting.mcap_file", None)
    done = export(run, "--codec", "jpeg", "--out", str(tmp_path / "x.mcap"))
    assert done.exit_code == 2
    assert "pip install 'codecbench[bag]'" in done.output


@pytest.mark.parametrize(
    ("image", "depth", "encoding", "step"),
    [
        (np.arange(4 * 6 * 3, dtype=np.uint8).reshape(4, 6, 3), None, "rgb8", 18),
        (np.arange(4 * 6, dtype=np.uint16).reshape(4, 6) * 2000, None, "mono16", 12),
        (np.arange(4 * 6, dtype=np.uint16).reshape(4, 6) * 2000, Depth(0.001), "16UC1", 12),
    ],
)
def test_colors_and_depth_are_whole(tmp_path: Path, image: Any, depth: Depth | None, encoding: str, step: int) -> None:
    cell = cell_result("function", 1, "quality").cell
    sequence = MemorySequence([image, image[::-1]])
    sequence.depth = depth
    coded = CodedInMemory(sequence)
    job = CodingJob("0f", cell.sequence, cell.codec)
    mcap_file.write(CodedRun(job, coded, [5, 7], {}, {}), tmp_path / "x.mcap", coded=False)
    (first_ns, first), (second_ns, second) = messages(tmp_path / "x.mcap")["/camera/decoded"]
    assert (first_ns, second_ns) == (5, 7)
    assert (first.encoding, first.step, first.width, first.height) == (encoding, step, 6, 4)
    little_endian = image.dtype.newbyteorder("<")
    assert np.array_equal(np.frombuffer(first.data, little_endian).reshape(image.shape), image)
    assert np.array_equal(np.frombuffer(second.data, little_endian).reshape(image.shape), image[::-1])
