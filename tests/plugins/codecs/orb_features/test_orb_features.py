"""Keypoints come back from their packets: whole where nothing is dropped, near where something is, never wrong."""

from __future__ import annotations

import hashlib
import struct
import time
import zlib
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from damage import damaged_copies
from numpy.typing import NDArray
from pydantic import ValidationError
from rendered_scenes import CAMERA, Room, path_pose

from codecbench.core.contracts.errors import BitstreamError
from codecbench.core.contracts.features import Features
from codecbench.core.contracts.stream import LOST, Packet
from codecbench.plugins.codecs.orb_features.codec import COPIED_BITS, OrbFeatures
from codecbench.plugins.codecs.orb_features.prediction import (
    BIASES,
    BITS,
    BLOCK,
    CHANCES,
    LOWEST_CHANCE,
    NIBBLES,
    STEP_SHIFT,
    STEPS,
    WEIGHTS,
)
from codecbench.plugins.codecs.orb_features.train_prediction import train
from codecbench.plugins.slam_backends.keypoints import keypoints_of
from codecbench.slam import Options, System
from codecbench.slam.features.extractor import level_sizes

FRAMES = 6
SETTINGS: tuple[dict[str, Any], ...] = (
    {},
    {"mode": "inter", "gop": 4},
    {"descriptor": "raw", "angle_bits": 1},
    {"descriptor": "raw", "mode": "inter"},
    {"descriptor": "lossy", "mode": "inter", "position_step_px": 3, "angle_bits": 8},
    {"descriptor": "lossy"},
)


@pytest.fixture(scope="module")
def film() -> list[Features]:
    room, codec = Room(), OrbFeatures.create(features=300)
    return [codec.extract(room.image(path_pose(i))) for i in range(FRAMES)]


def packets_of(film: list[Features], **setting: Any) -> list[Packet]:
    encoder = OrbFeatures.create(**setting).encoder()
    return [encoder.push(found) for found in film]


def decoded(packets: list[Packet]) -> list[Features]:
    decoder = OrbFeatures.create().decoder()
    found = [decoder.push(packet).features for packet in packets]
    assert all(features is not None for features in found)
    return [features for features in found if features is not None]


