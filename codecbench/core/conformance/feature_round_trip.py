"""Checks of what a codec of features finds, sends and gives back, in this process."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from codecbench.core.conformance.failure import ConformanceFailure, NotClaimed
from codecbench.core.conformance.moving_pictures import MovingPictures
from codecbench.core.conformance.round_trip import require_equal
from codecbench.core.contracts.codec import FeatureCodec
from codecbench.core.contracts.errors import ImageError
from codecbench.core.contracts.features import ANGLE_TOLERANCE_RAD, Features, FeatureSet
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.params import Params
from codecbench.core.contracts.stream import Loss, Packet

FeatureClass = type[FeatureCodec[Any]]
_ARRAYS = ("pixels", "octaves", "angles", "responses", "descriptors")
_FEW = 3
_MANY = 70_000
"""More than any device finds, and more than 16 bits count."""


def sets_of(codec: FeatureCodec[Any], pictures: Sequence[Image]) -> list[Features]:
    """What is found in each."""
    return [codec.extract(picture) for picture in pictures]


def packets_of(codec: FeatureCodec[Any], sets: Sequence[Features]) -> list[Packet]:
    """The packets of a session."""
    session = codec.encoder()
    return [session.push(features) for features in sets]


def decoded_of(codec: FeatureCodec[Any], packets: Sequence[Packet | Loss]) -> list[FeatureSet]:
    """The sets of a session."""
    session = codec.decoder()
    return [session.push(packet) for packet in packets]


def whole_sets(where: str, found: Sequence[FeatureSet]) -> list[Features]:
    """The features of sets of which none was lost. Fails where one is missing, or of another frame."""
    for index, one in enumerate(found):
        if type(one) is not FeatureSet or one.frame != index:
            got = f"{type(one).__name__} of frame {getattr(one, 'frame', None)}"
            raise ConformanceFailure(where, got, f"the FeatureSet of frame {index}")
        if type(one.features) is not Features:
            got = "no features" if one.features is None else type(one.features).__name__
            raise ConformanceFailure(f"{where}, frame {index}", got, "Features, for nothing was lost")
    return [one.features for one in found if one.features is not None]


def require_same_features(where: str, got: Features, expected: Features) -> None:
    """Fail unless two sets are the same to the bit, in order."""
    if got.size != expected.size or len(got) != len(expected):
        counts = [f"{len(one)} features of {one.size[0]}x{one.size[1]}" for one in (got, expected)]
        raise ConformanceFailure(where, *counts)
    for name in _ARRAYS:
        if not np.array_equal(getattr(got, name), getattr(expected, name), equal_nan=name != "descriptors"):
            raise ConformanceFailure(where, f"other {name}", "the same features")


def require_same_packets(where: str, got: Sequence[Packet], expected: Sequence[Packet]) -> None:
    """Fail unless two sessions gave the same packets."""
    for index, (left, right) in enumerate(zip(got, expected, strict=True)):
        if left != right:
            what = "other bytes" if left.data != right.data else f"frame {left.frame}, starts={left.starts}"
            raise ConformanceFailure(f"{where}, packet {index}", what, "the same packet")


def features_are_of_the_picture(codec_class: FeatureClass, params: Params, sequences: Sequence[MovingPictures]) -> None:
    """Sets are valid, of the picture's size, the same again, and not all empty; the picture is left alone."""
    codec, count = codec_class(params), 0
    for sequence in sequences:
        for index, picture in enumerate(sequence.pictures):
            where, before = f"extracting from picture {index} of {sequence.name}", picture.copy()
            found = codec.extract(picture)
            if type(found) is not Features:
                raise ConformanceFailure(where, type(found).__name__, "Features")
            if found.size != (picture.shape[1], picture.shape[0]):
                raise ConformanceFailure(where, f"size {found.size}", "width and height of the picture")
            require_equal(f"{where}, the picture afterwards", picture, before)
            require_same_features(f"{where} again", codec.extract(picture), found)
            require_same_features(f"{where}, by a new instance", codec_class(params).extract(picture), found)
            count += len(found)
    if not count:
        raise ConformanceFailure("extracting from all pictures", "no feature", "some: they are full of corners")


def packets_are_bytes(codec_class: FeatureClass, params: Params, sequences: Sequence[MovingPictures]) -> None:
    codec = codec_class(params)
    for sequence in sequences:
        for index, packet in enumerate(packets_of(codec, sets_of(codec, sequence.pictures))):
            where = f"encoding {sequence.name}, set {index}"
            if type(packet) is not Packet:
                raise ConformanceFailure(where, type(packet).__name__, "a Packet, of which all that counts is `data`")
            if type(packet.data) is not bytes or not packet.data:
                raise ConformanceFailure(where, f"{type(packet.data).__name__} {packet.data!r:.40}", "bytes")
            if type(packet.frame) is not int or packet.frame != index:
                raise ConformanceFailure(where, f"frame {packet.frame!r}", f"frame {index}")
            if type(packet.starts) is not bool or not (packet.starts or index):
                raise ConformanceFailure(where, f"starts={packet.starts!r}", "a bool, and True of the first packet")


