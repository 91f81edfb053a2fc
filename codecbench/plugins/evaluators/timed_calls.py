"""Timing of calls, and of a codec's calls in the process in which it encodes or decodes, which has the frames already.

Times are (wall, processor) in milliseconds. The calls of a codec with memory, or of a feature codec, depend on earlier
ones, so each is made once and in order.
"""

from __future__ import annotations

import gc
import math
import time
import zlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from time import monotonic
from typing import Any, Final, TypeAlias, TypeVar

from codecbench.core.contracts.codec import AnyCodec, Decoded, FeatureCodec
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.stream import Packet

_T = TypeVar("_T")
_MAX_LOOPS: Final = 1000
_YARDSTICK: Final = bytes((index * index >> 5) & 255 for index in range(1 << 16))


@dataclass(frozen=True)
class Duration:
    """Wall time and processor time of one call in this process, in milliseconds."""

    wall_ms: float
    cpu_ms: float

    def __add__(self, other: Duration) -> Duration:
        return Duration(self.wall_ms + other.wall_ms, self.cpu_ms + other.cpu_ms)


def yardstick() -> Duration:
    """Time to deflate a fixed 64 KiB.

    No codec changes this work, so runs on a machine that is busier or clocked lower can be compared in units of it.
    """
    return time_call(lambda: zlib.compress(_YARDSTICK, 6))[1]


def time_repeatedly(call: Callable[[], _T], min_ms: float) -> tuple[_T, Duration]:
    """The result and the time of a call; the time is a mean over enough calls to take `min_ms`, if one is faster."""
    value, first = time_call(call)
    if first.wall_ms >= min_ms:
        return value, first
    return time_call(call, min(_MAX_LOOPS, math.ceil(min_ms / max(first.wall_ms, 1e-6))))


def time_call(call: Callable[[], _T], loops: int = 1) -> tuple[_T, Duration]:
    """The result of the last of `loops` calls, and the mean time of one."""
    turns = range(loops - 1)
    cpu_start_ns, wall_start_ns = time.process_time_ns(), time.perf_counter_ns()
    for _ in turns:
        call()
    value = call()
    wall_end_ns, cpu_end_ns = time.perf_counter_ns(), time.process_time_ns()
    return value, Duration((wall_end_ns - wall_start_ns) / loops * 1e-6, (cpu_end_ns - cpu_start_ns) / loops * 1e-6)


@contextmanager
def without_collection() -> Iterator[None]:
    """Collect garbage now, and not inside the block."""
    enabled = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


_Part = TypeVar("_Part", Packet, Decoded)
Time: TypeAlias = tuple[float, float]
_WARM_UP_S: Final = 0.1
"""A codec that takes longer needs one warm-up only: loading and compiling are a small part of that."""


def time_encoding(
    codec: AnyCodec[Any], images: dict[int, Image], warmup: int, least_ms: float
) -> list[tuple[int, bytes, Time | None, Time, Time]]:
    """For each frame its index, its bitstream, and the times of preparing, encoding and the yardstick.

    Preparing is None if there is nothing to prepare. warmup: how often the first frame is coded before, less often if
    that takes long. least_ms: faster calls are repeated for this long, and their time is the mean.
    """
    first = next(iter(images.values()))
    _warm(warmup, lambda: codec.encode(first))
    timings = []
    with without_collection():
        for index, image in images.items():
            prepared, preparing = time_repeatedly(partial(codec.prepared, image), least_ms)
            bitstream, encoding = time_repeatedly(partial(prepared.encode, image), least_ms)
            search = None if prepared is codec else _as_pair(preparing)
            timings.append((index, bitstream, search, _as_pair(encoding), _as_pair(yardstick())))
    return timings


def time_decoding(codec: AnyCodec[Any], bitstreams: list[bytes], warmup: int, least_ms: float) -> list[Time]:
    """The time to decode each bitstream."""
    _warm(warmup, lambda: codec.decode(bitstreams[0]))
    with without_collection():
        return [_as_pair(time_repeatedly(partial(codec.decode, bitstream), least_ms)[1]) for bitstream in bitstreams]


