"""The multi-level codec with a memory: the pictures of `multilevel`, tables that build on one another, losses."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from video_pictures import gliding_pictures

from codecbench import LOST, BitstreamError, ImageError
from codecbench.core.conformance.harness import decoded_of, packets_of
from codecbench.plugins.codecs.multilevel.codec import Multilevel
from codecbench.plugins.codecs.multilevel.stream import Memory, MultilevelStream

SETTINGS: list[dict[str, Any]] = [
    {},
    {"qf": 20, "color": "ycbcr420", "group": 2},
    {"qf": 75, "scan": "coefficient", "color": "gray"},
    {"qf": 0.5, "group": 4},
]


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("setting", SETTINGS, ids=str)
def test_pictures_are_those_of_the_codec_without_memory(setting: dict[str, Any], channels: int) -> None:
    pictures = gliding_pictures(7, 40, 56, channels)
    stream, still = MultilevelStream.create(gop=5, **setting), Multilevel.create(**setting)
    packets = packets_of(stream, pictures)
    assert [packet.starts for packet in packets] == [True, False, False, False, False, True, False]
    assert packets[0].data == still.encode(pictures[0])
    for shown, picture in zip(decoded_of(MultilevelStream.create(), packets), pictures, strict=True):
        assert shown.state == "whole"
        assert np.array_equal(shown.image, still.decode(still.encode(picture)))


def test_a_still_scene_sends_no_table() -> None:
    """All entries are kept with their counts, so what is left of the table is next to nothing."""
    picture = gliding_pictures(1, 96, 128, 1)[0]
    packets = packets_of(MultilevelStream.create(), [picture] * 3)
    saved_bits = 8 * (len(packets[0].data) - len(packets[1].data))
    entries = len(Memory.after_keyframe(packets[0].data).counts)
    assert packets[1].data[:-4] == packets[2].data[:-4]
    assert saved_bits > 6 * entries, "an entry costs some bits, which the second picture does not pay"


def test_memory_after_a_packet_is_that_of_the_encoder() -> None:
    pictures = gliding_pictures(4, 64, 80, 3)
    packets = packets_of(MultilevelStream.create(qf=10), pictures)
    memory = Memory.after_keyframe(packets[0].data)
    for packet, picture in zip(packets[1:], pictures[1:], strict=True):
        memory, _ = memory.decode(packet.data)
        alone = Memory.after_keyframe(Multilevel.create(qf=10).encode(picture))
        assert np.array_equal(memory.tuples, alone.tuples)
        assert np.array_equal(memory.counts, alone.counts)


def test_pictures_are_missing_from_a_loss_to_the_next_start() -> None:
    packets = packets_of(MultilevelStream.create(gop=4), gliding_pictures(10, 40, 56, 1))
    whole = decoded_of(MultilevelStream.create(), packets)
    for lost in range(10):
        pictures = decoded_of(MultilevelStream.create(), [*packets[:lost], LOST, *packets[lost + 1 :]])
        gone = set(range(lost, min(lost // 4 * 4 + 4, 10)))
        assert [picture.frame for picture in pictures] == list(range(10))
        assert {picture.frame for picture in pictures if picture.state == "missing"} == gone
        for picture in pictures:
            assert picture.image is None or np.array_equal(picture.image, whole[picture.frame].image)


def test_each_packet_of_sixty_frames_may_be_lost() -> None:
    codec = MultilevelStream.create(gop=15)
    packets = packets_of(codec, gliding_pictures(60, 40, 56, 1))
    for lost in range(60):
        pictures = decoded_of(codec, [*packets[:lost], LOST, *packets[lost + 1 :]])
        restart = (lost // 15 + 1) * 15
        assert [picture.frame for picture in pictures] == list(range(60))
        assert [picture.frame for picture in pictures if picture.state != "whole"] == list(range(lost, restart))


def test_a_packet_does_not_decode_on_another_memory() -> None:
    """Even if the decoder was not informed of the loss."""
    packets = packets_of(MultilevelStream.create(), gliding_pictures(4, 40, 56, 1))
    decoder = MultilevelStream.create().decoder()
    decoder.push(packets[0])
    with pytest.raises(BitstreamError, match="does not follow"):
        decoder.push(packets[2])


def test_no_damage_goes_unnoticed() -> None:
    packets = packets_of(MultilevelStream.create(), gliding_pictures(2, 24, 32, 1))
    rng = np.random.default_rng(5)
    for _ in range(200):
        damaged = bytearray(packets[1].data)
        damaged[int(rng.integers(len(damaged)))] ^= 1 << int(rng.integers(8))
        decoder = MultilevelStream.create().decoder()
        decoder.push(packets[0])
        with pytest.raises(BitstreamError):
            decoder.push(dataclasses.replace(packets[1], data=bytes(damaged)))


def test_a_picture_of_another_shape_is_refused() -> None:
    encoder = MultilevelStream.create().encoder(30)
    encoder.push(gliding_pictures(1, 40, 56, 1)[0])
    with pytest.raises(ImageError, match=r"\(40, 48\) .* stream .*\(40, 56\)"):
        encoder.push(gliding_pictures(1, 40, 48, 1)[0])
