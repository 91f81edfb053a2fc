"""Checks of sessions of features: nothing but their packets is shared, and what is lost or damaged is told.

Damaged packets are decoded in a process that may die of it, with caps of time and memory.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np

from codecbench.core.conformance.failure import ConformanceFailure, NotClaimed
from codecbench.core.conformance.feature_round_trip import (
    FeatureClass,
    decoded_of,
    packets_of,
    require_same_features,
    require_same_packets,
    sets_of,
    whole_sets,
)
from codecbench.core.conformance.moving_pictures import MovingPictures
from codecbench.core.conformance.robustness import BOMBED_BYTES, FOREIGN, HUGE, mutations
from codecbench.core.conformance.sandbox import Verb, sandbox
from codecbench.core.conformance.variations import other_settings
from codecbench.core.contracts.codec import FeatureCodec
from codecbench.core.contracts.errors import BitstreamError
from codecbench.core.contracts.features import Features, FeatureSet
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.params import Params
from codecbench.core.contracts.stream import LOST, Loss, Packet

_TIMEOUT_S = 120.0
_MEMORY_MB = 2048
_THREADS = 4
_MUTATIONS = 40
_CUTS = 20


def sessions_repeat(codec_class: FeatureClass, params: Params, sequences: Sequence[MovingPictures]) -> None:
    """The same instance again, and another one, after other sequences."""
    codec = codec_class(params)
    sets = [sets_of(codec, sequence.pictures) for sequence in sequences]
    first = [packets_of(codec, one) for one in sets]
    for sequence, one, packets in reversed(list(zip(sequences, sets, first, strict=True))):
        require_same_packets(f"{sequence.name} again", packets_of(codec, one), packets)
        require_same_packets(f"{sequence.name} by a new instance", packets_of(codec_class(params), one), packets)
        where = f"decoding {sequence.name} again"
        _require_same(where, decoded_of(codec, packets), whole_sets(where, decoded_of(codec, packets)))


def sessions_do_not_interfere(codec_class: FeatureClass, params: Params, sequences: Sequence[MovingPictures]) -> None:
    """Two sequences at once, set by set in turn, give what each gives alone."""
    codec = codec_class(params)
    sets = [sets_of(codec, sequence.pictures) for sequence in sequences]
    alone = [packets_of(codec, one) for one in sets]
    encoders, decoders = [codec.encoder() for _ in sets], [codec.decoder() for _ in sets]
    together: list[list[Packet]] = [[] for _ in sets]
    decoded: list[list[FeatureSet]] = [[] for _ in sets]
    for turn in zip(*sets, strict=True):
        for place, features in enumerate(turn):
            together[place].append(encoders[place].push(features))
            decoded[place].append(decoders[place].push(alone[place][len(decoded[place])]))
    for place, sequence in enumerate(sequences):
        where = f"{sequence.name} beside another session"
        require_same_packets(where, together[place], alone[place])
        _require_same(where, decoded[place], whole_sets(where, decoded_of(codec, alone[place])))


def another_process_encodes_alike(
    codec_class: FeatureClass, params: Params, sequences: Sequence[MovingPictures]
) -> None:
    codec = codec_class(params)
    for sequence in sequences:
        where = f"extracting and encoding {sequence.name} in another process"
        packets = _elsewhere("encode", where, _encoded, codec_class, params, sequence.pictures)
        require_same_packets(where, packets, packets_of(codec, sets_of(codec, sequence.pictures)))


def packets_alone_decode(codec_class: FeatureClass, params: Params, sequences: Sequence[MovingPictures]) -> None:
    """Decode copies of the packets where nothing was encoded, by instances of other settings."""
    codec = codec_class(params)
    for sequence in sequences:
        packets = packets_of(codec, sets_of(codec, sequence.pictures))
        copies = [Packet(bytes(bytearray(packet.data)), int(packet.frame), bool(packet.starts)) for packet in packets]
        expected = whole_sets(f"decoding {sequence.name}", decoded_of(codec, packets))
        for other in [params, *other_settings(params)]:
            where = f"decoding {sequence.name} in another process, by the setting {other}"
            _require_same(where, _elsewhere("decode", where, _decoded, codec_class, other, copies), expected)


def threads_do_not_interfere(codec_class: FeatureClass, params: Params, sequences: Sequence[MovingPictures]) -> None:
    """One instance in several threads at once gives what it gives alone."""
    if not codec_class.capabilities.thread_safe:
        raise NotClaimed("this codec does not claim to be thread-safe")
    codec = codec_class(params)
    alone = [(sequence, packets_of(codec, sets_of(codec, sequence.pictures))) for sequence in sequences]

    def work(offset: int) -> None:
        sequence, packets = alone[offset % len(alone)]
        where = f"{sequence.name} in one of {_THREADS} threads"
        require_same_packets(where, packets_of(codec, sets_of(codec, sequence.pictures)), packets)
        whole_sets(where, decoded_of(codec, packets))

    with ThreadPoolExecutor(_THREADS) as pool:
        for future in [pool.submit(work, offset) for offset in range(_THREADS)]:
            future.result()


def starts_are_starts(codec_class: FeatureClass, params: Params, sequences: Sequence[MovingPictures]) -> None:
    """A new decoder from each declared start on gives what the uninterrupted one gives."""
    codec = codec_class(params)
    for sequence in sequences:
        packets = packets_of(codec, sets_of(codec, sequence.pictures))
        expected = whole_sets(f"decoding {sequence.name}", decoded_of(codec, packets))
        for start in [index for index, packet in enumerate(packets) if packet.starts]:
            where = f"decoding {sequence.name} from packet {start} on"
            _require_same(where, decoded_of(codec, packets[start:]), expected[start:], start)


def losses_are_told(codec_class: FeatureClass, params: Params, sequences: Sequence[MovingPictures]) -> None:
    """Each packet is lost in turn, told and untold, alone and with the one behind it.

    A set that was lost, or depends on one, is missing; from the next start on all is as if nothing had been lost.
    """
    codec = codec_class(params)
    for sequence in sequences:
        packets = packets_of(codec, sets_of(codec, sequence.pictures))
        expected = whole_sets(f"decoding {sequence.name}", decoded_of(codec, packets))
        for lost in range(len(packets)):
            where, before, rest = f"decoding {sequence.name} without packet {lost}", packets[:lost], packets[lost + 1 :]
            _require_honesty(where, codec, [*before, LOST, *rest], packets, {lost}, expected)
            _require_honesty(f"{where}, untold", codec, [*before, *rest], packets, {lost}, expected)
            if rest:
                gap: list[Packet | Loss] = [*before, LOST, LOST, *rest[1:]]
                _require_honesty(f"{where} and the next", codec, gap, packets, {lost, lost + 1}, expected)


def _require_honesty(
    where: str,
    codec: FeatureCodec[Any],
    received: Sequence[Packet | Loss],
    packets: Sequence[Packet],
    lost: set[int],
    expected: Sequence[Features],
) -> None:
    """packets: all that were sent. lost: of these."""
    try:
        found = decoded_of(codec, received)
    except BitstreamError as error:
        raise ConformanceFailure(where, f"BitstreamError: {error}", "sets: no byte was damaged") from error
    frames = [frame for frame in range(len(packets)) if frame not in lost or any(got is LOST for got in received)]
    if [one.frame for one in found] != frames:
        raise ConformanceFailure(where, f"the frames {[one.frame for one in found]}", f"{frames}")
    mended = next((packet.frame for packet in packets[max(lost) :] if packet.starts and packet.frame not in lost), None)
    for one in found:
        place = f"{where}, frame {one.frame}"
        if one.features is not None:
            if one.frame in lost:
                raise ConformanceFailure(place, f"{len(one.features)} features", "None: its packet never came")
            require_same_features(place, one.features, expected[one.frame])
        elif one.frame < min(lost) or (mended is not None and one.frame >= mended):
            raise ConformanceFailure(place, "no features", "those that there are without the loss")


def foreign_bytes_are_refused(codec_class: FeatureClass, params: Params, sequences: Sequence[MovingPictures]) -> None:
    noise = np.random.default_rng(7).integers(0, 256, 3000, dtype=np.uint8).tobytes()
    foreign = [(f"push({name}) as a start", data) for name, data in {**FOREIGN, "noise": noise}.items()]
    _must_refuse(codec_class, params, [], foreign)


def damage_is_told(codec_class: FeatureClass, params: Params, sequences: Sequence[MovingPictures]) -> None:
    """Mutations and cuts of the first packet and of a later one raise BitstreamError: a set has no pixel that could
    show that something is wrong."""
    rng = np.random.default_rng(11)
    codec = codec_class(params)
    for sequence in sequences:
        packets = packets_of(codec, sets_of(codec, sequence.pictures))
        for index in (0, len(packets) // 2):
            data, name = packets[index].data, f"{sequence.name}, packet {index}"
            lengths = sorted({*np.linspace(0, len(data) - 1, _CUTS, dtype=int).tolist(), len(data) - 1})
            damaged = [
                *mutations(data, rng, _MUTATIONS, name),
                *((f"{name}, {length} of {len(data)} bytes", data[:length]) for length in lengths),
                (f"{name} with a byte added", data + b"\0"),
            ]
            _must_refuse(codec_class, params, packets[:index], [one for one in damaged if one[1] != data])


def huge_headers_are_survived(codec_class: FeatureClass, params: Params, sequences: Sequence[MovingPictures]) -> None:
    """Every place of the first packet's header in turn claims as much as it can, within the time and memory caps."""
    codec = codec_class(params)
    data = packets_of(codec, sets_of(codec, sequences[-1].pictures[:1]))[0].data
    bombs = [
        (f"{huge.hex()} at byte {place}", data[:place] + huge + data[place + len(huge) :])
        for place in range(min(BOMBED_BYTES, len(data) - 4))
        for huge in HUGE
    ]
    _must_refuse(codec_class, params, [], [bomb for bomb in bombs if bomb[1] != data])


