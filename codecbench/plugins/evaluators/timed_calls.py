"""What is timed of a codec, in the process in which it encodes or decodes: frames are handed over before.

Times are (wall, processor) in milliseconds. A codec with memory, or of features, has calls with a past, so that each is
made once, in order, and not again.
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
    """What one call takes, in milliseconds: by the clock on the wall and of this process's processor time."""

    wall_ms: float
    cpu_ms: float

    def __add__(self, other: Duration) -> Duration:
        return Duration(self.wall_ms + other.wall_ms, self.cpu_ms + other.cpu_ms)


def yardstick() -> Duration:
    """Time of deflating a fixed 64 KiB: work that no codec changes, so that runs at different times, on a machine
    that is busier or clocked lower, can be compared in units of it."""
    return timed(lambda: zlib.compress(_YARDSTICK, 6))[1]


def repeated(call: Callable[[], _T], min_ms: float) -> tuple[_T, Duration]:
    """What a call returns, and its time: of this single call if it takes `min_ms`, else the mean over as many more as
    take that long."""
    value, first = timed(call)
    if first.wall_ms >= min_ms:
        return value, first
    return timed(call, min(_MAX_LOOPS, math.ceil(min_ms / max(first.wall_ms, 1e-6))))


def timed(call: Callable[[], _T], loops: int = 1) -> tuple[_T, Duration]:
    """What the last of `loops` calls returns, and the mean time of one."""
    turns = range(loops - 1)
    cpu_start_ns, wall_start_ns = time.process_time_ns(), time.perf_counter_ns()
    for _ in turns:
        call()
    value = call()
    wall_end_ns, cpu_end_ns = time.perf_counter_ns(), time.process_time_ns()
    return value, Duration((wall_end_ns - wall_start_ns) / loops * 1e-6, (cpu_end_ns - cpu_start_ns) / loops * 1e-6)


@contextmanager
def no_collection() -> Iterator[None]:
    """Collect garbage now and not meanwhile."""
    enabled = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


_Made = TypeVar("_Made", Packet, Decoded)
Time: TypeAlias = tuple[float, float]
_WARM_UP_S: Final = 0.1
"""A codec that takes longer has settled after one coding: what it loads and compiles is a small part of it."""


def times_of_encoding(
    codec: AnyCodec[Any], images: dict[int, Image], warmup: int, least_ms: float
) -> list[tuple[int, bytes, Time | None, Time, Time]]:
    """Of each frame its index, its bitstream, and what preparing, encoding and the yardstick take.

    Preparing is None where there is nothing to prepare. warmup: codings of the first frame before, fewer where they
    take long. least_ms: calls that are faster are repeated until this much has passed, and share it.
    """
    first = next(iter(images.values()))
    _warm(warmup, lambda: codec.encode(first))
    found = []
    with no_collection():
        for index, image in images.items():
            prepared, preparing = repeated(partial(codec.prepared, image), least_ms)
            bitstream, encoding = repeated(partial(prepared.encode, image), least_ms)
            searched = None if prepared is codec else _plain(preparing)
            found.append((index, bitstream, searched, _plain(encoding), _plain(yardstick())))
    return found


def times_of_decoding(codec: AnyCodec[Any], bitstreams: list[bytes], warmup: int, least_ms: float) -> list[Time]:
    """What decoding each of these takes."""
    _warm(warmup, lambda: codec.decode(bitstreams[0]))
    with no_collection():
        return [_plain(repeated(partial(codec.decode, bitstream), least_ms)[1]) for bitstream in bitstreams]


def encoded_in_order(
    codec: AnyCodec[Any], frame_rate_hz: float, images: list[Image], warmup: int
) -> tuple[list[Packet], list[Time], list[Time]]:
    """The packets of the first frames of a sequence, and what encoding and the yardstick take of each frame."""

    def session(frames: list[Image], beside: Callable[[], object]) -> tuple[list[Packet], dict[int, Duration]]:
        encoder = codec.open_encoder(frame_rate_hz)
        pushed = ((frame, partial(encoder.push, image)) for frame, image in enumerate(frames))
        return _timed_session(pushed, encoder.flush, beside)

    session(images[:warmup], lambda: None)
    yardsticks: list[Time] = []
    with no_collection():
        packets, taken = session(images, lambda: yardsticks.append(_plain(yardstick())))
    return packets, [_plain(taken[frame]) for frame in range(len(images))], yardsticks


def decoded_in_order(codec: AnyCodec[Any], packets: list[Packet], warmup: int) -> list[Time]:
    """What decoding takes of each frame, in order of frames. warmup: how many packets are decoded before, not timed."""

    def session(sent: list[Packet], flush: Callable[[Any], Callable[[], Any]]) -> dict[int, Duration]:
        decoder = codec.open_decoder()
        fed = ((packet.frame, partial(decoder.push, packet)) for packet in sent)
        return _timed_session(fed, flush(decoder), lambda: None)[1]

    session(packets[:warmup], lambda _: list)
    with no_collection():
        taken = session(packets, _flush)
    return [_plain(taken[frame]) for frame in range(len(packets))]


def features_encoded_in_order(
    codec: AnyCodec[Any], images: list[Image], warmup: int
) -> tuple[list[Packet], list[Time], list[Time], list[Time]]:
    """The packets of these frames, and what finding their features, encoding these and the yardstick take of each."""
    source: FeatureCodec[Any] = codec  # type: ignore[assignment]

    def session(frames: list[Image]) -> Iterator[tuple[Packet, Time, Time, Time]]:
        encoder = source.encoder()
        for image in frames:
            features, finding = timed(partial(source.extract, image))
            packet, coding = timed(partial(encoder.push, features))
            yield packet, _plain(finding), _plain(coding), _plain(yardstick())

    list(session(images[:warmup]))
    with no_collection():
        packets, finding, coding, beside = map(list, zip(*session(images), strict=True))
    return packets, finding, coding, beside


def _warm(codings: int, call: Callable[[], object]) -> None:
    end = monotonic() + _WARM_UP_S
    for _ in range(codings):
        call()
        if monotonic() > end:
            break


def _flush(decoder: Any) -> Callable[[], Any]:
    return getattr(decoder, "flush", list)  # type: ignore[no-any-return]


def _plain(taken: Duration) -> Time:
    return taken.wall_ms, taken.cpu_ms


def _timed_session(
    calls: Iterable[tuple[int, Callable[[], Sequence[_Made]]]],
    flush: Callable[[], Sequence[_Made]],
    beside: Callable[[], object],
) -> tuple[list[_Made], dict[int, Duration]]:
    """What a session made, and the time of each call by its frame; that of flush is shared by the frames it gives."""
    made: list[_Made] = []
    taken: dict[int, Duration] = {}
    for frame, call in calls:
        parts, taken[frame] = timed(call)
        made.extend(parts)
        beside()
    held, last = timed(flush)
    for part in held:
        before = taken[part.frame]
        taken[part.frame] = Duration(before.wall_ms + last.wall_ms / len(held), before.cpu_ms + last.cpu_ms / len(held))
    return made + list(held), taken
