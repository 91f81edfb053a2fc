"""Checks of what a decoder does from the middle on, after losses, and with bytes that no encoder wrote.

Each packet is lost in turn; damaged streams are decoded in a process that may die of it, with caps of time and memory.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from codecbench.core.conformance.failure import ConformanceFailure
from codecbench.core.conformance.moving_pictures import MovingPictures
from codecbench.core.conformance.robustness import BOMBED_BYTES, FOREIGN, HUGE, mutations, require_image
from codecbench.core.conformance.round_trip import require_equal
from codecbench.core.conformance.sandbox import sandbox
from codecbench.core.conformance.stream_round_trip import StreamClass, packets_of, pictures_of, whole_images
from codecbench.core.contracts.codec import StreamCodec
from codecbench.core.contracts.errors import BitstreamError
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.params import Params
from codecbench.core.contracts.stream import LOST, Packet

_TIMEOUT_S = 20.0
_MEMORY_MB = 1024
_MUTATIONS = 10


def starts_are_starts(codec_class: StreamClass, params: Params, sequences: Sequence[MovingPictures]) -> None:
    """A new decoder from each declared start on shows what the uninterrupted one shows."""
    codec = codec_class(params)
    for sequence in sequences:
        packets = packets_of(codec, sequence.pictures)
        expected = whole_images(f"decoding {sequence.name}", pictures_of(codec, packets))
        if not packets[0].starts:
            raise ConformanceFailure(f"{sequence.name}, the first packet", "starts=False", "a start")
        for index in [index for index, packet in enumerate(packets) if packet.starts]:
            _require_the_rest(f"{sequence.name} from packet {index} on", codec, packets, index, expected)


def _require_the_rest(
    where: str, codec: StreamCodec[Any], packets: Sequence[Packet], index: int, expected: dict[int, Image]
) -> None:
    first = packets[index].frame
    try:
        pictures = pictures_of(codec, packets[index:])
    except BitstreamError as error:
        raise ConformanceFailure(where, f"BitstreamError: {error}", "the pictures from there on") from error
    images = whole_images(where, [picture for picture in pictures if picture.frame >= first])
    if sorted(images) != list(range(first, len(packets))):
        raise ConformanceFailure(where, f"the frames {sorted(images)}", f"{first} to {len(packets) - 1}")
    for frame, image in images.items():
        require_equal(f"{where}, frame {frame}", image, expected[frame])


def losses_are_told(codec_class: StreamClass, params: Params, sequences: Sequence[MovingPictures]) -> None:
    """What is called whole is, and from the next start on all is, or from where a recovery point says, whatever is
    missing.

    Each packet is lost in turn, alone and with the one behind it; and each is the first that a new decoder gets, which
    nobody tells that there were others.
    """
    codec = codec_class(params)
    for sequence in sequences:
        packets = packets_of(codec, sequence.pictures)
        expected = whole_images(f"decoding {sequence.name}", pictures_of(codec, packets))
        for lost, packet in enumerate(packets):
            where = f"decoding {sequence.name} without packet {lost}, of frame {packet.frame}"
            rest = packets[lost + 1 :]
            _require_honesty(where, codec, [*packets[:lost], LOST, *rest], packet.frame, _start_of(rest), expected)
            if rest:
                received = [*packets[:lost], LOST, LOST, *rest[1:]]
                _require_honesty(f"{where} and the next", codec, received, packet.frame, _start_of(rest[1:]), expected)
            where = f"joining {sequence.name} behind packet {lost}, of frame {packet.frame}"
            _require_honesty(where, codec, rest, packet.frame, _start_of(rest), expected)


def _start_of(packets: Sequence[Packet]) -> float:
    """The first frame from which pictures are said to be whole with these packets alone."""
    return min((whole for packet in packets if (whole := packet.whole_from) is not None), default=math.inf)


def _require_honesty(
    where: str, codec: StreamCodec[Any], received: Sequence[Any], lost: int, start: float, expected: dict[int, Image]
) -> None:
    """lost: the frame that is. start: the frame from which all is whole again."""
    try:
        pictures = pictures_of(codec, received)
    except BitstreamError as error:
        raise ConformanceFailure(where, f"BitstreamError: {error}", "pictures: no byte was damaged") from error
    states = {picture.frame: picture.state for picture in pictures}
    if len(states) != len(pictures) or not states.keys() <= expected.keys():
        frames = [picture.frame for picture in pictures]
        raise ConformanceFailure(where, f"the frames {frames}", "each frame of the stream at most once")
    if states.get(lost) == "whole":
        raise ConformanceFailure(where, f"frame {lost} is whole", "concealed or missing: its packet never came")
    for picture in pictures:
        if (picture.image is None) != (picture.state == "missing"):
            raise ConformanceFailure(f"{where}, frame {picture.frame}", picture, "an image unless it is missing")
        if picture.state == "whole":
            require_equal(
                f"{where}, frame {picture.frame}, which is called whole", picture.image, expected[picture.frame]
            )
    broken = [frame for frame in expected if frame >= start and states.get(frame) != "whole"]
    if broken:
        raise ConformanceFailure(
            where, f"frames {broken} are not whole", f"all from frame {start} on, as the packets say"
        )


def foreign_bytes_are_refused(codec_class: StreamClass, params: Params, sequences: Sequence[MovingPictures]) -> None:
    noise = np.random.default_rng(7).integers(0, 256, 3000, dtype=np.uint8).tobytes()
    for name, data in {**FOREIGN, "noise": noise}.items():
        where = f"push({name}) as a start"
        reply = _decoded_elsewhere(codec_class, params, [Packet(data, 0, starts=True)])
        if reply.status != "done":
            raise ConformanceFailure(where, f"{reply.status}: {reply.reason}", "BitstreamError")
        if not reply.value[1]:
            raise ConformanceFailure(where, f"{len(reply.value[0])} pictures", "BitstreamError")


def damaged_streams_are_survived(codec_class: StreamClass, params: Params, sequences: Sequence[MovingPictures]) -> None:
    """Mutations of the first packet and of a later one."""
    rng = np.random.default_rng(11)
    for sequence in sequences:
        packets = packets_of(codec_class(params), sequence.pictures)
        for index in (0, len(packets) // 2):
            mutants = mutations(packets[index].data, rng, _MUTATIONS, f"{sequence.name}, packet {index}")
            _must_survive(codec_class, params, ((where, _with(packets, index, data)) for where, data in mutants))


def huge_headers_are_survived(codec_class: StreamClass, params: Params, sequences: Sequence[MovingPictures]) -> None:
    """Every place of the first packet's header in turn claims as much as it can, within the time and memory caps."""
    sequence = sequences[-1]
    packets = packets_of(codec_class(params), sequence.pictures)[:2]
    stream = packets[0].data
    bombs = (
        (f"{sequence.name}, {huge.hex()} at byte {place}", stream[:place] + huge + stream[place + len(huge) :])
        for place in range(min(BOMBED_BYTES, len(stream) - 4))
        for huge in HUGE
    )
    _must_survive(codec_class, params, ((where, _with(packets, 0, data)) for where, data in bombs))


