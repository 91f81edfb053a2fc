"""The `timing` evaluator measures how long one frame takes to encode and to decode, on one core.

The search that a codec makes on a frame before it can encode it (`Codec.prepared`) is timed apart from the encoding.
Reading frames, checks and garbage collection are not timed. A codec of another distribution is timed in the processes
in which it encodes and decodes. The first frame is coded before the first measurement, so that compilation, caches and
clocks have settled. A codec with memory, or a feature codec, is timed in order over the first frames, each call once.
One repeat is one cell. The engine interleaves the repeats of all settings, so that a slow phase of the machine does not
hit a single one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, Final

import cv2
from pydantic import Field

from codecbench.core.contracts.codec import AnyCodec
from codecbench.core.contracts.evaluator import CodecEvaluator, Context, Measurement
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.metric import Metric, Quantity
from codecbench.core.contracts.params import Params
from codecbench.core.contracts.sequence import FrameSequence
from codecbench.plugins.evaluators.sampling import evenly_spread
from codecbench.plugins.evaluators.timed_calls import (
    Duration,
    time_decoding,
    time_decoding_in_order,
    time_encoding,
    time_encoding_in_order,
    time_feature_encoding_in_order,
)

_AGGREGATES = ("median", "p95")
_YARDSTICK_MS = "yardstick_ms"
_QUANTITIES: Final[dict[str, Quantity]] = {"encode_wall_ms": "encoding", "decode_wall_ms": "decoding"}


class TimingParams(Params):
    """Set how many frames are timed, and how often.

    frames: how many frames, spread evenly over the sequence. repeats: cells per setting. warmup: untimed codings of the
    first frame, fewer if they take over 0.1 s. min_ms: faster calls are repeated for this long, and the mean counts.
    For inter-frame and feature codecs, `frames` and `warmup` are the first frames of the sequence.
    """

    frames: Annotated[int, Field(ge=1)] = 10
    repeats: Annotated[int, Field(ge=1)] = 5
    warmup: Annotated[int, Field(ge=1)] = 3
    min_ms: Annotated[float, Field(ge=0)] = 5.0


@dataclass(frozen=True)
class _Durations:
    """The durations of one frame; `preparing` is None if the codec has nothing to search for."""

    encoding: Duration
    decoding: Duration
    preparing: Duration | None
    yardstick: Duration


def _time_metric(name: str, summary: str, label: str, column_header: str = "", confirmed_by: str = "") -> Metric:
    """A time of one frame; a primary metric if it has a column header."""
    return Metric(
        name, "ms", "lower", summary, (*_AGGREGATES, "max"), False,
        role="time", headline=bool(column_header), label=label, column_header=column_header, scale="log",
        confirmed_by=confirmed_by, in_units_of=_YARDSTICK_MS, quantity=_QUANTITIES.get(name, ""),
    )  # fmt: skip


def _pace_metric(name: str, summary: str, label: str, confirmed_by: str) -> Metric:
    """Megapixels per second."""
    return Metric(
        name, "Mpx/s", "higher", summary, _AGGREGATES, False,
        role="time", label=label, scale="log", confirmed_by=confirmed_by, in_units_of=_YARDSTICK_MS,
    )  # fmt: skip


class Timing(CodecEvaluator[TimingParams]):
    """Encode and decode time per frame."""

    name = "timing"
    version = "3"
    bits = (8, 16)
    params_type = TimingParams
    exclusive = True
    metrics: ClassVar[tuple[Metric, ...]] = (
        _time_metric(
            "encode_cpu_ms", "processor time, image to bitstream, all threads",
            "encoding processor time", "enc CPU ms",
        ),
        _time_metric(
            "decode_cpu_ms", "processor time, bitstream to image, all threads",
            "decoding processor time", "dec CPU ms",
        ),
        _time_metric("encode_wall_ms", "elapsed time, image to bitstream", "encoding time", "", "encode_cpu_ms"),
        _time_metric("decode_wall_ms", "elapsed time, bitstream to image", "decoding time", "", "decode_cpu_ms"),
        _pace_metric("encode_mpix_per_s", "pixels over elapsed encoding time", "encoding throughput", "encode_cpu_ms"),
        _pace_metric("decode_mpix_per_s", "pixels over elapsed decoding time", "decoding throughput", "decode_cpu_ms"),
        _time_metric(
            "prepare_wall_ms", "elapsed time of the search before encoding",
            "preparation time", "", "prepare_cpu_ms",
        ),
        _time_metric("prepare_cpu_ms", "processor time of the search before encoding", "preparation processor time"),
        Metric(
            _YARDSTICK_MS, "ms", "neither", "time of a fixed task after each frame, to compare machines",
            ("median",), False, label="yardstick",
        ),
    )  # fmt: skip

    @property
    def repeats(self) -> int:
        return self.params.repeats

    def repeat_identity(self, repeat: int) -> dict[str, Any]:
        """All parameters except `repeats`, so that more repeats recompute nothing."""
        return self.params.model_dump(mode="json", exclude={"repeats"})

    def evaluate(self, codec: AnyCodec[Any], sequence: FrameSequence, context: Context) -> Iterator[Measurement]:
        cv2.setNumThreads(1)
        if codec.carries == "features":
            yield from self._time_features(codec, sequence)
        elif codec.stateless:
            yield from self._time_frames(codec, sequence)
        else:
            yield from self._time_stream(codec, sequence)

    def _time_frames(self, codec: AnyCodec[Any], sequence: FrameSequence) -> Iterator[Measurement]:
        images = {index: sequence.read(index).image for index in evenly_spread(len(sequence), self.params.frames)}
        limits = self.params.warmup, self.params.min_ms
        coded = codec.at_encoder(time_encoding, images, *limits)
        decodings = codec.at_decoder(time_decoding, [bitstream for _, bitstream, *_ in coded], *limits)
        unprepared = f"{codec.name} needs no search at this setting"
        for (index, _, preparing, encoding, yardstick), decoding in zip(coded, decodings, strict=True):
            search = None if preparing is None else Duration(*preparing)
            durations = _Durations(Duration(*encoding), Duration(*decoding), search, Duration(*yardstick))
            yield from _frame_measurements(durations, images[index], index, unprepared)

    def _time_stream(self, codec: AnyCodec[Any], sequence: FrameSequence) -> Iterator[Measurement]:
        images = [sequence.read(index).image for index in range(min(len(sequence), self.params.frames))]
        packets, encoding, yardsticks = codec.at_encoder(
            time_encoding_in_order, sequence.frame_rate_hz, images, self.params.warmup
        )
        decoding = codec.at_decoder(time_decoding_in_order, packets, self.params.warmup)
        for index, image in enumerate(images):
            encode, decode, yardstick = (Duration(*times[index]) for times in (encoding, decoding, yardsticks))
            durations = _Durations(encode, decode, None, yardstick)
            yield from _frame_measurements(
                durations, image, index, f"{codec.name} has memory, so it prepares no single frame"
            )

    def _time_features(self, codec: AnyCodec[Any], sequence: FrameSequence) -> Iterator[Measurement]:
        """Encoding is all that the device does; extracting the features is a stage of it."""
        unprepared = f"{codec.name} sends features and needs no search"
        images = [sequence.read(index).image for index in range(min(len(sequence), self.params.frames))]
        packets, *times = codec.at_encoder(time_feature_encoding_in_order, images, self.params.warmup)
        times.append(codec.at_decoder(time_decoding_in_order, packets, self.params.warmup))
        for index, image in enumerate(images):
            extraction, coding, yardstick, decoding = (Duration(*part[index]) for part in times)
            durations = _Durations(extraction + coding, decoding, None, yardstick)
            yield from _frame_measurements(durations, image, index, unprepared)
            yield Measurement("encode_wall_ms", extraction.wall_ms, index, "encode/extract")
            yield Measurement("encode_cpu_ms", extraction.cpu_ms, index, "encode/extract")


def _direction_measurements(direction: str, duration: Duration, image: Image, index: int) -> Iterator[Measurement]:
    megapixels = image.shape[0] * image.shape[1] * 1e-6
    yield Measurement(f"{direction}_wall_ms", duration.wall_ms, index)
    yield Measurement(f"{direction}_cpu_ms", duration.cpu_ms, index)
    yield Measurement(f"{direction}_mpix_per_s", megapixels / (max(duration.wall_ms, 1e-9) * 1e-3), index)


def _frame_measurements(durations: _Durations, image: Image, index: int, unprepared: str) -> Iterator[Measurement]:
    """All metrics of one frame. unprepared: why nothing was prepared, if nothing was."""
    yield Measurement(_YARDSTICK_MS, durations.yardstick.wall_ms, index)
    yield from _direction_measurements("encode", durations.encoding, image, index)
    yield from _direction_measurements("decode", durations.decoding, image, index)
    preparing = durations.preparing
    reason = None if preparing else unprepared
    yield Measurement("prepare_wall_ms", preparing.wall_ms if preparing else math.nan, index, reason=reason)
    yield Measurement("prepare_cpu_ms", preparing.cpu_ms if preparing else math.nan, index, reason=reason)
