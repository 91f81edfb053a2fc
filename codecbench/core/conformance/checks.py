"""Checks of the inputs and outputs of a codec's sessions, in this process, in others and in threads.

`damage` has the checks of lost packets and of bytes that no encoder wrote.
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
    encode_films,
    packets_of,
    require_same,
    require_same_contents,
    require_same_packets,
    run_elsewhere,
    whole_contents,
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
from codecbench.core.contracts.image import LAYOUTS, Image, layout_of
from codecbench.core.contracts.params import Params
from codecbench.core.contracts.stream import Packet, is_recovery
from codecbench.core.counting.trace import CountingTrace

_ACROSS: Final = 192
"""Difference of 8-bit samples that counts as wrapped: three quarters of their range."""
_LENGTHS: Final = (1, 2, 5)
_SHARED: Final = 6
_SHARED_OF_LONG: Final = 100
"""Number of shared frames, more than encoders hold back, so that some packets have left."""
_THREADS: Final = 4
_FEW: Final = 3
_MANY: Final = 70_000
"""More features than any device extracts, and more than 16 bits can count."""


def params_survive_json(codec_class: CodecClass, params: Params, films: Sequence[Film]) -> None:
    restored = type(params).model_validate(json.loads(json.dumps(params.model_dump(mode="json"))))
    if restored != params:
        raise ConformanceFailure("params", f"{restored!r} after JSON", repr(params))
    if json.dumps(restored.identity(), sort_keys=True) != json.dumps(params.identity(), sort_keys=True):
        raise ConformanceFailure("params.identity()", restored.identity(), repr(params.identity()))


def libraries_are_named(codec_class: CodecClass, params: Params, films: Sequence[Film]) -> None:
    libraries = codec_class(params).libraries()
    if not all(isinstance(name, str) and isinstance(version, str) and version for name, version in libraries.items()):
        raise ConformanceFailure("libraries()", libraries, "names and versions as text")


def packets_are_bytes(codec_class: CodecClass, params: Params, films: Sequence[Film]) -> None:
    for film, packets in encode_films(codec_class(params), films):
        for index, packet in enumerate(packets):
            where = f"encoding {film.name}, packet {index}"
            if type(packet) is not Packet:
                raise ConformanceFailure(where, type(packet).__name__, "a Packet, not a subclass")
            if type(packet.data) is not bytes or not packet.data:
                raise ConformanceFailure(where, f"{type(packet.data).__name__} {packet.data!r:.40}", "bytes")
            if type(packet.frame) is not int or type(packet.starts) is not bool:
                raise ConformanceFailure(where, f"frame {packet.frame!r}, starts {packet.starts!r}", "int and bool")
            if not is_recovery(packet.recovery_frames):
                raise ConformanceFailure(where, f"recovery_frames {packet.recovery_frames!r}", "None, or an int from 0")
        if codec_class.carries == "features" and [packet.frame for packet in packets] != [*range(len(packets))]:
            raise ConformanceFailure(f"encoding {film.name}", "packets in another order", "a packet for each set")
        if not packets[0].starts:
            raise ConformanceFailure(f"encoding {film.name}, the first packet", "starts=False", "a keyframe")


def no_frame_is_lost_or_doubled(codec_class: CodecClass, params: Params, films: Sequence[Film]) -> None:
    """Run sessions of several lengths, to end them with different numbers of frames held back; one is longer."""
    lengths = [(film, length) for film in films for length in (*_LENGTHS, len(film.pictures))]
    longest = long_sequence(layout_of(films[0].pictures[0]))
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
    for film, packets in encode_films(codec, films):
        where = f"decoding {film.name}"
        dtype, allowed = film.pictures[0].dtype, {shape := film.pictures[0].shape}
        if "gray" in (getattr(params, "color", None), getattr(params, "colour", None)):  # asks for it explicitly
            allowed.add(shape[:2])
        for image in whole_contents(where, decoded_of(codec, packets)).values():
            if not isinstance(image, np.ndarray) or image.dtype != dtype:
                got = f"{type(image).__name__} {getattr(image, 'dtype', '')}"
                raise ConformanceFailure(where, got, f"a {dtype} array")
            if image.shape not in allowed:
                raise ConformanceFailure(where, f"shape {image.shape}", f"shape {shape}")
            if not image.flags.writeable or not image.flags.c_contiguous:
                raise ConformanceFailure(where, "a read-only or strided array", "an array that the caller owns")


def features_match_the_image(codec_class: Any, params: Params, films: Sequence[Film]) -> None:
    """Check that feature sets are valid, of the image's size, repeatable, and not all empty."""
    codec, count = codec_class(params), 0
    for film in films:
        for index, picture in enumerate(film.pictures):
            where = f"extracting from frame {index} of {film.name}"
            features = codec.extract(picture)
            if type(features) is not Features:
                raise ConformanceFailure(where, type(features).__name__, "Features")
            if features.size != (picture.shape[1], picture.shape[0]):
                raise ConformanceFailure(where, f"size {features.size}", "width and height of the image")
            require_same(f"{where} again", codec.extract(picture), features)
            require_same(f"{where}, by a new instance", codec_class(params).extract(picture), features)
            count += len(features)
    if not count:
        raise ConformanceFailure("extracting from all frames", "no feature", "some: the frames are full of corners")


