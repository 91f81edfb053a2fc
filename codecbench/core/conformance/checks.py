"""Checks of what goes into the sessions of a codec and what comes out, in this process, in others and in threads.

What a codec makes of lost packets and of bytes that no encoder wrote is in `damage`.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import zip_longest
from typing import Any, Final

import numpy as np

from codecbench.core.conformance.harness import (
    FEATURE_ARRAYS,
    CodecClass,
    ConformanceFailure,
    NotClaimed,
    decoded_of,
    elsewhere,
    encoded,
    packets_of,
    require_same,
    require_same_contents,
    require_same_packets,
    whole,
)
from codecbench.core.conformance.material import (
    FRAME_RATE_HZ,
    Film,
    long_sequence,
    moving_pictures,
    saturated_images,
)
from codecbench.core.conformance.settings import other_settings
from codecbench.core.contracts.codec import AnyCodec, Decoded
from codecbench.core.contracts.errors import ImageError
from codecbench.core.contracts.features import ANGLE_TOLERANCE_RAD, Features
from codecbench.core.contracts.image import Image, channel_count
from codecbench.core.contracts.params import Params
from codecbench.core.contracts.stream import Packet, is_recovery
from codecbench.core.counting.trace import CountingTrace

_ACROSS: Final = 192
"""Three quarters of the range of a sample."""
_LENGTHS: Final = (1, 2, 5)
_SHARED: Final = 6
_SHARED_OF_LONG: Final = 100
"""More than encoders hold back, so that packets have left of which something can be said."""
_THREADS: Final = 4
_FEW: Final = 3
_MANY: Final = 70_000
"""More features than any device finds, and more than 16 bits count."""


def params_survive_json(codec_class: CodecClass, params: Params, films: Sequence[Film]) -> None:
    again = type(params).model_validate(json.loads(json.dumps(params.model_dump(mode="json"))))
    if again != params:
        raise ConformanceFailure("params", f"{again!r} after JSON", repr(params))
    if json.dumps(again.identity(), sort_keys=True) != json.dumps(params.identity(), sort_keys=True):
        raise ConformanceFailure("params.identity()", again.identity(), repr(params.identity()))


def libraries_are_named(codec_class: CodecClass, params: Params, films: Sequence[Film]) -> None:
    libraries = codec_class(params).libraries()
    if not all(isinstance(name, str) and isinstance(version, str) and version for name, version in libraries.items()):
        raise ConformanceFailure("libraries()", libraries, "names and versions as text")


def packets_are_bytes(codec_class: CodecClass, params: Params, films: Sequence[Film]) -> None:
    for film, packets in encoded(codec_class(params), films):
        for index, packet in enumerate(packets):
            where = f"encoding {film.name}, packet {index}"
            if type(packet) is not Packet:
                raise ConformanceFailure(where, type(packet).__name__, "a Packet, of which all that counts is `data`")
            if type(packet.data) is not bytes or not packet.data:
                raise ConformanceFailure(where, f"{type(packet.data).__name__} {packet.data!r:.40}", "bytes")
            if type(packet.frame) is not int or type(packet.starts) is not bool:
                raise ConformanceFailure(where, f"frame {packet.frame!r}, starts {packet.starts!r}", "int and bool")
            if not is_recovery(packet.recovery_frames):
                raise ConformanceFailure(where, f"recovery_frames {packet.recovery_frames!r}", "None, or an int from 0")
        if codec_class.carries == "features" and [packet.frame for packet in packets] != [*range(len(packets))]:
            raise ConformanceFailure(f"encoding {film.name}", "packets in another order", "a packet for each set")
        if not packets[0].starts:
            raise ConformanceFailure(f"encoding {film.name}, the first packet", "starts=False", "a start")


def no_frame_is_lost_or_doubled(codec_class: CodecClass, params: Params, films: Sequence[Film]) -> None:
    """Sessions of several lengths, so that pictures are held back in each way when they end; one is longer."""
    lengths = [(film, length) for film in films for length in (*_LENGTHS, len(film.pictures))]
    longest = long_sequence(channel_count(films[0].pictures[0]))
    for film, length in [*lengths, (longest, len(longest.pictures))]:
        codec = codec_class(params)
        packets = packets_of(codec, film.pictures[:length])
        where = f"{length} frames of {film.name}"
        frames = [packet.frame for packet in packets]
        if sorted(frames) != list(range(length)):
            raise ConformanceFailure(f"encoding {where}", f"packets of the frames {frames}", "each frame once")
        frames = [picture.frame for picture in decoded_of(codec, packets)]
        if frames != list(range(length)):
            raise ConformanceFailure(f"decoding {where}", f"the frames {frames}", "each once, in order")


def shape_and_type_return(codec_class: CodecClass, params: Params, films: Sequence[Film]) -> None:
    codec = codec_class(params)
    for film, packets in encoded(codec, films):
        where = f"decoding {film.name}"
        allowed = {shape := film.pictures[0].shape}
        if "gray" in (getattr(params, "color", None), getattr(params, "colour", None)):  # asks for it in so many words
            allowed.add(shape[:2])
        for image in whole(where, decoded_of(codec, packets)).values():
            if not isinstance(image, np.ndarray) or image.dtype != np.uint8:
                got = f"{type(image).__name__} {getattr(image, 'dtype', '')}"
                raise ConformanceFailure(where, got, "a uint8 array")
            if image.shape not in allowed:
                raise ConformanceFailure(where, f"shape {image.shape}", f"shape {shape}")
            if not image.flags.writeable or not image.flags.c_contiguous:
                raise ConformanceFailure(where, "a read-only or strided array", "an array that the caller owns")


def features_are_of_the_picture(codec_class: Any, params: Params, films: Sequence[Film]) -> None:
    """Sets are valid, of the picture's size, the same again, and not all empty."""
    codec, count = codec_class(params), 0
    for film in films:
        for index, picture in enumerate(film.pictures):
            where = f"extracting from picture {index} of {film.name}"
            features = codec.extract(picture)
            if type(features) is not Features:
                raise ConformanceFailure(where, type(features).__name__, "Features")
            if features.size != (picture.shape[1], picture.shape[0]):
                raise ConformanceFailure(where, f"size {features.size}", "width and height of the picture")
            require_same(f"{where} again", codec.extract(picture), features)
            require_same(f"{where}, by a new instance", codec_class(params).extract(picture), features)
            count += len(features)
    if not count:
        raise ConformanceFailure("extracting from all pictures", "no feature", "some: they are full of corners")


