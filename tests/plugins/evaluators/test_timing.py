"""The `timing` evaluator against codecs that take a known time."""

from __future__ import annotations

import gc
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from held_clock import CLOCK, held_clock
from memory_sequence import MemorySequence, context

from codecbench.core.contracts.codec import Capabilities, Codec, StreamCodec
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.params import NoParams
from codecbench.core.contracts.sequence import Frame
from codecbench.core.contracts.stream import Loss, Packet, Picture, StreamDecoder, StreamEncoder
from codecbench.core.counting.trace import NULL_TRACE, Trace
from codecbench.plugins.evaluators.timed_calls import time_repeatedly
from codecbench.plugins.evaluators.timing import Timing

pytestmark = pytest.mark.usefixtures(held_clock.__name__)


class Slow(Codec[NoParams]):
    """Sleeps to encode, computes to decode, and is slow the first time."""

    name = "slow"
    version = "1"
    params_type = NoParams
    capabilities = Capabilities()

    def __init__(self) -> None:
        super().__init__(NoParams())
        self.calls: Counter[str] = Counter()
        self.collecting: set[bool] = set()

    def encode(self, image: Image, *, trace: Trace = NULL_TRACE) -> bytes:
        self.calls["encode"] += 1
        CLOCK.sleep(0.3 if self.calls["encode"] == 1 else 0.02)
        return image.tobytes()

    def decode(self, bitstream: bytes, *, trace: Trace = NULL_TRACE) -> Image:
        self.calls["decode"] += 1
        self.collecting.add(gc.isenabled())
        CLOCK.compute(0.01)
        return np.frombuffer(bitstream, np.uint8).reshape(100, 200)


class SlowToRead(MemorySequence):
    def read(self, index: int) -> Frame:
        CLOCK.sleep(0.1)
        return super().read(index)


def test_what_is_timed_is_the_codec_alone_and_warm(tmp_path: Path) -> None:
    sequence = SlowToRead([np.zeros((100, 200), np.uint8)] * 4)
    codec = Slow()
    found: dict[str, list[float]] = {metric.name: [] for metric in Timing.metrics}
    frames = set()
    for measured in Timing.create(frames=2, warmup=1).evaluate(codec, sequence, context(tmp_path)):
        found[measured.metric].append(measured.value)
        frames.add(measured.frame)
    assert frames == {1, 3}
    assert all(len(series) == 2 for series in found.values())
    assert found["encode_wall_ms"] == pytest.approx([20, 20])
    assert found["encode_cpu_ms"] == [0, 0]
    assert found["decode_wall_ms"] == found["decode_cpu_ms"] == pytest.approx([10, 10])
    assert found["encode_mpix_per_s"] == pytest.approx([0.02 / 0.02] * 2)
    assert False in codec.collecting
    assert gc.isenabled()


class Searching(Slow):
    """Needs 0.1 s to find out how to encode an image, which takes no time then."""

    def __init__(self, image: Image | None = None) -> None:
        super().__init__()
        self.image = image

    def prepared(self, image: Image) -> Searching:
        CLOCK.sleep(0.1)
        return Searching(image)

    def encode(self, image: Image, *, trace: Trace = NULL_TRACE) -> bytes:
        if self.image is None:
            self = self.prepared(image)
        assert np.array_equal(image, self.image)
        return image.tobytes()


def test_what_a_codec_searches_for_is_timed_apart_from_the_encoding(tmp_path: Path) -> None:
    images = [np.full((100, 200), value, np.uint8) for value in range(2)]
    measured = list(Timing.create(warmup=1).evaluate(Searching(), MemorySequence(images), context(tmp_path)))
    found = {name: [m.value for m in measured if m.metric == name] for name in ("encode_wall_ms", "prepare_wall_ms")}
    assert found["encode_wall_ms"] == [0, 0]
    assert found["prepare_wall_ms"] == pytest.approx([100, 100])
    assert all(m.value == 0 and m.reason is None for m in measured if m.metric == "prepare_cpu_ms")


def test_a_codec_without_a_search_has_no_preparation_time(tmp_path: Path) -> None:
    sequence = MemorySequence([np.zeros((100, 200), np.uint8)])
    measured = list(Timing.create(warmup=1).evaluate(Slow(), sequence, context(tmp_path)))
    preparing = [m for m in measured if m.metric.startswith("prepare_")]
    assert {m.metric for m in preparing} == {"prepare_wall_ms", "prepare_cpu_ms"}
    assert all(np.isnan(m.value) and "slow needs no search" in str(m.reason) for m in preparing)