def sets_come_back(codec_class: Any, params: Params, films: Sequence[Film]) -> None:
    """Check that every packet decodes to its frame's set, of the image's size, and that pushed sets are unchanged."""
    codec = codec_class(params)
    for film in films:
        sets = [codec.extract(picture) for picture in film.pictures]
        copies = [replace(pushed, **{name: getattr(pushed, name).copy() for name in FEATURE_ARRAYS}) for pushed in sets]
        contents = _decoded_sets(codec, sets, f"decoding {film.name}")
        for index, (pushed, before) in enumerate(zip(sets, copies, strict=True)):
            require_same(f"set {index} of {film.name} after it was pushed", pushed, before)
            if contents[index].size != pushed.size:
                got = f"size {contents[index].size}"
                raise ConformanceFailure(f"decoding {film.name}, frame {index}", got, f"{pushed.size}")


def _decoded_sets(codec: Any, sets: Sequence[Features], where: str) -> list[Features]:
    """Encode and decode sets in one session. Fails unless each frame has one set, in order."""
    encoder, decoder = codec.encoder(), codec.decoder()
    packets = [encoder.push(features) for features in sets]
    contents = whole_contents(where, [decoder.push(packet) for packet in packets])
    if list(contents) != list(range(len(sets))):
        raise ConformanceFailure(where, f"the frames {list(contents)}", f"0 to {len(sets) - 1}")
    return list(contents.values())


def empty_sets_are_sets(codec_class: Any, params: Params, films: Sequence[Film]) -> None:
    """Code empty sets, first and between others, and of one pixel: they decode as empty sets."""
    codec = codec_class(params)
    for film in films:
        sets = [codec.extract(picture) for picture in film.pictures[:_FEW]]
        nothing = Features.none(sets[0].size)
        between = [nothing, sets[0], nothing, *sets[1:], nothing, nothing]
        for pushed in (between, [Features.none((1, 1))]):
            where = f"decoding {film.name} with empty sets between" if len(pushed) > 1 else "an empty set of one pixel"
            for index, decoded in enumerate(_decoded_sets(codec, pushed, where)):
                if len(decoded) and not len(pushed[index]):
                    raise ConformanceFailure(f"{where}, set {index}", f"{len(decoded)} features", "none")