def sets_come_back(codec_class: Any, params: Params, films: Sequence[Film]) -> None:
    """Every packet gives the set of its frame, of the picture's size; the set that was pushed is left alone."""
    codec = codec_class(params)
    for film in films:
        sets = [codec.extract(picture) for picture in film.pictures]
        copies = [replace(one, **{name: getattr(one, name).copy() for name in FEATURE_ARRAYS}) for one in sets]
        contents = _coded_sets(codec, sets, f"decoding {film.name}")
        for index, (one, before) in enumerate(zip(sets, copies, strict=True)):
            require_same(f"set {index} of {film.name} after it was pushed", one, before)
            if contents[index].size != one.size:
                got = f"size {contents[index].size}"
                raise ConformanceFailure(f"decoding {film.name}, frame {index}", got, "its own")


def _coded_sets(codec: Any, sets: Sequence[Features], where: str) -> list[Features]:
    """What comes back of sets that are pushed into a session. Fails where it is not one of each frame, in order."""
    encoder, decoder = codec.encoder(), codec.decoder()
    contents = whole(where, [decoder.push(packet) for packet in [encoder.push(one) for one in sets]])
    if list(contents) != list(range(len(sets))):
        raise ConformanceFailure(where, f"the frames {list(contents)}", f"0 to {len(sets) - 1}")
    return list(contents.values())


def empty_sets_are_sets(codec_class: Any, params: Params, films: Sequence[Film]) -> None:
    """Pictures without a corner, first and between others, and one pixel: nothing is found, sent and received."""
    codec = codec_class(params)
    for film in films:
        sets = [codec.extract(picture) for picture in film.pictures[:_FEW]]
        nothing = Features.none(sets[0].size)
        between = [nothing, sets[0], nothing, *sets[1:], nothing, nothing]
        for pushed in (between, [Features.none((1, 1))]):
            where = f"decoding {film.name} with empty sets between" if len(pushed) > 1 else "an empty set of one pixel"
            for index, back in enumerate(_coded_sets(codec, pushed, where)):
                if len(back) and not len(pushed[index]):
                    raise ConformanceFailure(f"{where}, set {index}", f"{len(back)} features", "none")


