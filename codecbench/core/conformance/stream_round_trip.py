"""Checks of what goes into a session and what comes out, in this process."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from codecbench.core.conformance.failure import ConformanceFailure, NotClaimed
from codecbench.core.conformance.moving_pictures import (
    FRAME_RATE_HZ,
    MovingPictures,
    long_sequence,
    moving_pictures,
)
from codecbench.core.conformance.round_trip import require_equal
from codecbench.core.contracts.codec import StreamCodec
from codecbench.core.contracts.errors import ImageError
from codecbench.core.contracts.image import Image, channel_count
from codecbench.core.contracts.params import Params
from codecbench.core.contracts.stream import Loss, Packet, Picture, is_recovery
from codecbench.core.counting.trace import CountingTrace

StreamClass = type[StreamCodec[Any]]
_LENGTHS = (1, 2, 5)
_SHARED = 6
_SHARED_OF_LONG = 100
"""More than encoders hold back, so that packets have left of which something can be said."""


def packets_of(codec: StreamCodec[Any], pictures: Sequence[Image]) -> list[Packet]:
    """All packets of a session, in the order in which they leave."""
    session = codec.encoder(FRAME_RATE_HZ)
    return [packet for picture in pictures for packet in session.push(picture)] + session.flush()


def pictures_of(codec: StreamCodec[Any], packets: Sequence[Packet | Loss]) -> list[Picture]:
    """All pictures of a session, in the order in which they come."""
    session = codec.decoder()
    return [picture for packet in packets for picture in session.push(packet)] + session.flush()


def whole_images(where: str, pictures: Sequence[Picture]) -> dict[int, Image]:
    """The images by frame. Fails where a picture is not whole or comes twice."""
    images: dict[int, Image] = {}
    for picture in pictures:
        if picture.state != "whole" or picture.image is None:
            raise ConformanceFailure(where, f"frame {picture.frame} is {picture.state}", "whole, for nothing was lost")
        if picture.frame in images:
            raise ConformanceFailure(where, f"frame {picture.frame} twice", "each frame once")
        images[picture.frame] = picture.image
    return images


def require_same_packets(where: str, got: Sequence[Packet], expected: Sequence[Packet]) -> None:
    """Fail unless two sessions gave the same packets."""
    if len(got) != len(expected):
        raise ConformanceFailure(where, f"{len(got)} packets", f"{len(expected)}")
    for index, (left, right) in enumerate(zip(got, expected, strict=True)):
        if left != right:
            what = "other bytes" if left.data != right.data else f"frame {left.frame}, starts={left.starts}"
            raise ConformanceFailure(f"{where}, packet {index}", what, "the same packet")


def packets_are_bytes(codec_class: StreamClass, params: Params, sequences: Sequence[MovingPictures]) -> None:
    for sequence in sequences:
        for packet in packets_of(codec_class(params), sequence.pictures):
            where = f"encoding {sequence.name}, frame {packet.frame}"
            if type(packet) is not Packet:
                raise ConformanceFailure(where, type(packet).__name__, "a Packet, of which all that counts is `data`")
            if type(packet.data) is not bytes or not packet.data:
                raise ConformanceFailure(where, f"{type(packet.data).__name__} {packet.data!r:.40}", "bytes")
            if type(packet.frame) is not int or type(packet.starts) is not bool:
                raise ConformanceFailure(where, f"frame {packet.frame!r}, starts {packet.starts!r}", "int and bool")
            if not is_recovery(packet.recovery_frames):
                raise ConformanceFailure(where, f"recovery_frames {packet.recovery_frames!r}", "None, or an int from 0")


def no_frame_is_lost_or_doubled(codec_class: StreamClass, params: Params, sequences: Sequence[MovingPictures]) -> None:
    """Sessions of several lengths, so that pictures are held back in each way when they end; one is longer."""
    film = long_sequence(channel_count(sequences[0].pictures[0]))
    for sequence, lengths in [*((sequence, _LENGTHS) for sequence in sequences), (film, ())]:
        for length in (*lengths, len(sequence.pictures)):
            codec = codec_class(params)
            packets = packets_of(codec, sequence.pictures[:length])
            where = f"{length} frames of {sequence.name}"
            if sorted(packet.frame for packet in packets) != list(range(length)):
                frames = [packet.frame for packet in packets]
                raise ConformanceFailure(f"encoding {where}", f"packets of the frames {frames}", "each frame once")
            shown = [picture.frame for picture in pictures_of(codec, packets)]
            if shown != list(range(length)):
                raise ConformanceFailure(f"decoding {where}", f"the frames {shown}", "each once, in order")


def shape_and_type_return(codec_class: StreamClass, params: Params, sequences: Sequence[MovingPictures]) -> None:
    codec = codec_class(params)
    for sequence in sequences:
        where = f"decoding {sequence.name}"
        images = whole_images(where, pictures_of(codec, packets_of(codec, sequence.pictures)))
        shape = sequence.pictures[0].shape
        for image in images.values():
            if not isinstance(image, np.ndarray) or image.dtype != np.uint8:
                got = f"{type(image).__name__} {getattr(image, 'dtype', '')}"
                raise ConformanceFailure(where, got, "a uint8 array")
            if image.shape != shape:
                raise ConformanceFailure(where, f"shape {image.shape}", f"shape {shape}")
            if not image.flags.writeable or not image.flags.c_contiguous:
                raise ConformanceFailure(where, "a read-only or strided array", "an array that the caller owns")


def input_is_untouched(codec_class: StreamClass, params: Params, sequences: Sequence[MovingPictures]) -> None:
    codec = codec_class(params)
    for sequence in sequences:
        expected = packets_of(codec, sequence.pictures)
        given = [picture.copy() for picture in sequence.pictures]
        packets_of(codec, given)
        for index, (picture, before) in enumerate(zip(given, sequence.pictures, strict=True)):
            require_equal(f"picture {index} given to push({sequence.name})", picture, before)
            picture.flags.writeable = False
        require_same_packets(f"{sequence.name}, read-only", packets_of(codec, given), expected)
        strided = [np.repeat(picture, 2, axis=1)[:, ::2] for picture in sequence.pictures]
        require_same_packets(f"{sequence.name}, strided views", packets_of(codec, strided), expected)
        reused = np.empty_like(given[0])
        session, found = codec.encoder(FRAME_RATE_HZ), []
        for picture in given:
            reused[:] = picture
            found += session.push(reused)
        require_same_packets(f"{sequence.name}, pushed from one buffer", found + session.flush(), expected)


def lossless_means_lossless(codec_class: StreamClass, params: Params, sequences: Sequence[MovingPictures]) -> None:
    codec = codec_class(params)
    if not codec.is_lossless():
        raise NotClaimed("this setting does not claim to be lossless")
    for sequence in sequences:
        where = f"decoding {sequence.name} of a lossless setting"
        images = whole_images(where, pictures_of(codec, packets_of(codec, sequence.pictures)))
        for frame, picture in enumerate(sequence.pictures):
            require_equal(f"{where}, frame {frame}", images[frame], picture)


def bad_images_are_refused(codec_class: StreamClass, params: Params, sequences: Sequence[MovingPictures]) -> None:
    """As the first picture of a session, and after one of another shape."""
    codec = codec_class(params)
    first = sequences[0].pictures[0]
    bad: dict[str, Any] = {
        "uint16": np.zeros((8, 8), np.uint16),
        "float64": np.zeros((8, 8)),
        "four channels": np.zeros((8, 8, 4), np.uint8),
        "no rows": np.zeros((0, 8), np.uint8),
        "a list": [[0, 1], [2, 3]],
    }
    for name, value in bad.items():
        _require_refusal(f"push({name})", codec, [value])
    _require_refusal("push of another size", codec, [first, np.ascontiguousarray(first[:-2])])
    layout = first[..., None].repeat(3, axis=2) if first.ndim == 2 else np.ascontiguousarray(first[..., 0])
    _require_refusal("push of another layout", codec, [first, layout])


def _require_refusal(where: str, codec: StreamCodec[Any], pictures: Sequence[Any]) -> None:
    session = codec.encoder(FRAME_RATE_HZ)
    for picture in pictures[:-1]:
        session.push(picture)
    try:
        packets = session.push(pictures[-1])
    except ImageError:
        return
    except Exception as error:
        raise ConformanceFailure(where, f"{type(error).__name__}: {error}", "ImageError") from error
    raise ConformanceFailure(where, f"{len(packets)} packets", "ImageError")


def one_in_gives_one_out(codec_class: StreamClass, params: Params, sequences: Sequence[MovingPictures]) -> None:
    codec = codec_class(params)
    if not codec.is_low_delay():
        raise NotClaimed("this setting does not claim low delay")
    for sequence in (*sequences, long_sequence(channel_count(sequences[0].pictures[0]))):
        encoder, decoder = codec.encoder(FRAME_RATE_HZ), codec.decoder()
        for frame, picture in enumerate(sequence.pictures):
            where = f"{sequence.name}, push of frame {frame}"
            packets = encoder.push(picture)
            if [packet.frame for packet in packets] != [frame]:
                raise ConformanceFailure(where, f"packets of {[packet.frame for packet in packets]}", "its packet")
            pictures = decoder.push(packets[0])
            if [shown.frame for shown in pictures] != [frame]:
                raise ConformanceFailure(f"{where}'s packet", f"{len(pictures)} pictures", "its picture at once")
        if encoder.flush() or decoder.flush():
            raise ConformanceFailure(f"{sequence.name}, flush", "more", "nothing, for nothing was held back")


def what_was_sent_is_final(codec_class: StreamClass, params: Params, sequences: Sequence[MovingPictures]) -> None:
    """Packets that have left say nothing of later pictures: not if these differ, nor if they lie beside in memory."""
    channels = channel_count(sequences[0].pictures[0])
    futures = [(*pair, _SHARED) for pair in zip(sequences, moving_pictures(channels, seed=2), strict=True)]
    for sequence, other, shared in [*futures, (long_sequence(channels), long_sequence(channels, 4), _SHARED_OF_LONG)]:
        film = np.stack(sequence.pictures)
        twin = np.stack([*sequence.pictures[:shared], *other.pictures[shared:]])
        left, right = (_sent_early(codec_class(params), list(pictures), shared) for pictures in (film, twin))
        require_same_packets(f"{sequence.name} before another future", left, right)


def _sent_early(codec: StreamCodec[Any], pictures: Sequence[Image], first: int) -> list[Packet]:
    """Packets that left with the `first` pictures, as they are when the session is over; fails if they changed."""
    session = codec.encoder(FRAME_RATE_HZ)
    packets = [packet for picture in pictures[:first] for packet in session.push(picture)]
    sent = [replace(packet, data=bytes(packet.data)) for packet in packets]
    for picture in pictures[first:]:
        session.push(picture)
    session.flush()
    require_same_packets("packets after later pictures", packets, sent)
    return sent


def counting_changes_nothing(codec_class: StreamClass, params: Params, sequences: Sequence[MovingPictures]) -> None:
    codec = codec_class(params)
    claims = codec_class.capabilities.counts_operations
    for sequence in sequences[-1:]:
        trace, encoder = CountingTrace(), codec.encoder(FRAME_RATE_HZ)
        packets = [packet for picture in sequence.pictures for packet in encoder.push(picture, trace=trace)]
        packets += encoder.flush()
        require_same_packets(f"{sequence.name}, counting", packets, packets_of(codec, sequence.pictures))
        if bool(trace.counts) != claims:
            expected = "counts of every stage" if claims else "none: the codec says that it is opaque"
            raise ConformanceFailure(f"{sequence.name}, counting", f"stages {list(trace.counts)}", expected)
