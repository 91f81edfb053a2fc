"""The `timing` evaluator: how long one frame takes to encode and to decode, on one core.

What a codec searches for on each frame before it can encode it (`Codec.prepared`) is timed apart from the encoding.
Reading frames, checks and garbage collection are outside what is timed. Every frame is coded a few times
before the first measurement, so that compilation, caches and clocks have settled. One repeat is one cell;
the engine interleaves the repeats of all settings, so that a slow spell of the machine hits none of them alone.
"""

from __future__ import annotations

import gc
import math
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import cv2
from pydantic import Field

from codecbench.core.contracts.codec import Codec
from codecbench.core.contracts.evaluator import CodecEvaluator, Context, Measurement
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.metric import Metric
from codecbench.core.contracts.params import Params
from codecbench.core.contracts.sequence import Sequence
from codecbench.plugins.evaluators.sampling import evenly_spread

_MAX_LOOPS = 1000
_YARDSTICK = bytes((index * index >> 5) & 255 for index in range(1 << 16))
_AGGREGATES = ("median", "p95")
_YARDSTICK_MS = "yardstick_ms"


class TimingParams(Params):
    """`frames`: how many, spread evenly over the sequence. `repeats`: cells for each setting. `warmup`: codings of
    the first frame that are not timed. `min_ms`: calls that are faster are repeated until this much has passed,
    and share it.
    """

    frames: Annotated[int, Field(ge=1)] = 10
    repeats: Annotated[int, Field(ge=1)] = 5
    warmup: Annotated[int, Field(ge=1)] = 3
    min_ms: Annotated[float, Field(ge=0)] = 5.0


@dataclass(frozen=True)
class Duration:
    """What one call takes, in milliseconds: by the clock on the wall and of this process's processor time."""

    wall_ms: float
    cpu_ms: float


@dataclass(frozen=True)
class _Durations:
    """What was timed of one frame; nothing was prepared where the codec has nothing to find."""

    encoding: Duration
    decoding: Duration
    preparing: Duration | None
    yardstick: Duration


def _time(name: str, summary: str, label: str, brief: str = "", confirmed_by: str = "") -> Metric:
    """A time of one frame; a headline where it has a brief name."""
    return Metric(
        name, "ms", "lower", summary, _AGGREGATES, False,
        role="time", headline=bool(brief), label=label, brief=brief, scale="log",
        confirmed_by=confirmed_by, in_units_of=_YARDSTICK_MS,
    )  # fmt: skip


def _pace(name: str, summary: str, label: str, confirmed_by: str) -> Metric:
    """Megapixels a second."""
    return Metric(
        name, "Mpx/s", "higher", summary, _AGGREGATES, False,
        role="time", label=label, scale="log", confirmed_by=confirmed_by, in_units_of=_YARDSTICK_MS,
    )  # fmt: skip


class Timing(CodecEvaluator[TimingParams]):
    """Encode and decode time per frame."""

    name = "timing"
    version = "2"
    params_type = TimingParams
    exclusive = True
    metrics: ClassVar[tuple[Metric, ...]] = (
        _time("encode_wall_ms", "time from image to bitstream", "encoding time", "enc ms", "encode_cpu_ms"),
        _time("decode_wall_ms", "time from bitstream to image", "decoding time", "dec ms", "decode_cpu_ms"),
        _time("encode_cpu_ms", "processor time from image to bitstream", "encoding processor time"),
        _time("decode_cpu_ms", "processor time from bitstream to image", "decoding processor time"),
        _pace("encode_mpix_per_s", "megapixels encoded a second", "encoding pace", "encode_cpu_ms"),
        _pace("decode_mpix_per_s", "megapixels decoded a second", "decoding pace", "decode_cpu_ms"),
        _time("prepare_wall_ms", "time to find what depends on the frame", "preparation time", "", "prepare_cpu_ms"),
        _time("prepare_cpu_ms", "processor time to find it", "preparation processor time"),
        Metric(
            _YARDSTICK_MS, "ms", "neither", "a fixed piece of work, timed beside each frame", ("median",), False,
            label="yardstick",
        ),
    )  # fmt: skip

    @property
    def repeats(self) -> int:
        return self.params.repeats

    def repeat_identity(self, repeat: int) -> dict[str, Any]:
        """All parameters but `repeats`: more of them recompute nothing."""
        return self.params.model_dump(mode="json", exclude={"repeats"})

    def evaluate(self, codec: Codec[Any], sequence: Sequence, context: Context) -> Iterator[Measurement]:
        cv2.setNumThreads(1)
        images = {index: sequence.read(index).image for index in evenly_spread(len(sequence), self.params.frames)}
        for index in list(images)[:1]:
            for _ in range(self.params.warmup):
                codec.decode(codec.encode(images[index]))
        with _no_collection():
            taken = {index: self._durations(codec, image) for index, image in images.items()}
        for index, durations in taken.items():
            yield Measurement(_YARDSTICK_MS, durations.yardstick.wall_ms, index)
            yield from _measurements("encode", durations.encoding, images[index], index)
            yield from _measurements("decode", durations.decoding, images[index], index)
            preparing = durations.preparing
            reason = None if preparing else f"{codec.name} searches for nothing with this setting"
            yield Measurement("prepare_wall_ms", preparing.wall_ms if preparing else math.nan, index, reason=reason)
            yield Measurement("prepare_cpu_ms", preparing.cpu_ms if preparing else math.nan, index, reason=reason)

    def _durations(self, codec: Codec[Any], image: Image) -> _Durations:
        prepared = codec.prepared(image)
        bitstream = prepared.encode(image)
        encoding = duration(lambda: prepared.encode(image), self.params.min_ms)
        codec.decode(bitstream)
        decoding = duration(lambda: codec.decode(bitstream), self.params.min_ms)
        searches = prepared is not codec
        preparing = duration(lambda: codec.prepared(image), self.params.min_ms) if searches else None
        return _Durations(encoding, decoding, preparing, yardstick())


def yardstick() -> Duration:
    """Time of deflating a fixed 64 KiB: work that no codec changes, so that runs at different times, on a machine
    that is busier or clocked lower, can be compared in units of it."""
    return duration(lambda: zlib.compress(_YARDSTICK, 6), 0.0)


def duration(call: Callable[[], object], min_ms: float) -> Duration:
    """Time of one call: of a single one if it takes `min_ms`, else the mean over as many as take that long."""
    first = _timed(call, 1)
    if first.wall_ms >= min_ms:
        return first
    loops = min(_MAX_LOOPS, math.ceil(min_ms / max(first.wall_ms, 1e-6)))
    return _timed(call, loops)


def _timed(call: Callable[[], object], loops: int) -> Duration:
    turns = range(loops)
    cpu_start_ns, wall_start_ns = time.process_time_ns(), time.perf_counter_ns()
    for _ in turns:
        call()
    wall_end_ns, cpu_end_ns = time.perf_counter_ns(), time.process_time_ns()
    return Duration((wall_end_ns - wall_start_ns) / loops * 1e-6, (cpu_end_ns - cpu_start_ns) / loops * 1e-6)


@contextmanager
def _no_collection() -> Iterator[None]:
    enabled = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def _measurements(direction: str, taken: Duration, image: Image, index: int) -> Iterator[Measurement]:
    megapixels = image.shape[0] * image.shape[1] * 1e-6
    yield Measurement(f"{direction}_wall_ms", taken.wall_ms, index)
    yield Measurement(f"{direction}_cpu_ms", taken.cpu_ms, index)
    yield Measurement(f"{direction}_mpix_per_s", megapixels / (max(taken.wall_ms, 1e-9) * 1e-3), index)
