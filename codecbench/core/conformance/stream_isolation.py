"""Checks across sessions, threads and processes: all state is in the session, and all that is sent in the packets."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import zip_longest
from typing import Any

from codecbench.core.conformance.failure import ConformanceFailure, NotClaimed
from codecbench.core.conformance.moving_pictures import FRAME_RATE_HZ, MovingPictures
from codecbench.core.conformance.round_trip import require_equal
from codecbench.core.conformance.sandbox import Verb, sandbox
from codecbench.core.conformance.stream_round_trip import (
    StreamClass,
    packets_of,
    pictures_of,
    require_same_packets,
    whole_images,
)
from codecbench.core.conformance.variations import other_settings
from codecbench.core.contracts.codec import StreamCodec
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.params import Params
from codecbench.core.contracts.stream import Packet, Picture

_TIMEOUT_S = 120.0
_MEMORY_MB = 2048
_THREADS = 4


def sessions_repeat(codec_class: StreamClass, params: Params, sequences: Sequence[MovingPictures]) -> None:
    """The same instance again, and another one, after other sequences."""
    codec = codec_class(params)
    first = [packets_of(codec, sequence.pictures) for sequence in sequences]
    for sequence, packets in zip(reversed(sequences), reversed(first), strict=True):
        require_same_packets(f"{sequence.name} again", packets_of(codec, sequence.pictures), packets)
        again = packets_of(codec_class(params), sequence.pictures)
        require_same_packets(f"{sequence.name} by a new instance", again, packets)
        _require_same_pictures(f"{sequence.name} again", pictures_of(codec, packets), pictures_of(codec, packets))


def sessions_do_not_interfere(codec_class: StreamClass, params: Params, sequences: Sequence[MovingPictures]) -> None:
    """Two sequences at once, picture by picture in turn, give what each gives alone."""
    codec = codec_class(params)
    alone = [packets_of(codec, sequence.pictures) for sequence in sequences]
    encoders = [codec.encoder(FRAME_RATE_HZ) for _ in sequences]
    together: list[list[Packet]] = [[] for _ in sequences]
    for pictures in zip(*(sequence.pictures for sequence in sequences), strict=True):
        for encoder, picture, packets in zip(encoders, pictures, together, strict=True):
            packets += encoder.push(picture)
    for encoder, packets in zip(encoders, together, strict=True):
        packets += encoder.flush()
    for sequence, got, expected in zip(sequences, together, alone, strict=True):
        require_same_packets(f"{sequence.name} beside another session", got, expected)
    shown = _decoded_together(codec, alone)
    for sequence, seen, packets in zip(sequences, shown, alone, strict=True):
        where = f"decoding {sequence.name} beside another session"
        _require_same_pictures(where, seen, pictures_of(codec, packets))


def _decoded_together(codec: StreamCodec[Any], streams: Sequence[Sequence[Packet]]) -> list[list[Picture]]:
    decoders = [codec.decoder() for _ in streams]
    shown: list[list[Picture]] = [[] for _ in streams]
    for packets in zip_longest(*streams):
        for decoder, packet, pictures in zip(decoders, packets, shown, strict=True):
            pictures += [] if packet is None else decoder.push(packet)
    for decoder, pictures in zip(decoders, shown, strict=True):
        pictures += decoder.flush()
    return shown


def _require_same_pictures(where: str, got: Sequence[Picture], expected: Sequence[Picture]) -> None:
    images, others = whole_images(where, got), whole_images(where, expected)
    if images.keys() != others.keys():
        raise ConformanceFailure(where, f"the frames {sorted(images)}", f"{sorted(others)}")
    for frame, image in images.items():
        require_equal(f"{where}, frame {frame}", image, others[frame])


def another_process_encodes_alike(
    codec_class: StreamClass, params: Params, sequences: Sequence[MovingPictures]
) -> None:
    for sequence in sequences:
        where = f"encoding {sequence.name} in another process"
        packets = _elsewhere("encode", where, _encoded, codec_class, params, sequence.pictures)
        require_same_packets(where, packets, packets_of(codec_class(params), sequence.pictures))


def packets_alone_decode(codec_class: StreamClass, params: Params, sequences: Sequence[MovingPictures]) -> None:
    """Decode copies of the packets where nothing was encoded, by instances of other settings."""
    settings = [params, *other_settings(params)]
    for sequence in sequences:
        codec = codec_class(params)
        packets = packets_of(codec, sequence.pictures)
        copies = [replace(packet, data=bytes(bytearray(packet.data))) for packet in packets]
        expected = pictures_of(codec, packets)
        for other in settings:
            where = f"decoding {sequence.name} in another process, by the setting {other}"
            _require_same_pictures(where, _elsewhere("decode", where, _decoded, codec_class, other, copies), expected)


def _elsewhere(verb: Verb, where: str, function: Any, codec_class: StreamClass, params: Params, argument: Any) -> Any:
    """What the codec does in another process. Fails where it does not."""
    place = sandbox(verb)
    reply = place.call(function, codec_class, params, argument, timeout_s=_TIMEOUT_S, memory_mb=_MEMORY_MB)
    if reply.status != "done":
        raise ConformanceFailure(where, f"{reply.status}: {reply.reason}", "what this process gets")
    return reply.value


def _encoded(codec_class: StreamClass, params: Params, pictures: Sequence[Image]) -> list[Packet]:
    return packets_of(codec_class(params), pictures)


def _decoded(codec_class: StreamClass, params: Params, packets: Sequence[Packet]) -> list[Picture]:
    return pictures_of(codec_class(params), packets)


def threads_do_not_interfere(codec_class: StreamClass, params: Params, sequences: Sequence[MovingPictures]) -> None:
    """Sessions of one instance in several threads at once give what they give alone."""
    if not codec_class.capabilities.thread_safe:
        raise NotClaimed("this codec does not claim to be thread-safe")
    codec = codec_class(params)
    alone = [(sequence, packets_of(codec, sequence.pictures)) for sequence in sequences]

    def work(offset: int) -> None:
        sequence, packets = alone[offset % len(alone)]
        where = f"{sequence.name} in one of {_THREADS} threads"
        require_same_packets(where, packets_of(codec, sequence.pictures), packets)
        whole_images(where, pictures_of(codec, packets))

    with ThreadPoolExecutor(_THREADS) as pool:
        for future in [pool.submit(work, offset) for offset in range(_THREADS)]:
            future.result()