def limits_are_kept(codec_class: Any, params: Params, films: Sequence[Film]) -> None:
    """Sets of very many features, of a huge image, of a high level: coded and decoded whole, or refused by ValueError.

    A session that refused one goes on as if it had not been there.
    """
    codec, rng = codec_class(params), np.random.default_rng(2)
    first, second = (codec.extract(picture) for picture in films[0].pictures[:2])
    few = _drawn(rng, _FEW, first.size)
    unusual = {
        f"{_MANY} features": _drawn(rng, _MANY, first.size),
        "an image of 2^20 a side": replace(few, size=(1 << 20, 1 << 20)),
        "level 40": replace(few, octaves=np.full(_FEW, 40, np.int32)),
    }
    usual = codec.encoder()
    expected = [usual.push(first), usual.push(second)]
    for name, features in unusual.items():
        session, decoder = codec.encoder(), codec.decoder()
        packets = [session.push(first)]
        try:
            packets.append(session.push(features))
        except ValueError:
            require_same_packets(f"after {name} was refused", [*packets, session.push(second)], expected)
            continue
        back = whole(name, [decoder.push(packet) for packet in packets])[1]
        if len(back) != len(features) or back.size != features.size:
            got = f"{len(back)} features of {back.size[0]}x{back.size[1]}"
            raise ConformanceFailure(name, got, "all of them, or a ValueError when they are pushed")


def _drawn(rng: np.random.Generator, count: int, size: tuple[int, int]) -> Features:
    return Features(
        size,
        rng.integers(0, size, (count, 2)).astype(np.float64),
        np.zeros(count, np.int32),
        rng.uniform(-3.0, 3.0, count),
        np.full(count, np.nan),
        rng.integers(0, 256, (count, 32), dtype=np.uint8),
    )


def input_is_untouched(codec_class: CodecClass, params: Params, films: Sequence[Film]) -> None:
    codec = codec_class(params)
    for film, expected in encoded(codec, films):
        given = [picture.copy() for picture in film.pictures]
        packets_of(codec, given)
        for index, (picture, before) in enumerate(zip(given, film.pictures, strict=True)):
            require_same(f"picture {index} of {film.name} after it was pushed", picture, before)
            picture.flags.writeable = False
        require_same_packets(f"{film.name}, read-only", packets_of(codec, given), expected)
        strided = [np.repeat(picture, 2, axis=1)[:, ::2] for picture in film.pictures]
        require_same_packets(f"{film.name}, strided views", packets_of(codec, strided), expected)
        reused = np.empty_like(given[0])
        session, packets = codec.open_encoder(FRAME_RATE_HZ), []
        for picture in given:
            reused[:] = picture
            packets += session.push(reused)
        require_same_packets(f"{film.name}, pushed from one buffer", packets + session.flush(), expected)


def sessions_repeat(codec_class: CodecClass, params: Params, films: Sequence[Film]) -> None:
    """The same instance again, in another order, and another instance."""
    codec = codec_class(params)
    first = [(film, packets, decoded_of(codec, packets)) for film, packets in encoded(codec, films)]
    for film, packets, decoded in reversed(first):
        require_same_packets(f"{film.name} again", packets_of(codec, film.pictures), packets)
        new = packets_of(codec_class(params), film.pictures)
        require_same_packets(f"{film.name} by a new instance", new, packets)
        require_same_contents(f"decoding {film.name} again", decoded_of(codec, packets), decoded)


def sessions_do_not_interfere(codec_class: CodecClass, params: Params, films: Sequence[Film]) -> None:
    """Two films at once, picture by picture in turn, give what each gives alone."""
    codec = codec_class(params)
    alone = [packets_of(codec, film.pictures) for film in films]
    together = _in_turn([codec.open_encoder(FRAME_RATE_HZ) for _ in films], [film.pictures for film in films])
    shown = _in_turn([codec.open_decoder() for _ in films], alone)
    for film, packets, got, decoded in zip(films, alone, together, shown, strict=True):
        require_same_packets(f"{film.name} beside another session", got, packets)
        where = f"decoding {film.name} beside another session"
        require_same_contents(where, decoded, decoded_of(codec, packets))