def test_a_fast_call_is_repeated_until_the_clock_can_tell() -> None:
    calls = 0

    def call() -> None:
        nonlocal calls
        calls += 1
        CLOCK.sleep(0.001)

    _, taken = time_repeatedly(call, min_ms=20)
    assert calls == 1 + 20
    assert taken.wall_ms == pytest.approx(1.0)
    calls = 0
    _, taken = time_repeatedly(call, min_ms=1)
    assert (calls, taken.wall_ms) == (1, pytest.approx(1.0))
    calls = 0
    time_repeatedly(call, min_ms=0)
    assert calls == 1


def test_more_repeats_recompute_nothing() -> None:
    few, many = Timing.create(repeats=2), Timing.create(repeats=9)
    assert (few.repeats, many.repeats) == (2, 9)
    assert few.repeat_identity(1) == many.repeat_identity(1)
    assert few.repeat_identity(0) != Timing.create(frames=3).repeat_identity(0)
    assert Timing.exclusive


def test_a_short_sequence_is_used_whole(tmp_path: Path) -> None:
    sequence = MemorySequence([np.zeros((100, 200), np.uint8)])
    measured = list(Timing.create(frames=10, warmup=1).evaluate(Slow(), sequence, context(tmp_path)))
    assert {measurement.frame for measurement in measured} == {0}
    names = [measurement.metric for measurement in measured]
    assert names.count("encode_wall_ms") == 1
    assert set(names) == {metric.name for metric in Timing.metrics}


class SlowStream(StreamCodec[NoParams]):
    """Encoding sleeps 20 ms a picture, 50 ms at flush for the two that it held back; decoding sleeps 10 ms a packet."""

    name = "slow"
    version = "1"
    params_type = NoParams
    capabilities = Capabilities()

    def __init__(self) -> None:
        super().__init__(NoParams())
        self.sessions: list[SlowSession] = []

    def encoder(self, frame_rate_hz: float) -> StreamEncoder:
        assert frame_rate_hz == 10.0
        self.sessions.append(SlowSession())
        return self.sessions[-1]

    def decoder(self) -> StreamDecoder:
        return SlowPlayback()


class SlowSession(StreamEncoder):
    def __init__(self) -> None:
        self.seen: list[int] = []

    def push(self, image: Image, *, trace: Trace = NULL_TRACE) -> list[Packet]:
        CLOCK.sleep(0.02)
        self.seen.append(int(image[0, 0]))
        ready = len(self.seen) - 3
        return [Packet(b"x", ready, True)] if ready >= 0 else []

    def flush(self) -> list[Packet]:
        CLOCK.sleep(0.05)
        return [Packet(b"x", frame, True) for frame in range(max(0, len(self.seen) - 2), len(self.seen))]


class SlowPlayback(StreamDecoder):
    def push(self, packet: Packet | Loss, *, trace: Trace = NULL_TRACE) -> list[Picture]:
        CLOCK.sleep(0.01)
        return []

    def flush(self) -> list[Picture]:
        return []


def test_a_stream_is_timed_in_order_each_call_once(tmp_path: Path) -> None:
    sequence = MemorySequence([np.full((100, 200), value, np.uint8) for value in range(9)])
    codec = SlowStream()
    measured = list(Timing.create(frames=4, warmup=2).evaluate(codec, sequence, context(tmp_path)))
    assert [session.seen for session in codec.sessions] == [[0, 1], [0, 1, 2, 3]]
    found = {metric.name: [m.value for m in measured if m.metric == metric.name] for metric in Timing.metrics}
    assert [m.frame for m in measured if m.metric == "encode_wall_ms"] == [0, 1, 2, 3]
    assert found["encode_wall_ms"] == pytest.approx([20, 20, 45, 45])
    assert found["decode_wall_ms"] == pytest.approx([10] * 4)
    assert set(found["encode_cpu_ms"] + found["decode_cpu_ms"]) == {0}
    assert all(m.reason and "has memory" in m.reason for m in measured if m.metric.startswith("prepare"))
    assert len(found["yardstick_ms"]) == 4