def sets_come_back(codec_class: FeatureClass, params: Params, sequences: Sequence[MovingPictures]) -> None:
    """Every packet gives the set of its frame, of the picture's size; the set that was pushed is left alone."""
    codec = codec_class(params)
    for sequence in sequences:
        sets = sets_of(codec, sequence.pictures)
        kept = [replace(one, **{name: getattr(one, name).copy() for name in _ARRAYS}) for one in sets]
        packets = packets_of(codec, sets)
        for index, (one, before) in enumerate(zip(sets, kept, strict=True)):
            require_same_features(f"set {index} of {sequence.name} after it was pushed", one, before)
        for index, back in enumerate(whole_sets(f"decoding {sequence.name}", decoded_of(codec, packets))):
            if back.size != sets[index].size:
                raise ConformanceFailure(f"decoding {sequence.name}, frame {index}", f"size {back.size}", "its own")


def lossless_means_lossless(codec_class: FeatureClass, params: Params, sequences: Sequence[MovingPictures]) -> None:
    codec = codec_class(params)
    if not codec.is_lossless():
        raise NotClaimed("this setting does not claim to be lossless")
    for sequence in sequences:
        sets = sets_of(codec, sequence.pictures)
        where = f"decoding {sequence.name} of a lossless setting"
        for index, back in enumerate(whole_sets(where, decoded_of(codec, packets_of(codec, sets)))):
            _require_as_good(f"{where}, frame {index}", back, sets[index])


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
    keys = np.column_stack([one.descriptors, one.pixels, one.octaves])
    order = np.lexsort(keys.T)
    return replace(one, **{name: getattr(one, name)[order] for name in _ARRAYS})


def empty_sets_are_sets(codec_class: FeatureClass, params: Params, sequences: Sequence[MovingPictures]) -> None:
    """Pictures without a corner, first and between others, and one pixel: nothing is found, sent and received."""
    codec = codec_class(params)
    for sequence in sequences:
        sets = sets_of(codec, sequence.pictures[:_FEW])
        nothing = Features.none(sets[0].size)
        pushed = [nothing, sets[0], nothing, *sets[1:], nothing, nothing]
        where = f"decoding {sequence.name} with empty sets between"
        for index, back in enumerate(whole_sets(where, decoded_of(codec, packets_of(codec, pushed)))):
            if len(back) and not len(pushed[index]):
                raise ConformanceFailure(f"{where}, set {index}", f"{len(back)} features", "none")
        alone = whole_sets("an empty set of one pixel", decoded_of(codec, packets_of(codec, [Features.none((1, 1))])))
        if len(alone[0]):
            raise ConformanceFailure("an empty set of one pixel", f"{len(alone[0])} features", "none")


def limits_are_kept(codec_class: FeatureClass, params: Params, sequences: Sequence[MovingPictures]) -> None:
    """Sets of very many features, of a huge image, of a high level: coded and decoded whole, or refused by ValueError.

    A session that refused one goes on as if it had not been there.
    """
    codec = codec_class(params)
    for sequence in sequences[:1]:
        sets = sets_of(codec, sequence.pictures[:2])
        rng = np.random.default_rng(2)
        many = _drawn(rng, _MANY, sets[0].size)
        few = _drawn(rng, _FEW, sets[0].size)
        unusual = {
            f"{_MANY} features": many,
            "an image of 2^20 a side": replace(few, size=(1 << 20, 1 << 20)),
            "level 40": replace(few, octaves=np.full(_FEW, 40, np.int32)),
        }
        expected = packets_of(codec, sets)
        for name, features in unusual.items():
            session = codec.encoder()
            first = session.push(sets[0])
            try:
                packet = session.push(features)
            except ValueError:
                require_same_packets(f"after {name} was refused", [first, session.push(sets[1])], expected)
                continue
            back = whole_sets(name, decoded_of(codec, [first, packet]))[1]
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


def bad_images_are_refused(codec_class: FeatureClass, params: Params, sequences: Sequence[MovingPictures]) -> None:
    codec = codec_class(params)
    bad: dict[str, Any] = {
        "uint16": np.zeros((8, 8), np.uint16),
        "float64": np.zeros((8, 8)),
        "four channels": np.zeros((8, 8, 4), np.uint8),
        "no rows": np.zeros((0, 8), np.uint8),
        "a list": [[0, 1], [2, 3]],
    }
    if 1 not in codec_class.capabilities.channels:
        bad["gray, not declared"] = np.zeros((8, 8), np.uint8)
    if 3 not in codec_class.capabilities.channels:
        bad["colour, not declared"] = np.zeros((8, 8, 3), np.uint8)
    for name, image in bad.items():
        where = f"extracting from {name}"
        try:
            found = codec.extract(image)
        except ImageError:
            continue
        except Exception as error:
            raise ConformanceFailure(where, f"{type(error).__name__}: {error}", "ImageError") from error
        raise ConformanceFailure(where, f"{len(found)} features", "ImageError")