def _in_turn(sessions: Sequence[Any], inputs: Sequence[Sequence[Any]]) -> list[list[Any]]:
    """What sessions give whose inputs are pushed in turn."""
    outputs: list[list[Any]] = [[] for _ in sessions]
    for turn in zip_longest(*inputs):
        for session, pushed, output in zip(sessions, turn, outputs, strict=True):
            output += [] if pushed is None else session.push(pushed)
    for session, output in zip(sessions, outputs, strict=True):
        output += session.flush()
    return outputs


def preparing_changes_nothing(codec_class: Any, params: Params, films: Sequence[Film]) -> None:
    """Instances prepared for each image write the bytes of the instance that they come from, which stays as it is."""
    codec = codec_class(params)
    first = list(encoded(codec, films))
    prepared = [codec.prepared(film.pictures[0]) for film, _ in first]
    for ready, (film, packets) in zip(prepared, first, strict=True):
        if type(ready) is not codec_class or ready.params != params:
            raise ConformanceFailure(f"prepared({film.name})", ready, f"{codec_class.__name__} of the same parameters")
        require_same_packets(f"prepared({film.name}) encoding it", packets_of(ready, film.pictures), packets)
        require_same_packets(f"{film.name} after prepared({film.name})", packets_of(codec, film.pictures), packets)


def one_in_gives_one_out(codec_class: CodecClass, params: Params, films: Sequence[Film]) -> None:
    codec = codec_class(params)
    if not codec.is_low_delay():
        raise NotClaimed("this setting does not claim low delay")
    for film in (*films, long_sequence(channel_count(films[0].pictures[0]))):
        encoder, decoder = codec.open_encoder(FRAME_RATE_HZ), codec.open_decoder()
        for frame, picture in enumerate(film.pictures):
            where = f"{film.name}, push of frame {frame}"
            packets = encoder.push(picture)
            if [packet.frame for packet in packets] != [frame]:
                raise ConformanceFailure(where, f"packets of {[packet.frame for packet in packets]}", "its packet")
            pictures = decoder.push(packets[0])
            if [shown.frame for shown in pictures] != [frame]:
                raise ConformanceFailure(f"{where}'s packet", f"{len(pictures)} pictures", "its picture at once")
        if encoder.flush() or decoder.flush():
            raise ConformanceFailure(f"{film.name}, flush", "more", "nothing, for nothing was held back")


def what_was_sent_is_final(codec_class: CodecClass, params: Params, films: Sequence[Film]) -> None:
    """Packets that have left say nothing of later pictures: not if these differ, nor if they lie beside in memory."""
    channels = channel_count(films[0].pictures[0])
    futures = [(*pair, _SHARED) for pair in zip(films, moving_pictures(channels, seed=2), strict=True)]
    for film, other, shared in [*futures, (long_sequence(channels), long_sequence(channels, 4), _SHARED_OF_LONG)]:
        own = np.stack(film.pictures)
        twin = np.stack([*film.pictures[:shared], *other.pictures[shared:]])
        left, right = (_sent_early(codec_class(params), list(pictures), shared) for pictures in (own, twin))
        require_same_packets(f"{film.name} before another future", left, right)


def _sent_early(codec: AnyCodec[Any], pictures: Sequence[Image], first: int) -> list[Packet]:
    """Packets that left with the `first` pictures, as they are when the session is over; fails if they changed."""
    session = codec.open_encoder(FRAME_RATE_HZ)
    packets = [packet for picture in pictures[:first] for packet in session.push(picture)]
    sent = [replace(packet, data=bytes(packet.data)) for packet in packets]
    for picture in pictures[first:]:
        session.push(picture)
    session.flush()
    require_same_packets("packets after later pictures", packets, sent)
    return sent


def lossless_means_lossless(codec_class: Any, params: Params, films: Sequence[Film]) -> None:
    codec = codec_class(params)
    if not codec.is_lossless():
        raise NotClaimed("this setting does not claim to be lossless")
    for film, packets in encoded(codec, films):
        where = f"decoding {film.name} of a lossless setting"
        contents = whole(where, decoded_of(codec, packets))
        for frame, picture in enumerate(film.pictures):
            if codec_class.carries == "features":
                _require_as_good(f"{where}, frame {frame}", contents[frame], codec.extract(picture))
            else:
                require_same(f"{where}, frame {frame}", contents[frame], picture)


