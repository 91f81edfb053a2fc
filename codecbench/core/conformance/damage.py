"""Checks of decoding lost, cut or damaged packets, and bytes that no encoder wrote.

Damaged data are decoded in a sandbox process with caps on time and memory. A decoder must refuse foreign and cut
bitstreams with BitstreamError. Not every format has a checksum, so damaged ones may decode to some image, but must not
crash, hang or raise other errors. Wrong features cannot be seen, so feature codecs must refuse all damage.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any, Final

import numpy as np

from codecbench.core.conformance.harness import (
    CodecClass,
    ConformanceFailure,
    NotClaimed,
    Shape,
    content_of,
    decoded_of,
    encode_films,
    require_same,
    require_same_contents,
    run_elsewhere,
    shape_of,
    state_of,
    whole_contents,
)
from codecbench.core.conformance.material import Film
from codecbench.core.contracts.codec import AnyCodec, Decoded, Fragment, PartialImage
from codecbench.core.contracts.errors import BitstreamError, ImageError
from codecbench.core.contracts.image import MAX_PIXELS, Image, check_image
from codecbench.core.contracts.params import Params
from codecbench.core.contracts.stream import LOST, Loss, Packet

_TIMEOUT_S = 20.0
_MEMORY_MB: Final = 1024
_CUTS: Final = 40
_MUTATIONS: Final[dict[Shape, int]] = {"pictures": 60, "stream": 10, "features": 40}
"""Number of mutations of each packet that is damaged."""
_BOMBED_BYTES: Final = 96
_HUGE: Final = (b"\xff\xff\xff\xff", b"\x7f\xff\xff\xff", b"\x00\x01\xff\xff", b"\xff\xff\x01\x00", b"\xff\xff\xff\x7f")
_FOREIGN: Final = {
    "no bytes": b"",
    "one byte": b"\x00",
    "zeros": bytes(200),
    "ones": b"\xff" * 200,
    "text": b"What a codec is given may be anything, a letter too.\n" * 4,
    "a PNG signature": b"\x89PNG\r\n\x1a\n" + bytes(40),
    "a JPEG start and end": b"\xff\xd8\xff\xd9",
    "a JPEG 2000 signature": b"\x00\x00\x00\x0cjP  \r\n\x87\n" + bytes(40),
    "a RIFF header": b"RIFF\x28\x00\x00\x00WEBPVP8 " + bytes(40),
    "noise": np.random.default_rng(7).integers(0, 256, 3000, dtype=np.uint8).tobytes(),
}
_PARTS: Final = 12
"""Number of parts that a bitstream is cut into, of which some are then missing."""
_TRIALS: Final = 20
_LOSS: Final = 0.25

Damaged = Iterable[tuple[str, Sequence[Packet]]]
"""Descriptions of the damage, each with packets of which one is damaged."""


def starts_are_starts(codec_class: CodecClass, params: Params, films: Sequence[Film]) -> None:
    """Decode from each keyframe on by a new decoder: the frames equal those of the uninterrupted one."""
    codec = codec_class(params)
    for film, packets in encode_films(codec, films):
        expected = decoded_of(codec, packets)
        for index in [index for index, packet in enumerate(packets) if packet.starts]:
            where = f"{film.name} from packet {index} on"
            try:
                decoded = decoded_of(codec, packets[index:])
            except BitstreamError as error:
                raise ConformanceFailure(where, f"BitstreamError: {error}", "the frames from there on") from error
            require_same_contents(where, decoded, expected, packets[index].frame)


def losses_are_reported(codec_class: CodecClass, params: Params, films: Sequence[Film]) -> None:
    """Check the states of frames after losses: from the next keyframe or recovery point on, all must be whole.

    Each packet is lost in turn, alone and with the next; and a new decoder joins after each, without knowing of earlier
    packets. Feature packets carry their frame number, so their decoder must also notice unreported losses.
    """
    codec = codec_class(params)
    for film, packets in encode_films(codec, films):
        expected = whole_contents(f"decoding {film.name}", decoded_of(codec, packets))
        for index, packet in enumerate(packets):
            before, rest, lost = packets[:index], packets[index + 1 :], {packet.frame}
            where = f"decoding {film.name} without packet {index}, of frame {packet.frame}"
            _require_true_states(where, codec, [*before, LOST, *rest], rest, lost, expected)
            if rest:
                both = lost | {rest[0].frame}
                received: list[Packet | Loss] = [*before, LOST, LOST, *rest[1:]]
                _require_true_states(f"{where} and the next", codec, received, rest[1:], both, expected)
            if codec.carries == "features":
                _require_true_states(f"{where}, unreported", codec, [*before, *rest], rest, lost, expected)
            where = f"random access to {film.name} after packet {index}, of frame {packet.frame}"
            _require_true_states(where, codec, rest, rest, lost, expected)


def _require_true_states(
    where: str,
    codec: AnyCodec[Any],
    received: Sequence[Packet | Loss],
    rest: Sequence[Packet],
    lost: set[int],
    expected: dict[int, Any],
) -> None:
    """Fail unless frames that are called whole are, and all that must be whole are.

    received: packets and reported losses. rest: the packets after the loss. lost: frames.
    """
    try:
        decoded = decoded_of(codec, received)
    except BitstreamError as error:
        raise ConformanceFailure(where, f"BitstreamError: {error}", "frames: no byte was damaged") from error
    states = {result.frame: state_of(result) for result in decoded}
    if len(states) != len(decoded) or not states.keys() <= expected.keys():
        frames = [result.frame for result in decoded]
        raise ConformanceFailure(where, f"the frames {frames}", "each frame of the stream at most once")
    if codec.carries == "features" and len(decoded) != len(received):
        raise ConformanceFailure(where, f"{len(decoded)} sets", f"{len(received)}, one of each packet or loss")
    for result in decoded:
        _require_true_state(f"{where}, frame {result.frame}", result, lost, expected)
    start = min((first for packet in rest if (first := packet.whole_from) is not None), default=math.inf)
    due = {frame for frame in expected if frame >= start and frame not in lost}
    if codec.carries == "features" and len(received) > len(rest):
        due |= {frame for frame in expected if frame < min(lost)}
    if broken := sorted(frame for frame in due if states.get(frame) != "whole"):
        raise ConformanceFailure(
            where, f"frames {broken} are not whole", "whole frames before it and from a keyframe on"
        )


def _require_true_state(where: str, result: Decoded, lost: set[int], expected: dict[int, Any]) -> None:
    content, state = content_of(result), state_of(result)
    if state == "whole" and result.frame in lost:
        raise ConformanceFailure(where, "whole", "concealed or missing: its packet was lost")
    if (content is None) != (state == "missing"):
        raise ConformanceFailure(where, result, "an image unless it is missing")
    if state == "whole":
        require_same(f"{where}, marked whole", content, expected[result.frame])


def foreign_bytes_are_refused(codec_class: CodecClass, params: Params, films: Sequence[Film]) -> None:
    foreign = ((f"push({name}) as a keyframe", [Packet(data, 0, starts=True)]) for name, data in _FOREIGN.items())
    _must_refuse(codec_class, params, 0, foreign)


def cut_streams_are_refused(codec_class: CodecClass, params: Params, films: Sequence[Film]) -> None:
    for name, packets, index in _samples(codec_class, params, films):
        _must_refuse(codec_class, params, index, _with_each(packets, index, _cuts(packets[index].data, name)))


def damaged_streams_are_survived(codec_class: CodecClass, params: Params, films: Sequence[Film]) -> None:
    rng, shape = np.random.default_rng(11), shape_of(codec_class)
    for name, packets, index in _samples(codec_class, params, films):
        data = packets[index].data
        damaged = _with_each(packets, index, mutations(data, rng, _MUTATIONS[shape], name))
        _must_withstand(codec_class, params, index, damaged)


def huge_headers_are_survived(codec_class: CodecClass, params: Params, films: Sequence[Film]) -> None:
    """Overwrite each place of the first header with huge numbers; decoding must stay within time and memory caps."""
    samples = _samples(codec_class, params, films if codec_class.stateless else films[-1:])
    name, packets, _ = min(samples, key=lambda sample: len(sample[1][0].data))
    _must_withstand(codec_class, params, 0, _with_each(packets[:2], 0, _bombs(packets[0].data, name)))


def _samples(codec_class: CodecClass, params: Params, films: Sequence[Film]) -> list[tuple[str, Sequence[Packet], int]]:
    """Return packets and the index of the one to damage.

    Of single images these are the longest and the shortest that the codec supports, of each stream the first and a
    middle one.
    """
    streams = [(film.name, packets) for film, packets in encode_films(codec_class(params), films)]
    if codec_class.stateless:
        by_size = sorted(streams, key=lambda stream: len(stream[1][0].data))
        return [(name, packets, 0) for name, packets in dict([by_size[-1], by_size[0]]).items()]
    targets = [(name, packets, index) for name, packets in streams for index in (0, len(packets) // 2)]
    return [(f"{name}, packet {index}", packets, index) for name, packets, index in targets]


def _with_each(
    packets: Sequence[Packet], index: int, damaged: Iterable[tuple[str, bytes]]
) -> Iterator[tuple[str, Sequence[Packet]]]:
    """Yield the packets with one of them replaced by each of its damaged versions that differ from it."""
    for where, data in damaged:
        if data != packets[index].data:
            yield where, [*packets[:index], replace(packets[index], data=data), *packets[index + 1 :]]


def _cuts(data: bytes, name: str) -> Iterator[tuple[str, bytes]]:
    for length in sorted({*np.linspace(0, len(data) - 1, _CUTS, dtype=int).tolist(), len(data) - 1}):
        yield f"decoding {name}, {length} of {len(data)} bytes", data[:length]
    yield f"decoding {name} with a byte added", data + b"\0"


def _bombs(data: bytes, name: str) -> Iterator[tuple[str, bytes]]:
    for place in range(min(_BOMBED_BYTES, len(data) - 4)):
        for huge in _HUGE:
            yield (
                f"decoding {name}, {huge.hex()} at byte {place}",
                data[:place] + huge + data[place + len(huge) :],
            )


def mutations(data: bytes, rng: np.random.Generator, count: int, name: str) -> Iterator[tuple[str, bytes]]:
    """Yield copies of a bitstream with bits flipped, bytes changed, or parts overwritten, removed or repeated."""
    for index in range(count):
        mutant = bytearray(data)
        place = int(rng.integers(len(data)))
        kind = index % 5
        if kind == 0:
            mutant[place] ^= 1 << int(rng.integers(8))
        elif kind == 1:
            for _ in range(int(rng.integers(1, 8))):
                mutant[int(rng.integers(len(data)))] = int(rng.integers(256))
        elif kind == 2:
            part = mutant[place : place + int(rng.integers(1, 20))]
            mutant[place : place + len(part)] = rng.integers(0, 256, len(part), dtype=np.uint8).tobytes()
        elif kind == 3:
            del mutant[place : place + int(rng.integers(1, 30))]
        else:
            mutant[place:place] = mutant[: int(rng.integers(1, 30))]
        yield f"decoding {name}, mutation {index} at byte {place}", bytes(mutant)


def _must_withstand(codec_class: CodecClass, params: Params, index: int, damaged: Damaged) -> None:
    if codec_class.carries == "features":
        _must_refuse(codec_class, params, index, damaged)
    else:
        _must_survive(codec_class, params, damaged)


def _must_survive(codec_class: CodecClass, params: Params, damaged: Damaged) -> None:
    """Fail unless every packet is refused or decodes to images of a sane size."""
    for where, packets in damaged:
        for image in _decode_in_process(where, codec_class, params, packets)[0]:
            try:
                check_image(image, bits=(8, 16))
            except ImageError as error:
                raise ConformanceFailure(where, str(error), "BitstreamError or an image") from error
            if image.shape[0] * image.shape[1] > MAX_PIXELS:
                raise ConformanceFailure(where, f"an image of shape {image.shape}", f"at most {MAX_PIXELS} pixels")


def _must_refuse(codec_class: CodecClass, params: Params, index: int, damaged: Damaged) -> None:
    """Fail unless the packet at this index is refused in each stream. It is the last that is decoded."""
    for where, packets in damaged:
        contents, refused = _decode_in_process(where, codec_class, params, packets[: index + 1])
        if refused != [index]:
            got = f"{len(contents)} frames or feature sets" if not refused else f"packets {refused} refused"
            raise ConformanceFailure(where, got, "BitstreamError")


def _decode_in_process(where: str, codec_class: CodecClass, params: Params, packets: Sequence[Packet]) -> Any:
    """Call `_survivors` in another process. Fails if the codec raises or crashes."""
    call = _survivors, codec_class, params, packets
    expected = "BitstreamError or a result of decode"
    return run_elsewhere("decode", where, *call, expected=expected, timeout_s=_TIMEOUT_S, memory_mb=_MEMORY_MB)


def _survivors(codec_class: CodecClass, params: Params, packets: Sequence[Packet]) -> tuple[list[Any], list[int]]:
    """Decode damaged packets; return the contents, and the indexes of packets that were refused."""
    session = codec_class(params).open_decoder()
    decoded: list[Decoded] = []
    refused = []
    for index, packet in enumerate(packets):
        try:
            decoded += session.push(packet)
        except BitstreamError:
            refused.append(index)
    decoded += session.flush()
    return [content for result in decoded if (content := content_of(result)) is not None], refused


def parts_decode(codec_class: Any, params: Params, films: Sequence[Film]) -> None:
    """Decode parts of a bitstream: they are refused, or give an image of the right shape with a true mask."""
    if not codec_class.capabilities.partial_decoding:
        raise NotClaimed("this codec does not claim to decode parts of a bitstream")
    codec, rng = codec_class(params), np.random.default_rng(13)
    for film, packets in encode_films(codec, films):
        bitstream = packets[0].data
        decoded = codec.decode(bitstream)
        partial = codec.decode_partial([Fragment(0, bitstream)])
        where = f"decode_partial({film.name}), nothing missing"
        _require_true_mask(where, partial, decoded)
        if not partial.whole.all():
            raise ConformanceFailure(where, f"{np.count_nonzero(~partial.whole)} pixels not whole", "all whole")
        for trial in range(_TRIALS):
            fragments = _with_gaps(bitstream, rng)
            where = f"decode_partial({film.name}), {[(part.offset, part.end) for part in fragments]}, trial {trial}"
            call, expected = (_decode_partial, codec_class, params, fragments), "BitstreamError or an image"
            for partial in run_elsewhere(
                "decode", where, *call, expected=expected, timeout_s=_TIMEOUT_S, memory_mb=_MEMORY_MB
            ):
                _require_true_mask(where, partial, decoded)


def _decode_partial(codec_class: Any, params: Params, fragments: Sequence[Fragment]) -> list[PartialImage]:
    """Decode parts of a bitstream into a list of one image; empty if they are refused."""
    try:
        return [codec_class(params).decode_partial(fragments)]
    except BitstreamError:
        return []


def _with_gaps(bitstream: bytes, rng: np.random.Generator) -> list[Fragment]:
    """Return the first part and a random selection of the others; half of all trials lack the end."""
    bounds = [*np.linspace(0, len(bitstream), min(_PARTS, len(bitstream)) + 1, dtype=int).tolist()]
    arrived = rng.random(len(bounds) - 1) >= _LOSS
    arrived[0], arrived[-1] = True, rng.random() < 0.5
    fragments: list[Fragment] = []
    for (begin, end), has_arrived in zip(pairwise(bounds), arrived, strict=True):
        if not has_arrived:
            continue
        if fragments and fragments[-1].end == begin:
            begin = fragments.pop().offset
        fragments.append(Fragment(begin, bitstream[begin:end]))
    return fragments


def _require_true_mask(where: str, partial: PartialImage, decoded: Image) -> None:
    """Fail unless a partial image has the shape of the complete one, and its pixels wherever the mask says so."""
    if not isinstance(partial, PartialImage):
        raise ConformanceFailure(where, type(partial).__name__, "a PartialImage")
    image, is_whole = partial.image, partial.whole
    if image.dtype != decoded.dtype or image.shape != decoded.shape:
        expected = f"{decoded.dtype} of shape {decoded.shape}"
        raise ConformanceFailure(where, f"{image.dtype} of shape {image.shape}", expected)
    if is_whole.dtype != np.bool_ or is_whole.shape != decoded.shape[:2]:
        raise ConformanceFailure(where, f"whole: {is_whole.dtype} of {is_whole.shape}", f"bool of {decoded.shape[:2]}")
    require_same(f"{where}, pixels marked whole", image[is_whole], decoded[is_whole])
