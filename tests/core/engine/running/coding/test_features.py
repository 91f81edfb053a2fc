"""Codecs of features: sets found again by frame, what encoders and decoders may return, and who asks for pictures."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from io import BytesIO
from typing import Any

import numpy as np
import pytest
from bitstream_files import JOB
from broken_features import Broken, CountsFromOne
from codecbench_corners.codec import Corners, CornersDecoder
from feature_streams import PICTURES, coded_features
from memory_sequence import FunctionCodec, MemorySequence

from codecbench import Features, FeatureSet, Unsupported, decoder_of, encoder_of
from codecbench.core.contracts.codec import gets_features
from codecbench.core.engine.running.coding.coded_frames import CodedFrames
from codecbench.core.engine.running.coding.position import CodingError, WorkPosition
from codecbench.core.engine.storage.bitstream_file import BitstreamDamage, BitstreamFile, write_bitstreams


def test_features_are_found_by_frame_in_any_order() -> None:
    codec = Corners.create(gop=3)
    found = coded_features(codec)
    expected = [codec.extract(picture) for picture in PICTURES]
    for index in (0, 1, 2, 7, 4, 4, 5, 0, 3):
        assert np.array_equal(found.features(index).descriptors, expected[index].descriptors)
        assert np.array_equal(found.features(index).pixels, expected[index].pixels)
    with pytest.raises(IndexError):
        found.features(len(PICTURES))


def test_packets_tell_starts_and_sizes() -> None:
    found = coded_features(Corners.create(gop=3))
    assert [packet.starts for packet in found.packets] == [True, False, False] * 2 + [True, False]
    assert [packet.after for packet in found.packets] == list(range(1, len(PICTURES) + 1))
    assert [found.size_bytes(packet.frame) for packet in found.packets] == [one.size_bytes for one in found.packets]
    assert found.notes == ()


def test_who_asks_in_order_has_each_packet_decoded_once() -> None:
    pushed: Counter[int] = Counter()

    class Counted(Broken):
        class Decoding(CornersDecoder):
            def push(self, packet: Any) -> FeatureSet:
                pushed[packet.frame] += 1
                return super().push(packet)

    found = coded_features(Counted.create(gop=4))
    for index in range(len(PICTURES)):
        found.features(index)
    assert pushed == Counter(range(len(PICTURES)))
    found.features(6)
    assert pushed[4] == pushed[5] == pushed[6] == 2
    assert pushed[7] == 1


def test_who_asks_for_a_picture_is_told_what_to_do() -> None:
    codec, page = Corners.create(), "docs/pictures-or-features.md"
    found = coded_features(codec)
    for asked in (
        lambda: found.frame(0),
        lambda: list(found),
        found.sender,
        lambda: codec.encode(PICTURES[0]),
        lambda: codec.decode(b""),
        lambda: decoder_of(codec),
    ):
        with pytest.raises(Unsupported, match=f"corners sends features.*{page}"):
            asked()


def test_who_asks_a_codec_of_pictures_for_features_is_told_what_to_do() -> None:
    codec = FunctionCodec()
    stream = BytesIO()
    write_bitstreams(stream, [b"x"] * len(PICTURES), JOB)
    found = CodedFrames(MemorySequence(PICTURES), codec, BitstreamFile(stream.getvalue(), JOB), WorkPosition())
    for asked in (lambda: found.features(0), lambda: gets_features(codec, "features")):
        with pytest.raises(Unsupported, match="function sends frames"):
            asked()
    assert not gets_features(codec, "cta")
    assert gets_features(Corners.create(), "cta")
    with pytest.raises(BitstreamDamage, match="single frames"):
        CodedFrames(MemorySequence(PICTURES), Corners.create(), BitstreamFile(stream.getvalue(), JOB), WorkPosition())


def test_a_session_of_a_device_extracts_and_encodes() -> None:
    codec = Corners.create()
    session, own = encoder_of(codec, 30.0), codec.encoder()
    assert [session.push(picture) for picture in PICTURES[:3]] == [
        [own.push(codec.extract(picture))] for picture in PICTURES[:3]
    ]
    assert session.flush() == []


def test_a_packet_of_another_frame_is_refused() -> None:
    with pytest.raises(CodingError, match="frame 1; 0 to 0"):
        coded_features(CountsFromOne.create())


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (lambda found: None, "returned NoneType; .*FeatureSet"),
        (lambda found: replace(found, frame=found.frame + 1), "frame 2 .*frame 1"),
        (lambda found: FeatureSet(found.frame, None), "frame 1 as missing"),
        (lambda found: FeatureSet(found.frame, [1, 2]), "returned list; .*Features"),
    ],
)
def test_what_a_decoder_returns_is_checked(answer: Any, words: str) -> None:
    class Odd(Broken):
        class Decoding(CornersDecoder):
            def push(self, packet: Any) -> FeatureSet:
                found = super().push(packet)
                return answer(found) if packet.frame == 1 else found

    found = coded_features(Odd.create())
    with pytest.raises(CodingError, match=words):
        found.features(1)
    assert len(found.features(0)) > 0


def test_what_a_set_may_be() -> None:
    good = Corners.create().extract(PICTURES[0])
    assert len(Features.none((5, 3))) == 0
    for changes, words in (
        ({"pixels": good.pixels.astype(np.float32)}, r"pixels are float32 .*float64 \(\d+, 2\)"),
        ({"octaves": good.octaves[:-1]}, "octaves are int32"),
        ({"descriptors": good.descriptors[:, :31]}, "descriptors are uint8"),
        ({"responses": None}, "responses are NoneType"),
        ({"size": (0, 5)}, "width and height"),
        ({"size": (40, 40)}, "outside the image of 40x40"),
        ({"pixels": np.full_like(good.pixels, np.nan)}, "outside the image"),
        ({"angles": np.full_like(good.angles, np.inf)}, "not finite"),
        ({"octaves": good.octaves - np.int32(1)}, "below 0"),
    ):
        with pytest.raises(ValueError, match=words):
            replace(good, **changes)
