"""The `stream` evaluator on streams whose sizes, delays and starts are known."""

from __future__ import annotations

import math
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from codecbench_delta.codec import Delta
from memory_sequence import CodedInMemory, MemorySequence, context

from codecbench import Capabilities, Image, Loss, NoParams, Packet, Picture, StreamCodec, StreamDecoder, StreamEncoder
from codecbench.core.contracts.evaluator import SentPacket
from codecbench.core.engine.running.coding.coded_frames import CodedFrames
from codecbench.core.engine.running.coding.encoding import encode_sequence
from codecbench.core.engine.running.coding.position import WorkPosition
from codecbench.core.engine.storage.bitstream_file import BitstreamFile, write_stream
from codecbench.plugins.evaluators.stream import Stream, join_places

JOB = "0f" * 16


class Told:
    """A coded sequence of which only the packets are known, at 10 Hz."""

    def __init__(self, *packets: SentPacket) -> None:
        self.packets = packets
        self.sequence = MemorySequence([np.zeros((8, 16), np.uint8)] * len(packets))


def measured(coded: Any, folder: Path, **params: Any) -> dict[str, float]:
    found = [m for m in Stream.create(**params).evaluate(coded, context(folder)) if m.frame is None]
    assert all(bool(m.reason) == math.isnan(m.value) for m in found)
    return {m.metric: m.value for m in found}


def coded(codec: StreamCodec[Any], images: list[Image]) -> CodedFrames:
    sequence, stream = MemorySequence(images), BytesIO()
    write_stream(stream, encode_sequence(codec, sequence, WorkPosition()), JOB)
    return CodedFrames(sequence, codec, BitstreamFile(stream.getvalue(), JOB), WorkPosition())


def moving(frames: int) -> list[Image]:
    return [np.full((8, 16), 7 * index, np.uint8) for index in range(frames)]


def test_rates_are_those_of_the_packets_at_the_frame_rate(tmp_path: Path) -> None:
    sizes = [1000, *[100] * 8, 1000, 500, *[100] * 9]
    told = Told(*(SentPacket(frame, size, size == 1000, frame + 1) for frame, size in enumerate(sizes)))
    found = measured(told, tmp_path, joins=0)
    per_frame = [m for m in Stream.create(joins=0).evaluate(told, context(tmp_path)) if m.frame is not None]  # type: ignore[arg-type]
    assert [(m.metric, m.frame) for m in per_frame] == [("bitrate_kbps", frame) for frame in range(20)]
    assert [m.value for m in per_frame] == pytest.approx([size * 8 * 10 / 1000 for size in sizes])
    assert found["mean_frame_bytes"] == sum(sizes) / 20
    assert found["largest_frame_bytes"] == 1000
    assert found["peak_kbps"] == pytest.approx(8 * (1000 + 8 * 100 + 1000) / 1000)
    assert found["intra_to_predicted"] == pytest.approx(1000 / ((17 * 100 + 500) / 18))
    assert "joining_frames" not in found


def test_what_short_or_plain_sequences_lack_is_missing(tmp_path: Path) -> None:
    found = measured(CodedInMemory(MemorySequence(moving(1))), tmp_path)
    missing = {"peak_kbps", "intra_to_predicted", "joining_frames", "joining_worst_frames"}
    assert {name for name, value in found.items() if math.isnan(value)} == missing


@pytest.mark.parametrize(("hold", "first"), [(0, 0), (3, 3), (30, 11)])
def test_delay_is_how_many_frames_the_encoder_held_back(hold: int, first: int, tmp_path: Path) -> None:
    found = measured(coded(Delta.create(hold=hold), moving(12)), tmp_path)
    assert (found["delay_frames"], found["delay_ms"]) == (first, 100.0 * first)
    assert (found["first_packet_frames"], found["first_packet_ms"]) == (first, 100.0 * first)


def test_a_decoder_that_joins_waits_for_the_next_keyframe(tmp_path: Path) -> None:
    frames, gop = 24, 8
    joins = join_places(frames, 4)
    waits = [-place % gop for place in joins]
    for params in ({}, {"hold": 5}):
        found = measured(coded(Delta.create(gop=gop, **params), moving(frames)), tmp_path, joins=4)
        assert found["joining_frames"] == np.median(waits)
        assert found["joining_worst_frames"] == max(waits)


def test_a_decoder_that_joins_after_the_last_keyframe_is_never_whole(tmp_path: Path) -> None:
    found = list(Stream.create().evaluate(coded(Delta.create(gop=100), moving(12)), context(tmp_path)))
    joining = {m.metric: (m.value, m.reason) for m in found if m.metric.startswith("joining")}
    assert len(joining) == 2
    for value, reason in joining.values():
        assert math.isnan(value)
        assert "5 of 5" in str(reason)


def test_single_pictures_are_whole_at_once(tmp_path: Path) -> None:
    found = measured(CodedInMemory(MemorySequence(moving(12))), tmp_path)
    assert found["joining_frames"] == found["joining_worst_frames"] == found["delay_ms"] == 0.0
    found = measured(coded(Delta.create(gop=1), moving(12)), tmp_path)
    assert found["joining_frames"] == found["joining_worst_frames"] == 0.0


class Fading(StreamCodec[NoParams]):
    """Starts once. Who joins later sees a picture that is wrong by 64, 32, 16 ...: halved with each packet."""

    name = "fading"
    version = "1"
    params_type = NoParams
    capabilities = Capabilities()

    def encoder(self, frame_rate_hz: float) -> StreamEncoder:
        return _FadingEncoder()

    def decoder(self) -> StreamDecoder:
        return _FadingDecoder()


class _FadingEncoder(StreamEncoder):
    def __init__(self) -> None:
        self.pushed = 0

    def push(self, image: Image, **_: Any) -> list[Packet]:
        self.pushed += 1
        return [Packet(image.tobytes(), self.pushed - 1, self.pushed == 1)]

    def flush(self) -> list[Packet]:
        return []


class _FadingDecoder(StreamDecoder):
    def __init__(self) -> None:
        self.wrong = -1

    def push(self, packet: Packet | Loss, **_: Any) -> list[Picture]:
        assert not isinstance(packet, Loss)
        self.wrong = (0 if packet.starts else 64) if self.wrong < 0 else self.wrong // 2
        image = np.frombuffer(packet.data, np.uint8).reshape(8, 16).copy()
        image[0, 0] += self.wrong
        return [Picture(packet.frame, "concealed" if self.wrong else "whole", image)]

    def flush(self) -> list[Picture]:
        return []


@pytest.mark.parametrize(("whole_db", "frames"), [(100.0, 7), (50.0, 3), (30.0, 0)])
def test_pictures_are_whole_from_the_psnr_that_was_asked_for(whole_db: float, frames: int, tmp_path: Path) -> None:
    """One of 128 pixels wrong by e: 10 log10(255^2 * 128 / e^2) is 33.1 dB for 64, 51.1 for 8, 69.2 for 1."""
    found = measured(coded(Fading.create(), moving(30)), tmp_path, whole_db=whole_db)
    assert found["joining_frames"] == found["joining_worst_frames"] == frames


def test_joins_are_in_the_first_half_one_in_each_part_and_the_same_for_all() -> None:
    for packets in (2, 3, 10, 60, 301):
        for joins in (1, 4, 50):
            places = join_places(packets, joins)
            assert len(set(places)) == len(places) == min(joins, packets // 2)
            assert 1 <= min(places) <= max(places) <= packets // 2
            assert places == sorted(places) == join_places(packets, joins)
    assert join_places(1, 5) == []