def _require_as_good(where: str, got: Features, expected: Features) -> None:
    """Fail unless two sets are the same in any order, but for the last of the angles' bits."""
    if len(got) != len(expected):
        raise ConformanceFailure(where, f"{len(got)} features", f"{len(expected)}")
    got, expected = _in_order(got), _in_order(expected)
    for name in ("pixels", "octaves", "descriptors"):
        if not np.array_equal(getattr(got, name), getattr(expected, name)):
            raise ConformanceFailure(where, f"other {name}", "those that were found")
    turn = np.abs(np.angle(np.exp(1j * (got.angles - expected.angles)))).max(initial=0.0)
    if turn > ANGLE_TOLERANCE_RAD:
        raise ConformanceFailure(where, f"an angle that is {turn:.2g} rad off", f"at most {ANGLE_TOLERANCE_RAD:.0e}")


def _in_order(one: Features) -> Features:
    """Sorted by all that is to come back to the bit."""
    order = np.lexsort(np.column_stack([one.descriptors, one.pixels, one.octaves]).T)
    return replace(one, **{name: getattr(one, name)[order] for name in FEATURE_ARRAYS})


def samples_stop_at_black_and_white(codec_class: CodecClass, params: Params, films: Sequence[Film]) -> None:
    """No decoded sample jumps to the other end of the range, which is where one that wraps round comes out."""
    codec = codec_class(params)
    for film, packets in encoded(codec, saturated_images(channel_count(films[0].pictures[0]))):
        original = film.pictures[0]
        decoded = whole(f"decoding {film.name}", decoded_of(codec, packets))[0]
        if decoded.shape != original.shape:  # turned gray, as `shape` allows where it is asked for
            continue
        wrapped = _wrapped(decoded.astype(np.int16), original.astype(np.int16))
        if wrapped.any():
            place = tuple(int(i) for i in np.argwhere(wrapped)[0])
            got = f"{decoded[place]} at {place}, far from its neighbour; {np.count_nonzero(wrapped)} such"
            raise ConformanceFailure(f"decoding {film.name}", got, f"about {original[place]}")


def _wrapped(decoded: Any, original: Any) -> Any:
    """Samples at the wrong end of the range beside a neighbour that is not, where the image has no edge.

    An error alone proves nothing: a coarse setting may smear black over white, but smoothly.
    """
    wrong = np.abs(decoded - original) > _ACROSS
    beside = np.zeros_like(wrong)
    for axis in (0, 1):
        flat = np.diff(original, axis=axis) == 0
        flat = flat if flat.ndim == 2 else flat.all(axis=2, keepdims=True)  # colour that turns gray mixes its channels
        jump = (np.abs(np.diff(decoded, axis=axis)) > _ACROSS) & flat
        before, after = np.zeros_like(wrong), np.zeros_like(wrong)
        np.moveaxis(before, axis, 0)[:-1] = np.moveaxis(jump, axis, 0)
        np.moveaxis(after, axis, 0)[1:] = np.moveaxis(jump, axis, 0)
        beside |= before | after
    return wrong & beside


def bad_images_are_refused(codec_class: CodecClass, params: Params, films: Sequence[Film]) -> None:
    """As the first picture of a session, and of codecs with memory after one of another shape."""
    for name, pictures in _bad_images(codec_class, films[0].pictures[0]):
        session = codec_class(params).open_encoder(FRAME_RATE_HZ)
        for picture in pictures[:-1]:
            session.push(picture)
        try:
            packets = session.push(pictures[-1])
        except ImageError:
            continue
        except Exception as error:
            raise ConformanceFailure(f"push({name})", f"{type(error).__name__}: {error}", "ImageError") from error
        raise ConformanceFailure(f"push({name})", f"{len(packets)} packets", "ImageError")