def turns(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """How far two angles are apart, in turns."""
    apart = (a - b) / (2.0 * np.pi)
    return np.abs(apart - np.rint(apart))


@pytest.mark.parametrize("setting", [{}, {"mode": "inter", "gop": 4}, {"descriptor": "raw"}])
def test_all_that_is_not_rounded_comes_back_to_the_bit(film: list[Features], setting: dict[str, Any]) -> None:
    for found, back in zip(film, decoded(packets_of(film, **setting)), strict=True):
        assert back.size == found.size
        assert np.array_equal(back.pixels, found.pixels)
        assert np.array_equal(back.octaves, found.octaves)
        assert np.array_equal(back.descriptors, found.descriptors)
        assert turns(back.angles, found.angles).max() <= 0.5 / 2**30 + 1e-15
        assert back.pixels.dtype == found.pixels.dtype
        assert back.octaves.dtype == found.octaves.dtype


@pytest.mark.parametrize("mode", ["intra", "inter"])
def test_what_is_rounded_is_near(film: list[Features], mode: Any) -> None:
    setting = {"descriptor": "lossy", "mode": mode, "position_step_px": 4, "angle_bits": 6}
    copied = 0
    for found, back in zip(film, decoded(packets_of(film, **setting)), strict=True):
        assert len(back) == len(found)
        assert np.array_equal(np.bincount(back.octaves), np.bincount(found.octaves))
        scale = 1.2**7
        distances = np.abs(back.pixels[:, None] - found.pixels).max(axis=2)
        assert distances.min(axis=1).max() <= 2.0 * scale
        near = np.bitwise_count(back.descriptors[:, None] ^ found.descriptors).sum(axis=2).min(axis=1)
        assert near.max() <= COPIED_BITS
        copied += len(set(map(bytes, found.descriptors)) - set(map(bytes, back.descriptors)))
    assert copied > 0


def test_angles_keep_their_bits(film: list[Features]) -> None:
    for found, back in zip(film, decoded(packets_of(film, angle_bits=10)), strict=True):
        assert turns(back.angles, found.angles).max() <= 0.5 / 2**10 + 1e-12


def test_memory_saves_bytes_and_dropping_saves_more(film: list[Features]) -> None:
    settings = ({"descriptor": "raw"}, {}, {"mode": "inter"}, {"mode": "inter", "descriptor": "lossy"})
    sizes = [sum(len(packet.data) for packet in packets_of(film, **setting)) for setting in settings]
    assert all(after < 0.95 * before for before, after in pairwise(sizes))


def test_packets_repeat_and_leave_the_keypoints_alone(film: list[Features]) -> None:
    before = [hashlib.sha256(found.descriptors.tobytes() + found.pixels.tobytes()).digest() for found in film]
    for setting in SETTINGS:
        assert packets_of(film, **setting) == packets_of(film, **setting)
    after = [hashlib.sha256(found.descriptors.tobytes() + found.pixels.tobytes()).digest() for found in film]
    assert after == before


def test_sessions_side_by_side_do_not_touch_each_other(film: list[Features]) -> None:
    expected = packets_of(film, mode="inter")
    codec = OrbFeatures.create(mode="inter")
    one, other = codec.encoder(), codec.encoder()
    for found, another, packet in zip(film, reversed(film), expected, strict=True):
        assert one.push(found) == packet
        other.push(another)


def test_no_and_few_keypoints_are_sets_too() -> None:
    codec = OrbFeatures.create(mode="inter")
    encoder, decoder = codec.encoder(), codec.decoder()
    rng = np.random.default_rng(1)
    squares = np.kron(rng.integers(0, 2, (9, 9)), np.full((8, 8), 255)).astype(np.uint8)
    noise = rng.integers(0, 256, (240, 320)).astype(np.uint8)
    images = [np.zeros((240, 320), np.uint8), noise, np.zeros((5, 7, 3), np.uint8), squares]
    for image in images:
        found = codec.extract(image)
        back = decoder.push(encoder.push(found)).features
        assert back is not None
        assert back.size == found.size
        assert np.array_equal(back.descriptors, found.descriptors)
        assert np.array_equal(back.pixels, found.pixels)


@pytest.mark.parametrize("lost", range(FRAMES))
def test_after_a_loss_nothing_is_made_up(film: list[Features], lost: int) -> None:
    packets = packets_of(film, mode="inter", gop=4)
    assert [packet.starts for packet in packets] == [True, False, False, False, True, False]
    expected = decoded(packets)
    decoder = OrbFeatures.create().decoder()
    told = [decoder.push(LOST if k == lost else packet) for k, packet in enumerate(packets)]
    decoder = OrbFeatures.create().decoder()
    untold = [decoder.push(packet) for k, packet in enumerate(packets) if k != lost]
    assert [found.frame for found in told] == list(range(FRAMES))
    assert [found for found in told if found.features is None] == [
        found for found in told if lost <= found.frame < (4 if lost < 4 else FRAMES)
    ]
    for found in (*told, *untold):
        if found.features is not None:
            assert np.array_equal(found.features.descriptors, expected[found.frame].descriptors)
            assert np.array_equal(found.features.pixels, expected[found.frame].pixels)
    assert [found.frame for found in untold if found.features is None] == [
        found.frame for found in told if found.features is None and found.frame != lost
    ]


@pytest.mark.parametrize("setting", SETTINGS)
def test_damaged_packets_are_refused(film: list[Features], setting: dict[str, Any], rng: np.random.Generator) -> None:
    data = packets_of(film, **setting)[0].data
    damaged = [data[:length] for length in (*range(40), len(data) - 1)] + [data + b"\0", b"\xff" * 200]
    for _ in range(60):
        mutant = bytearray(data)
        mutant[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
        damaged.append(bytes(mutant))
    decoder = OrbFeatures.create().decoder()
    for mutant in damaged:
        with pytest.raises(BitstreamError, match="orb_features"):
            decoder.push(Packet(bytes(mutant), 0, True))
    assert decoder.push(Packet(data, 0, True)).features is not None


@pytest.mark.parametrize("count", [200, pytest.param(10_000, marks=pytest.mark.thorough)])
@pytest.mark.parametrize("setting", SETTINGS)
def test_damage_with_a_right_checksum_neither_crashes_nor_leaves_the_image(
    film: list[Features], setting: dict[str, Any], count: int, rng: np.random.Generator
) -> None:
    """What a decoder believes is checked: whoever makes a packet can make its checksum."""
    packets, refused, slowest_s = packets_of(film, **setting), 0, 0.0
    contents = [packet.data[:-4] for packet in packets[:2]]
    for index, mutant in damaged_copies(contents, count, rng):
        decoder = OrbFeatures.create().decoder()
        for packet in packets[:index]:
            decoder.push(packet)
        started = time.process_time()
        try:
            data = mutant + struct.pack("<I", zlib.crc32(mutant))
            found = decoder.push(Packet(data, index, packets[index].starts)).features
        except BitstreamError:
            refused += 1
            continue
        finally:
            slowest_s = max(slowest_s, time.process_time() - started)
        if found is not None:
            assert (found.pixels >= 0.0).all()
            assert (found.pixels <= found.size).all()
            assert np.isfinite(found.angles).all()
    assert refused > count // 10
    assert slowest_s < 5.0 or count < 10_000  # time is not for the quick tier to judge


def test_features_that_cannot_be_coded_are_refused(film: list[Features]) -> None:
    found = film[0]
    encoder = OrbFeatures.create().encoder()
    for changes, message in (
        ({"octaves": found.octaves + np.int32(5)}, "8 levels"),
        ({"pixels": found.pixels - found.pixels.min() - 0.4}, "between the centers"),
        ({"size": (65_000, 65_000)}, "pixels can be"),
        ({"size": (70_000, 240)}, "65535 a side"),
    ):
        with pytest.raises(ValueError, match=message):
            encoder.push(replace(found, **changes))


def test_the_prediction_is_of_blocks_before_and_its_sums_fit() -> None:
    blocks = np.arange(BITS) // BLOCK
    assert not WEIGHTS[blocks[:, None] >= blocks].any()
    largest = np.abs(WEIGHTS.astype(np.int64)).sum(axis=0) + np.abs(BIASES.astype(np.int64))
    assert largest.max() < (STEPS // 2) << STEP_SHIFT
    sums = [
        WEIGHTS[[4 * n + k for k in range(4) if value >> k & 1]].sum(axis=0) for n in (0, 40) for value in range(16)
    ]
    assert np.array_equal(np.concatenate([NIBBLES[:16], NIBBLES[640:656]]), sums)


def test_chances_leave_both_values_possible_and_follow_the_prediction() -> None:
    of_ones = CHANCES.reshape(-1, 2, STEPS).astype(np.int64)
    assert of_ones.min() >= LOWEST_CHANCE
    assert of_ones.max() <= 65536 - LOWEST_CHANCE
    sure = of_ones[:, :, [STEPS // 2 - 24, STEPS // 2, STEPS // 2 + 24]]
    assert (np.diff(np.delete(sure.reshape(-1, 3), 1, axis=0), axis=1) > 0).all()
    assert (of_ones[1:, 1, STEPS // 2] > 32768).all()


@pytest.mark.parametrize("mode", ["intra", "inter"])
def test_descriptors_that_are_never_as_foretold_come_back_too(mode: Any, rng: np.random.Generator) -> None:
    """They take more bytes than raw ones, which there must be room for."""
    bits = np.zeros((300, BITS), np.int64)
    for start in range(0, BITS, BLOCK):
        block = slice(start, start + BLOCK)
        odds = bits @ WEIGHTS[:, block].astype(np.int64) + BIASES[block]
        bits[:, block] = np.where(np.abs(odds) < 8, rng.integers(0, 2, odds.shape), odds < 0)
    descriptors = np.packbits(bits.astype(np.uint8), axis=1, bitorder="little").view(np.uint64)
    pixels = rng.integers(0, (320, 240), (300, 2)).astype(np.float64)
    found = Features(
        (320, 240), pixels, np.zeros(300, np.int32), np.zeros(300), np.full(300, np.nan), descriptors.view(np.uint8)
    )
    packets = packets_of([found, found], mode=mode)
    assert len(packets[0].data) > 300 * 40
    for back in decoded(packets):
        assert {bytes(row) for row in back.descriptors} == {bytes(row) for row in descriptors}


def test_training_finds_which_bits_go_together(rng: np.random.Generator) -> None:
    bits = rng.integers(0, 2, (4000, BITS)).astype(np.uint8)
    agrees = rng.random(len(bits)) < 0.85
    bits[:, 200] = np.where(agrees, bits[:, 3], 1 - bits[:, 3])
    weights, biases = train(np.packbits(bits, axis=1, bitorder="little").view(np.uint64))
    assert np.abs(weights[:, 200]).argmax() == 3
    assert weights[3, 200] > 5 * np.abs(np.delete(weights[:, 200].astype(np.int64), 3)).max()
    assert abs(int(biases[200]) + int(weights[:, 200].sum(dtype=np.int64)) // 2) < 4


@pytest.mark.thorough
@pytest.mark.parametrize("mode", ["intra", "inter"])
def test_slam_on_decoded_features_is_slam_on_pictures(mode: Any) -> None:
    room, options = Room(), Options(features=600)
    codec = OrbFeatures.create(features=600, mode=mode)
    encoder, decoder = codec.encoder(), codec.decoder()
    raw, served = System(CAMERA, options), System(CAMERA, options)
    for i in range(60):
        image = room.image(path_pose(i))
        raw.process(image, i / 15.0)
        features = decoder.push(encoder.push(codec.extract(image))).features
        assert features is not None
        served.process_keypoints(keypoints_of(features), i / 15.0)
    expected, result = raw.finish(), served.finish()
    assert len(expected.trajectory) > 25
    assert np.array_equal(result.trajectory.world_from_camera, expected.trajectory.world_from_camera)
    assert np.array_equal(result.points_world, expected.points_world)


OF_VERSION_2 = (
    "43424f46020350003c00080108000000000004000000000000000000000000000000a4bd00e91b62fd2599c36d6d57c652eb43e2ad69ad"
    "5791efcdc99d07cfaf36d6a7c35f177219ba8c6766816887aec50539657afd0a58a24a686d979316a58cd4af16de163903fb24285d168d"
    "1e8580affb2177303f7f4d34717e46d0683d4fde3d6cb5f30849b44c08b6c71c9fb548e147ca0c6c886e7ac567a819cb4397c7968be5d2"
    "3b16fb9fa1293527916e9d860e8d85f4f28e7ac82d86111fbb219f5e7dd699738f72b4865f04c533f16e82113da587152443dedfd8d65f"
    "a8961307b81ce3f2a1b86664c1f45fa2ab133027e72acc9a66515648ddb127b57d74bc67b1fcdf88",
    "43424f46020250003c0008010800b1fcdf88040000000000000000000000000000003de1c890942471d298010337610cbf3e2d61276706"
    "a19bf29380250cfbc823faf3b3cf6092ad49f74dc9ae80a052ddc48d2c43bd09e175b18d5fa1044e4ffc6ff8651a99880481f5f3f86e51"
    "eb3af297310404b4",
)
"""Two packets of that version, the second after the first."""


def test_packets_of_the_version_of_whole_pixels_are_read() -> None:
    rng = np.random.default_rng(5)
    descriptors = rng.integers(0, 2**64, (4, 4), np.uint64)
    pixels = np.array([[30.0, 20.0], [41.0, 20.0], [25.0, 31.0], [60.0, 40.0]])
    decoder = OrbFeatures.create().decoder()
    for number, packet in enumerate(OF_VERSION_2):
        back = decoder.push(Packet(bytes.fromhex(packet), number, number == 0)).features
        assert back is not None
        assert np.array_equal(back.pixels, pixels + np.array([number, 0.0]))
        assert np.array_equal(back.descriptors, descriptors.view(np.uint8))
        descriptors[:, 0] ^= np.uint64(5)


def test_positions_are_told_to_a_quarter_of_a_level_s_pixel(film: list[Features]) -> None:
    for found in film:
        places = (found.pixels + 0.5) / _ratios(found) * 4
        np.testing.assert_allclose(places % 1.0, 0.5, atol=1e-6)
    settings = ({}, {"position_step_px": 1}, {"position_step_px": 2})
    sizes = [sum(len(packet.data) for packet in packets_of(film, **setting)) for setting in settings]
    keypoints = sum(map(len, film))
    assert 0.4 < (sizes[0] - sizes[1]) / keypoints < 0.55
    assert sizes[1] > sizes[2]
    for found, back in zip(film, decoded(packets_of(film, position_step_px=1)), strict=True):
        assert np.abs((back.pixels - found.pixels) / _ratios(found)).max() <= 0.375 + 1e-9


def _ratios(found: Features) -> NDArray[np.float64]:
    """(N, 2): the image's size over that of each feature's level."""
    sizes = np.array([size[::-1] for size in level_sizes(*found.size, 1.2 ** np.arange(8))])
    return np.asarray(found.size / sizes[found.octaves])


@pytest.mark.parametrize("step", [0.5, 0.0, 1.5, 65])
def test_positions_have_the_finest_step_or_whole_ones(step: float) -> None:
    with pytest.raises(ValidationError, match="position_step_px"):
        OrbFeatures.create(position_step_px=step)


def test_packets_are_the_same_on_every_machine() -> None:
    """Of keypoints that are drawn, so that no corner depends on how another machine shrinks pictures."""
    rng = np.random.default_rng(3)
    descriptors = rng.integers(0, 2**64, (200, 4), np.uint64)
    encoder, digest = OrbFeatures.create(mode="inter", angle_bits=20).encoder(), hashlib.sha256()
    for _ in range(3):
        descriptors ^= rng.integers(0, 2**64, (200, 4), np.uint64) & rng.integers(0, 2**64, (200, 4), np.uint64)
        pixels = rng.integers(0, (320, 240), (200, 2)).astype(np.float64)
        angles = rng.integers(-(2**19), 2**19, 200) * (np.pi / 2**19)
        bits = descriptors.view(np.uint8).copy()
        found = Features((320, 240), pixels, np.zeros(200, np.int32), angles, np.full(200, np.nan), bits)
        digest.update(encoder.push(found).data)
    assert digest.hexdigest() == "bf94872f604711acb50e5908e8cd4fd10e724d428492e783abbfa4aa9c49bf77"