def time_encoding_in_order(
    codec: AnyCodec[Any], frame_rate_hz: float, images: list[Image], warmup: int
) -> tuple[list[Packet], list[Time], list[Time]]:
    """The packets of these images, and for each image the times of encoding and of the yardstick."""

    def session(frames: list[Image], after_each: Callable[[], object]) -> tuple[list[Packet], dict[int, Duration]]:
        encoder = codec.open_encoder(frame_rate_hz)
        calls = ((frame, partial(encoder.push, image)) for frame, image in enumerate(frames))
        return _time_session(calls, encoder.flush, after_each)

    session(images[:warmup], lambda: None)
    yardsticks: list[Time] = []
    with without_collection():
        packets, durations = session(images, lambda: yardsticks.append(_as_pair(yardstick())))
    return packets, [_as_pair(durations[frame]) for frame in range(len(images))], yardsticks


def time_decoding_in_order(codec: AnyCodec[Any], packets: list[Packet], warmup: int) -> list[Time]:
    """The decoding time of each frame, by frame index. warmup: how many packets are decoded before, not timed."""

    def session(sent: list[Packet], flush: Callable[[Any], Callable[[], Any]]) -> dict[int, Duration]:
        decoder = codec.open_decoder()
        calls = ((packet.frame, partial(decoder.push, packet)) for packet in sent)
        return _time_session(calls, flush(decoder), lambda: None)[1]

    session(packets[:warmup], lambda _: list)
    with without_collection():
        durations = session(packets, _flush)
    return [_as_pair(durations[frame]) for frame in range(len(packets))]


def time_feature_encoding_in_order(
    codec: AnyCodec[Any], images: list[Image], warmup: int
) -> tuple[list[Packet], list[Time], list[Time], list[Time]]:
    """The packets of these images, and for each the times of extraction, encoding and the yardstick."""
    source: FeatureCodec[Any] = codec  # type: ignore[assignment]

    def session(frames: list[Image]) -> Iterator[tuple[Packet, Time, Time, Time]]:
        encoder = source.encoder()
        for image in frames:
            features, extraction = time_call(partial(source.extract, image))
            packet, coding = time_call(partial(encoder.push, features))
            yield packet, _as_pair(extraction), _as_pair(coding), _as_pair(yardstick())

    list(session(images[:warmup]))
    with without_collection():
        packets, extraction, coding, yardsticks = map(list, zip(*session(images), strict=True))
    return packets, extraction, coding, yardsticks


def _warm(codings: int, call: Callable[[], object]) -> None:
    end = monotonic() + _WARM_UP_S
    for _ in range(codings):
        call()
        if monotonic() > end:
            break


def _flush(decoder: Any) -> Callable[[], Any]:
    return getattr(decoder, "flush", list)  # type: ignore[no-any-return]


def _as_pair(duration: Duration) -> Time:
    return duration.wall_ms, duration.cpu_ms


def _time_session(
    calls: Iterable[tuple[int, Callable[[], Sequence[_Part]]]],
    flush: Callable[[], Sequence[_Part]],
    after_each: Callable[[], object],
) -> tuple[list[_Part], dict[int, Duration]]:
    """The packets or pictures of a session, and the time of each call by frame.

    The time of `flush` is shared equally by the frames that it returns.
    """
    output: list[_Part] = []
    times: dict[int, Duration] = {}
    for frame, call in calls:
        parts, times[frame] = time_call(call)
        output.extend(parts)
        after_each()
    rest, last = time_call(flush)
    for part in rest:
        before = times[part.frame]
        times[part.frame] = Duration(before.wall_ms + last.wall_ms / len(rest), before.cpu_ms + last.cpu_ms / len(rest))
    return output + list(rest), times