def _with(packets: Sequence[Packet], index: int, data: bytes) -> list[Packet]:
    return [*packets[:index], replace(packets[index], data=data), *packets[index + 1 :]]


def _must_survive(codec_class: StreamClass, params: Params, streams: Iterable[tuple[str, list[Packet]]]) -> None:
    for where, packets in streams:
        reply = _decoded_elsewhere(codec_class, params, packets)
        if reply.status != "done":
            raise ConformanceFailure(where, f"{reply.status}: {reply.reason}", "BitstreamError or pictures")
        for image in reply.value[0]:
            require_image(where, image)


def _decoded_elsewhere(codec_class: StreamClass, params: Params, packets: Sequence[Packet]) -> Any:
    place = sandbox("decode")
    return place.call(_survivors, codec_class, params, packets, timeout_s=_TIMEOUT_S, memory_mb=_MEMORY_MB)


def _survivors(codec_class: StreamClass, params: Params, packets: Sequence[Packet]) -> tuple[list[Image], int]:
    """The images of a damaged stream, and how many of its packets were refused."""
    session = codec_class(params).decoder()
    images: list[Image] = []
    refused = 0
    for packet in packets:
        try:
            images += [picture.image for picture in session.push(packet) if picture.image is not None]
        except BitstreamError:
            refused += 1
    images += [picture.image for picture in session.flush() if picture.image is not None]
    return images, refused