def _bad_images(codec_class: CodecClass, image: Image) -> Iterator[tuple[str, list[Any]]]:
    """Names, and what is pushed of which the last is to be refused. image: a good one."""
    yield "uint16", [np.zeros((8, 8), np.uint16)]
    yield "float64", [np.zeros((8, 8))]
    yield "bool", [np.zeros((8, 8), np.bool_)]
    yield "four channels", [np.zeros((8, 8, 4), np.uint8)]
    yield "two channels", [np.zeros((8, 8, 2), np.uint8)]
    yield "one dimension", [np.zeros(8, np.uint8)]
    yield "no rows", [np.zeros((0, 8), np.uint8)]
    yield "no columns", [np.zeros((8, 0, 3), np.uint8)]
    yield "a list", [[[0, 1], [2, 3]]]
    for layout, shape in ((1, (8, 8)), (3, (8, 8, 3))):
        if layout not in codec_class.capabilities.channels:
            yield f"{layout} channel(s), not in capabilities", [np.zeros(shape, np.uint8)]
    if codec_class.carries == "pictures" and not codec_class.stateless:
        yield "another size", [image, np.ascontiguousarray(image[:-2])]
        gray_or_colour = image[..., None].repeat(3, axis=2) if image.ndim == 2 else np.ascontiguousarray(image[..., 0])
        yield "another layout", [image, gray_or_colour]


def another_process_encodes_alike(codec_class: CodecClass, params: Params, films: Sequence[Film]) -> None:
    for film, packets in encoded(codec_class(params), films):
        where = f"encoding {film.name} in another process"
        require_same_packets(where, elsewhere("encode", where, _encode, codec_class, params, film.pictures), packets)


def packets_alone_decode(codec_class: CodecClass, params: Params, films: Sequence[Film]) -> None:
    """Decode copies of the packets where nothing was encoded, by instances of other settings."""
    codec = codec_class(params)
    for film, packets in encoded(codec, films):
        copies = [replace(packet, data=bytes(bytearray(packet.data))) for packet in packets]
        expected = decoded_of(codec, packets)
        for other in [params, *other_settings(params)]:
            where = f"decoding {film.name} in another process, by the setting {other}"
            require_same_contents(where, elsewhere("decode", where, _decode, codec_class, other, copies), expected)


def _encode(codec_class: CodecClass, params: Params, pictures: Sequence[Image]) -> list[Packet]:
    return packets_of(codec_class(params), pictures)


def _decode(codec_class: CodecClass, params: Params, packets: Sequence[Packet]) -> list[Decoded]:
    return decoded_of(codec_class(params), packets)


def threads_do_not_interfere(codec_class: CodecClass, params: Params, films: Sequence[Film]) -> None:
    """Sessions of one instance in several threads at once give what they give alone."""
    if not codec_class.capabilities.thread_safe:
        raise NotClaimed("this codec does not claim to be thread-safe")
    codec = codec_class(params)
    alone = [(film, packets, decoded_of(codec, packets)) for film, packets in encoded(codec, films)]

    def work(offset: int) -> None:
        for film, packets, decoded in alone[offset:] + alone[:offset]:
            where = f"{film.name} in one of {_THREADS} threads"
            require_same_packets(where, packets_of(codec, film.pictures), packets)
            require_same_contents(f"decoding {where}", decoded_of(codec, packets), decoded)

    rounds = 3 if codec_class.stateless else 1
    with ThreadPoolExecutor(_THREADS) as pool:
        for future in [pool.submit(work, offset % len(alone)) for offset in range(_THREADS * rounds)]:
            future.result()


def counting_changes_nothing(codec_class: CodecClass, params: Params, films: Sequence[Film]) -> None:
    """Counted runs give the bytes and pixels of fast ones, the same counts every time, and none if opaque."""
    codec = codec_class(params)
    claims = codec_class.capabilities.counts_operations
    for film, packets in encoded(codec, films if codec_class.stateless else films[-1:]):
        where = f"{film.name}, counting"
        encoding, decoding, again = CountingTrace(), CountingTrace(), CountingTrace()
        require_same_packets(where, packets_of(codec, film.pictures, encoding), packets)
        require_same_contents(where, decoded_of(codec, packets, decoding), decoded_of(codec, packets))
        for trace in (encoding, decoding):
            if bool(trace.counts) != claims:
                expected = "counts of every stage" if claims else "none: the codec says that it is opaque"
                raise ConformanceFailure(where, f"stages {list(trace.counts)}", expected)
        packets_of(codec, film.pictures, again)
        if again.counts != encoding.counts:
            raise ConformanceFailure(f"{where} twice", "other counts", "equal counts")
