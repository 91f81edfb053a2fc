"""The `timing` evaluator: how long one frame takes to encode and to decode, on one core.

What a codec searches for on each frame before it can encode it (`Codec.prepared`) is timed apart from the encoding.
Reading frames, checks and garbage collection are outside what is timed; a codec of another distribution is timed in the
processes in which it encodes and decodes. The first frame is coded before the first measurement, so that compilation,
caches and clocks have settled; a codec with memory or of features is timed in order over the first frames instead, each
call once. One repeat is one cell; the engine interleaves the repeats of all settings, so that a slow spell of the
machine hits none of them alone.
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
    decoded_in_order,
    encoded_in_order,
    features_encoded_in_order,
    times_of_decoding,
    times_of_encoding,
)

_AGGREGATES = ("median", "p95")
_YARDSTICK_MS = "yardstick_ms"
_NEEDS: Final[dict[str, Quantity]] = {"encode_wall_ms": "encoding", "decode_wall_ms": "decoding"}


class TimingParams(Params):
    """`frames`: how many, spread evenly over the sequence. `repeats`: cells for each setting. `warmup`: codings of
    the first frame that are not timed, fewer where they take over 0.1 s. `min_ms`: calls that are faster are
    repeated until this much has passed, and share it. With a codec that has memory or is of features, `frames` and
    `warmup` are the first frames of the sequence.
    """

    frames: Annotated[int, Field(ge=1)] = 10
    repeats: Annotated[int, Field(ge=1)] = 5
    warmup: Annotated[int, Field(ge=1)] = 3
    min_ms: Annotated[float, Field(ge=0)] = 5.0


@dataclass(frozen=True)
class _Durations:
    """What was timed of one frame; nothing was prepared where the codec has nothing to find."""

    encoding: Duration
    decoding: Duration
    preparing: Duration | None
    yardstick: Duration


def _time(name: str, summary: str, label: str, column_header: str = "", confirmed_by: str = "") -> Metric:
    """A time of one frame; a headline where it has a column_header name."""
    return Metric(
        name, "ms", "lower", summary, (*_AGGREGATES, "max"), False,
        role="time", headline=bool(column_header), label=label, column_header=column_header, scale="log",
        confirmed_by=confirmed_by, in_units_of=_YARDSTICK_MS, quantity=_NEEDS.get(name, ""),
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
    version = "3"
    params_type = TimingParams
    exclusive = True
    metrics: ClassVar[tuple[Metric, ...]] = (
        _time(
            "encode_cpu_ms", "processor time, image to bitstream, all threads",
            "encoding processor time", "enc CPU ms",
        ),
        _time(
            "decode_cpu_ms", "processor time, bitstream to image, all threads",
            "decoding processor time", "dec CPU ms",
        ),
        _time("encode_wall_ms", "elapsed time, image to bitstream", "encoding time", "", "encode_cpu_ms"),
        _time("decode_wall_ms", "elapsed time, bitstream to image", "decoding time", "", "decode_cpu_ms"),
        _pace("encode_mpix_per_s", "pixels over elapsed encoding time", "encoding pace", "encode_cpu_ms"),
        _pace("decode_mpix_per_s", "pixels over elapsed decoding time", "decoding pace", "decode_cpu_ms"),
        _time(
            "prepare_wall_ms", "elapsed time of the search before encoding",
            "preparation time", "", "prepare_cpu_ms",
        ),
        _time("prepare_cpu_ms", "processor time of the search before encoding", "preparation processor time"),
        Metric(
            _YARDSTICK_MS, "ms", "neither", "fixed work timed beside each frame, to compare machines",
            ("median",), False, label="yardstick",
        ),
    )  # fmt: skip

    @property
    def repeats(self) -> int:
        return self.params.repeats

    def repeat_identity(self, repeat: int) -> dict[str, Any]:
        """All parameters but `repeats`: more of them recompute nothing."""
        return self.params.model_dump(mode="json", exclude={"repeats"})

    def evaluate(self, codec: AnyCodec[Any], sequence: FrameSequence, context: Context) -> Iterator[Measurement]:
        cv2.setNumThreads(1)
        if codec.carries == "features":
            yield from self._of_features(codec, sequence)
        elif codec.stateless:
            yield from self._alone(codec, sequence)
        else:
            yield from self._in_order(codec, sequence)

    def _alone(self, codec: AnyCodec[Any], sequence: FrameSequence) -> Iterator[Measurement]:
        images = {index: sequence.read(index).image for index in evenly_spread(len(sequence), self.params.frames)}
        limits = self.params.warmup, self.params.min_ms
        coded = codec.at_encoder(times_of_encoding, images, *limits)
        decodings = codec.at_decoder(times_of_decoding, [bitstream for _, bitstream, *_ in coded], *limits)
        unprepared = f"{codec.name} searches for nothing with this setting"
        for (index, _, preparing, encoding, beside), decoding in zip(coded, decodings, strict=True):
            searched = None if preparing is None else Duration(*preparing)
            durations = _Durations(Duration(*encoding), Duration(*decoding), searched, Duration(*beside))
            yield from _measured(durations, images[index], index, unprepared)

    def _in_order(self, codec: AnyCodec[Any], sequence: FrameSequence) -> Iterator[Measurement]:
        images = [sequence.read(index).image for index in range(min(len(sequence), self.params.frames))]
        packets, encoding, yardsticks = codec.at_encoder(
            encoded_in_order, sequence.frame_rate_hz, images, self.params.warmup
        )
        decoding = codec.at_decoder(decoded_in_order, packets, self.params.warmup)
        for index, image in enumerate(images):
            coded, decoded, beside = (Duration(*part[index]) for part in (encoding, decoding, yardsticks))
            durations = _Durations(coded, decoded, None, beside)
            yield from _measured(durations, image, index, f"{codec.name} has memory and prepares no frame alone")

    def _of_features(self, codec: AnyCodec[Any], sequence: FrameSequence) -> Iterator[Measurement]:
        """Encoding is all that the device does; what finding the features takes of it is a stage."""
        unprepared = f"{codec.name} finds features, and searches for nothing else"
        images = [sequence.read(index).image for index in range(min(len(sequence), self.params.frames))]
        packets, *times = codec.at_encoder(features_encoded_in_order, images, self.params.warmup)
        times.append(codec.at_decoder(decoded_in_order, packets, self.params.warmup))
        for index, image in enumerate(images):
            finding, coding, beside, decoding = (Duration(*part[index]) for part in times)
            durations = _Durations(finding + coding, decoding, None, beside)
            yield from _measured(durations, image, index, unprepared)
            yield Measurement("encode_wall_ms", finding.wall_ms, index, "encode/extract")
            yield Measurement("encode_cpu_ms", finding.cpu_ms, index, "encode/extract")


def _measurements(direction: str, taken: Duration, image: Image, index: int) -> Iterator[Measurement]:
    megapixels = image.shape[0] * image.shape[1] * 1e-6
    yield Measurement(f"{direction}_wall_ms", taken.wall_ms, index)
    yield Measurement(f"{direction}_cpu_ms", taken.cpu_ms, index)
    yield Measurement(f"{direction}_mpix_per_s", megapixels / (max(taken.wall_ms, 1e-9) * 1e-3), index)


def _measured(durations: _Durations, image: Image, index: int, unprepared: str) -> Iterator[Measurement]:
    """All metrics of one frame. unprepared: the reason why nothing was prepared, where that is so."""
    yield Measurement(_YARDSTICK_MS, durations.yardstick.wall_ms, index)
    yield from _measurements("encode", durations.encoding, image, index)
    yield from _measurements("decode", durations.decoding, image, index)
    preparing = durations.preparing
    reason = None if preparing else unprepared
    yield Measurement("prepare_wall_ms", preparing.wall_ms if preparing else math.nan, index, reason=reason)
    yield Measurement("prepare_cpu_ms", preparing.cpu_ms if preparing else math.nan, index, reason=reason)