def _must_refuse(
    codec_class: FeatureClass, params: Params, before: Sequence[Packet], damaged: Iterable[tuple[str, bytes]]
) -> None:
    """before: packets that came whole. Fails unless each of the others, coming next, raises BitstreamError."""
    starts = not before
    for where, data in damaged:
        packet = Packet(data, len(before), starts)
        place = sandbox("decode")
        reply = place.call(_last_of, codec_class, params, [*before, packet], timeout_s=_TIMEOUT_S, memory_mb=_MEMORY_MB)
        if reply.status == "done":
            raise ConformanceFailure(where, reply.value, "BitstreamError")
        if reply.status != "refused":
            raise ConformanceFailure(where, f"{reply.status}: {reply.reason}", "BitstreamError")


def _last_of(codec_class: FeatureClass, params: Params, packets: Sequence[Packet]) -> str:
    """What the last packet gives, in words."""
    found = decoded_of(codec_class(params), packets)[-1].features
    return "no features" if found is None else f"{len(found)} features"


def _elsewhere(verb: Verb, where: str, function: Any, codec_class: FeatureClass, params: Params, argument: Any) -> Any:
    """What the codec does in another process. Fails where it does not."""
    reply = sandbox(verb).call(function, codec_class, params, argument, timeout_s=_TIMEOUT_S, memory_mb=_MEMORY_MB)
    if reply.status != "done":
        raise ConformanceFailure(where, f"{reply.status}: {reply.reason}", "what this process gets")
    return reply.value


def _encoded(codec_class: FeatureClass, params: Params, pictures: Sequence[Image]) -> list[Packet]:
    codec = codec_class(params)
    return packets_of(codec, sets_of(codec, pictures))


def _decoded(codec_class: FeatureClass, params: Params, packets: Sequence[Packet]) -> list[FeatureSet]:
    return decoded_of(codec_class(params), packets)


def _require_same(where: str, got: Sequence[FeatureSet], expected: Sequence[Features], first: int = 0) -> None:
    """first: the frame of the first set."""
    shifted = [replace(one, frame=one.frame - first) for one in got]
    for index, (left, right) in enumerate(zip(whole_sets(where, shifted), expected, strict=True)):
        require_same_features(f"{where}, frame {first + index}", left, right)
