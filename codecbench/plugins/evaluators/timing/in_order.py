"""Timing codecs with memory and of features: calls have a past, so that each is made once, in order, and not again."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any, TypeVar

from codecbench.core.contracts.codec import AnyCodec, Decoded, FeatureCodec
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.stream import Packet
from codecbench.plugins.evaluators.timing.clock import Duration, timed

_Made = TypeVar("_Made", Packet, Decoded)


def times_in_order(
    codec: AnyCodec[Any], frame_rate_hz: float, images: list[Image], beside: Callable[[], object]
) -> tuple[list[Duration], list[Duration]]:
    """What each of these frames, the first of a sequence, takes to encode and to decode.

    beside: is called after each frame was encoded, and not timed.
    """
    encoder, decoder = codec.open_encoder(frame_rate_hz), codec.open_decoder()
    pushed = ((frame, partial(encoder.push, image)) for frame, image in enumerate(images))
    packets, encoding = _timed_session(pushed, encoder.flush, beside)
    fed = ((packet.frame, partial(decoder.push, packet)) for packet in packets)
    _, decoding = _timed_session(fed, decoder.flush, lambda: None)
    return [encoding[frame] for frame in range(len(images))], [decoding[frame] for frame in range(len(images))]


def feature_times_in_order(
    codec: FeatureCodec[Any], images: list[Image], beside: Callable[[], object]
) -> tuple[list[Duration], list[Duration], list[Duration]]:
    """What these frames take: to extract their features, to encode these, and to decode them; `beside` as above."""
    encoder, decoder = codec.encoder(), codec.decoder()
    times: tuple[list[Duration], list[Duration], list[Duration]] = ([], [], [])
    for image in images:
        features, extracting = timed(partial(codec.extract, image))
        packet, coding = timed(partial(encoder.push, features))
        _, decoding = timed(partial(decoder.push, packet))
        for direction, taken in zip(times, (extracting, coding, decoding), strict=True):
            direction.append(taken)
        beside()
    return times


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