def large_sets_are_coded_or_refused(codec_class: Any, params: Params, films: Sequence[Film]) -> None:
    """Push sets with very many features, a huge image or a high level: they are coded whole, or raise ValueError.

    A session that refuses one continues as if it had not been pushed.
    """
    codec, rng = codec_class(params), np.random.default_rng(2)
    first, second = (codec.extract(picture) for picture in films[0].pictures[:2])
    few = _random_features(rng, _FEW, first.size)
    unusual = {
        f"{_MANY} features": _random_features(rng, _MANY, first.size),
        "an image of 2^20 x 2^20": replace(few, size=(1 << 20, 1 << 20)),
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
        decoded = whole_contents(name, [decoder.push(packet) for packet in packets])[1]
        if len(decoded) != len(features) or decoded.size != features.size:
            got = f"{len(decoded)} features of {decoded.size[0]}x{decoded.size[1]}"
            raise ConformanceFailure(name, got, "all of them, or a ValueError when they are pushed")


def _random_features(rng: np.random.Generator, count: int, size: tuple[int, int]) -> Features:
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
    for film, expected in encode_films(codec, films):
        copies = [picture.copy() for picture in film.pictures]
        packets_of(codec, copies)
        for index, (picture, before) in enumerate(zip(copies, film.pictures, strict=True)):
            require_same(f"frame {index} of {film.name} after it was pushed", picture, before)
            picture.flags.writeable = False
        require_same_packets(f"{film.name}, read-only", packets_of(codec, copies), expected)
        strided = [np.repeat(picture, 2, axis=1)[:, ::2] for picture in film.pictures]
        require_same_packets(f"{film.name}, strided views", packets_of(codec, strided), expected)
        buffer = np.empty_like(copies[0])
        session, packets = codec.open_encoder(FRAME_RATE_HZ), []
        for picture in copies:
            buffer[:] = picture
            packets += session.push(buffer)
        require_same_packets(f"{film.name}, pushed from one buffer", packets + session.flush(), expected)


def sessions_repeat(codec_class: CodecClass, params: Params, films: Sequence[Film]) -> None:
    """Encode and decode again by the same instance in another order, and by another instance."""
    codec = codec_class(params)
    first = [(film, packets, decoded_of(codec, packets)) for film, packets in encode_films(codec, films)]
    for film, packets, decoded in reversed(first):
        require_same_packets(f"{film.name} again", packets_of(codec, film.pictures), packets)
        new = packets_of(codec_class(params), film.pictures)
        require_same_packets(f"{film.name} by a new instance", new, packets)
        require_same_contents(f"decoding {film.name} again", decoded_of(codec, packets), decoded)


def sessions_do_not_interfere(codec_class: CodecClass, params: Params, films: Sequence[Film]) -> None:
    """Code two films at once, frame by frame in turn: each gives what it gives alone."""
    codec = codec_class(params)
    alone = [packets_of(codec, film.pictures) for film in films]
    together = _run_in_turn([codec.open_encoder(FRAME_RATE_HZ) for _ in films], [film.pictures for film in films])
    results = _run_in_turn([codec.open_decoder() for _ in films], alone)
    for film, packets, got, decoded in zip(films, alone, together, results, strict=True):
        require_same_packets(f"{film.name} interleaved with another session", got, packets)
        where = f"decoding {film.name} interleaved with another session"
        require_same_contents(where, decoded, decoded_of(codec, packets))


def _run_in_turn(sessions: Sequence[Any], inputs: Sequence[Sequence[Any]]) -> list[list[Any]]:
    """Push the inputs of several sessions in turn; return the outputs of each."""
    outputs: list[list[Any]] = [[] for _ in sessions]
    for turn in zip_longest(*inputs):
        for session, pushed, output in zip(sessions, turn, outputs, strict=True):
            output += [] if pushed is None else session.push(pushed)
    for session, output in zip(sessions, outputs, strict=True):
        output += session.flush()
    return outputs


def preparing_changes_nothing(codec_class: Any, params: Params, films: Sequence[Film]) -> None:
    """Check that an instance prepared for an image writes the same bytes, and that its original does not change."""
    codec = codec_class(params)
    unprepared = list(encode_films(codec, films))
    instances = [codec.prepared(film.pictures[0]) for film, _ in unprepared]
    for prepared, (film, packets) in zip(instances, unprepared, strict=True):
        if type(prepared) is not codec_class or prepared.params != params:
            expected = f"{codec_class.__name__} of the same parameters"
            raise ConformanceFailure(f"prepared({film.name})", prepared, expected)
        require_same_packets(f"prepared({film.name}) encoding it", packets_of(prepared, film.pictures), packets)
        require_same_packets(f"{film.name} after prepared({film.name})", packets_of(codec, film.pictures), packets)


def one_in_gives_one_out(codec_class: CodecClass, params: Params, films: Sequence[Film]) -> None:
    codec = codec_class(params)
    if not codec.is_low_delay():
        raise NotClaimed("this setting does not claim low delay")
    for film in (*films, long_sequence(layout_of(films[0].pictures[0]))):
        encoder, decoder = codec.open_encoder(FRAME_RATE_HZ), codec.open_decoder()
        for frame, picture in enumerate(film.pictures):
            where = f"{film.name}, push of frame {frame}"
            packets = encoder.push(picture)
            if [packet.frame for packet in packets] != [frame]:
                raise ConformanceFailure(where, f"packets of {[packet.frame for packet in packets]}", "its packet")
            pictures = decoder.push(packets[0])
            if [result.frame for result in pictures] != [frame]:
                raise ConformanceFailure(f"{where}'s packet", f"{len(pictures)} frames", "its frame at once")
        if encoder.flush() or decoder.flush():
            raise ConformanceFailure(f"{film.name}, flush", "more", "nothing: no frame may be held back")


def what_was_sent_is_final(codec_class: CodecClass, params: Params, films: Sequence[Film]) -> None:
    """Check that sent packets do not depend on later frames, not even on those next to them in memory."""
    layout = layout_of(films[0].pictures[0])
    futures = [(*pair, _SHARED) for pair in zip(films, moving_pictures(layout, seed=2), strict=True)]
    for film, other, shared in [*futures, (long_sequence(layout), long_sequence(layout, 4), _SHARED_OF_LONG)]:
        original = np.stack(film.pictures)
        variant = np.stack([*film.pictures[:shared], *other.pictures[shared:]])
        left, right = (
            _packets_sent_early(codec_class(params), list(pictures), shared) for pictures in (original, variant)
        )
        require_same_packets(f"{film.name} with other later frames", left, right)


def _packets_sent_early(codec: AnyCodec[Any], pictures: Sequence[Image], first: int) -> list[Packet]:
    """Return the packets that left with the `first` frames. Fails if they changed by the end of the session."""
    session = codec.open_encoder(FRAME_RATE_HZ)
    packets = [packet for picture in pictures[:first] for packet in session.push(picture)]
    sent = [replace(packet, data=bytes(packet.data)) for packet in packets]
    for picture in pictures[first:]:
        session.push(picture)
    session.flush()
    require_same_packets("packets after later frames", packets, sent)
    return sent


def lossless_means_lossless(codec_class: Any, params: Params, films: Sequence[Film]) -> None:
    codec = codec_class(params)
    if not codec.is_lossless():
        raise NotClaimed("this setting does not claim to be lossless")
    for film, packets in encode_films(codec, films):
        where = f"decoding {film.name} of a lossless setting"
        contents = whole_contents(where, decoded_of(codec, packets))
        for frame, picture in enumerate(film.pictures):
            if codec_class.carries == "features":
                _require_same_unordered(f"{where}, frame {frame}", contents[frame], codec.extract(picture))
            else:
                require_same(f"{where}, frame {frame}", contents[frame], picture)


def _require_same_unordered(where: str, got: Features, expected: Features) -> None:
    """Fail unless two sets are equal in any order, with angles within the tolerance."""
    if len(got) != len(expected):
        raise ConformanceFailure(where, f"{len(got)} features", f"{len(expected)}")
    got, expected = _sorted_features(got), _sorted_features(expected)
    for name in ("pixels", "octaves", "descriptors"):
        if not np.array_equal(getattr(got, name), getattr(expected, name)):
            raise ConformanceFailure(where, f"other {name}", "those extracted")
    turn = np.abs(np.angle(np.exp(1j * (got.angles - expected.angles)))).max(initial=0.0)
    if turn > ANGLE_TOLERANCE_RAD:
        raise ConformanceFailure(where, f"an angle that is {turn:.2g} rad off", f"at most {ANGLE_TOLERANCE_RAD:.0e}")


def _sorted_features(features: Features) -> Features:
    """Sort features by all that lossless coding reproduces to the bit."""
    order = np.lexsort(np.column_stack([features.descriptors, features.pixels, features.octaves]).T)
    return replace(features, **{name: getattr(features, name)[order] for name in FEATURE_ARRAYS})


def samples_stop_at_black_and_white(codec_class: CodecClass, params: Params, films: Sequence[Film]) -> None:
    """Check that no decoded sample wraps around to the other end of the range."""
    codec = codec_class(params)
    for film, packets in encode_films(codec, saturated_images(layout_of(films[0].pictures[0]))):
        original = film.pictures[0]
        decoded = whole_contents(f"decoding {film.name}", decoded_of(codec, packets))[0]
        if decoded.shape != original.shape:  # converted to gray, which check `shape` allows if a parameter asks for it
            continue
        wrapped = _wrapped_samples(decoded.astype(np.int32), original.astype(np.int32), np.iinfo(original.dtype).max)
        if wrapped.any():
            index = tuple(int(i) for i in np.argwhere(wrapped)[0])
            got = f"{decoded[index]} at {index}, far from its neighbor; {np.count_nonzero(wrapped)} such samples"
            raise ConformanceFailure(f"decoding {film.name}", got, f"about {original[index]}")


def _wrapped_samples(decoded: Any, original: Any, white: int) -> Any:
    """Mark samples at the wrong end of the range next to one that is not, where the original has no edge.

    An error alone proves nothing: a coarse setting may smear black over white, but smoothly.
    """
    across = _ACROSS * (white // 255)
    wrong = np.abs(decoded - original) > across
    beside = np.zeros_like(wrong)
    for axis in (0, 1):
        flat = np.diff(original, axis=axis) == 0
        flat = flat if flat.ndim == 2 else flat.all(axis=2, keepdims=True)  # color converted to gray mixes its channels
        jump = (np.abs(np.diff(decoded, axis=axis)) > across) & flat
        before, after = np.zeros_like(wrong), np.zeros_like(wrong)
        np.moveaxis(before, axis, 0)[:-1] = np.moveaxis(jump, axis, 0)
        np.moveaxis(after, axis, 0)[1:] = np.moveaxis(jump, axis, 0)
        beside |= before | after
    return wrong & beside


def bad_images_are_refused(codec_class: CodecClass, params: Params, films: Sequence[Film]) -> None:
    """Push bad images as the first frame of a session; for inter-frame codecs also after one of another shape."""
    for name, pictures in _bad_images(codec_class(params), films[0].pictures[0]):
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


def _bad_images(codec: AnyCodec[Any], image: Image) -> Iterator[tuple[str, list[Any]]]:
    """Yield names and frames to push, of which the last must be refused. image: a valid one."""
    yield "16-bit color", [np.zeros((8, 8, 3), np.uint16)]
    yield "float64", [np.zeros((8, 8))]
    yield "bool", [np.zeros((8, 8), np.bool_)]
    yield "four channels", [np.zeros((8, 8, 4), np.uint8)]
    yield "two channels", [np.zeros((8, 8, 2), np.uint8)]
    yield "one dimension", [np.zeros(8, np.uint8)]
    yield "no rows", [np.zeros((0, 8), np.uint8)]
    yield "no columns", [np.zeros((8, 0, 3), np.uint8)]
    yield "a list", [[[0, 1], [2, 3]]]
    taken = codec.capabilities.layouts
    for layout in LAYOUTS:
        if layout not in taken:
            shape = (8, 8) if layout.channels == 1 else (8, 8, 3)
            yield f"{layout}, not in capabilities", [np.zeros(shape, f"uint{layout.bits}")]
    if codec.carries == "pictures" and not codec.stateless:
        yield "another size", [image, np.ascontiguousarray(image[:-2])]
        gray_or_color = image[..., None].repeat(3, axis=2) if image.ndim == 2 else np.ascontiguousarray(image[..., 0])
        yield "another layout", [image, gray_or_color]
        yield "other bits", [image, image.astype(np.uint16 if image.dtype == np.uint8 else np.uint8)]


def another_process_encodes_alike(codec_class: CodecClass, params: Params, films: Sequence[Film]) -> None:
    for film, packets in encode_films(codec_class(params), films):
        where = f"encoding {film.name} in another process"
        encoded = run_elsewhere("encode", where, _encode, codec_class, params, film.pictures)
        require_same_packets(where, encoded, packets)


def packets_alone_decode(codec_class: CodecClass, params: Params, films: Sequence[Film]) -> None:
    """Decode copies of the packets in a process that encoded nothing, by instances of other settings."""
    codec = codec_class(params)
    for film, packets in encode_films(codec, films):
        copies = [replace(packet, data=bytes(bytearray(packet.data))) for packet in packets]
        expected = decoded_of(codec, packets)
        for other in [params, *other_settings(params)]:
            where = f"decoding {film.name} in another process, by the setting {other}"
            require_same_contents(where, run_elsewhere("decode", where, _decode, codec_class, other, copies), expected)


def _encode(codec_class: CodecClass, params: Params, pictures: Sequence[Image]) -> list[Packet]:
    return packets_of(codec_class(params), pictures)


def _decode(codec_class: CodecClass, params: Params, packets: Sequence[Packet]) -> list[Decoded]:
    return decoded_of(codec_class(params), packets)


def threads_do_not_interfere(codec_class: CodecClass, params: Params, films: Sequence[Film]) -> None:
    """Run sessions of one instance in several threads at once: each gives what it gives alone."""
    if not codec_class.capabilities.thread_safe:
        raise NotClaimed("this codec does not claim to be thread-safe")
    codec = codec_class(params)
    alone = [(film, packets, decoded_of(codec, packets)) for film, packets in encode_films(codec, films)]

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
    """Check that counting runs give the bytes and pixels of fast ones, and repeatable counts, or none if opaque."""
    codec = codec_class(params)
    claims = codec_class.capabilities.counts_operations
    for film, packets in encode_films(codec, films if codec_class.stateless else films[-1:]):
        where = f"{film.name}, counting"
        encoding, decoding, again = CountingTrace(), CountingTrace(), CountingTrace()
        require_same_packets(where, packets_of(codec, film.pictures, encoding), packets)
        require_same_contents(where, decoded_of(codec, packets, decoding), decoded_of(codec, packets))
        for trace in (encoding, decoding):
            if bool(trace.counts) != claims:
                expected = "counts of every stage" if claims else "none: the codec declares counts_operations=False"
                raise ConformanceFailure(where, f"stages {list(trace.counts)}", expected)
        packets_of(codec, film.pictures, again)
        if again.counts != encoding.counts:
            raise ConformanceFailure(f"{where} twice", "other counts", "equal counts")
