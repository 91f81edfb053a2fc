"""Bitstream files, coded sequences and the frame cache."""

from __future__ import annotations

import hashlib
from io import BytesIO
from pathlib import Path

import numpy as np
import plain_plugins
import pytest
from bitstream_files import JOB, read_all, require_damage_noticed
from hypothesis import given
from hypothesis import strategies as st

from codecbench.core.contracts.image import Image
from codecbench.core.contracts.sequence import Frame
from codecbench.core.engine.running.coding.coded_frames import CodedFrames
from codecbench.core.engine.running.coding.decoding import ShuffledPictures, check_decoding
from codecbench.core.engine.running.coding.encoding import encode_sequence
from codecbench.core.engine.running.coding.position import CodingError, WorkPosition
from codecbench.core.engine.running.frame_cache import MOST_BYTES, CachedSequence, FrameCache, cache_limit_bytes
from codecbench.core.engine.storage.bitstream_file import BitstreamDamage, BitstreamFile, write_bitstreams


def filed(*bitstreams: bytes) -> bytes:
    stream = BytesIO()
    assert write_bitstreams(stream, bitstreams, JOB) == sum(map(len, bitstreams))
    return stream.getvalue()


@given(st.lists(st.binary(min_size=1, max_size=50), max_size=8))
def test_bitstreams_come_back_as_they_were(bitstreams: list[bytes]) -> None:
    content = filed(*bitstreams)
    file = BitstreamFile(content, JOB)
    assert read_all(content) == bitstreams
    body, footer = content[:-40], content[-40:]
    assert hashlib.blake2b(body, digest_size=16).digest() == footer[20:36]
    assert [file.size_bytes(index) for index in range(len(file))] == list(map(len, bitstreams))


def test_every_flipped_bit_and_every_cut_is_noticed(tmp_path: Path) -> None:
    whole = filed(b"first", b"second bitstream", b"x")
    require_damage_noticed(whole)
    path = tmp_path / "cut.bits"
    path.write_bytes(whole[:-1])
    with pytest.raises(BitstreamDamage, match=r"cut\.bits"):
        BitstreamFile(path, JOB)


def test_a_damaged_bitstream_is_noticed_when_it_is_read() -> None:
    broken = bytearray(filed(b"first", b"second"))
    broken[41] ^= 1
    file = BitstreamFile(bytes(broken), JOB)
    assert file.read(1) == b"second"
    with pytest.raises(BitstreamDamage, match="bitstream 0"):
        file.read(0)


def test_a_file_says_whose_bitstreams_it_holds() -> None:
    with pytest.raises(BitstreamDamage, match=f"job {JOB}, not of {'1e' * 16}"):
        BitstreamFile(filed(b"first"), "1e" * 16)
    earlier = bytearray(filed(b"first"))
    earlier[7] = 1
    with pytest.raises(BitstreamDamage, match="earlier version"):
        BitstreamFile(bytes(earlier), JOB)


def test_frames_are_decoded_by_an_instance_that_encoded_nothing(tmp_path: Path) -> None:
    sequence = plain_plugins.RampSequence(plain_plugins.RampParams(frames=3))
    path = tmp_path / "job.bits"
    with open(path, "wb") as stream:
        packets = encode_sequence(plain_plugins.Shift.create(bits=3), sequence, WorkPosition())
        write_bitstreams(stream, (packet.data for packet in packets), JOB)
    position = WorkPosition("evaluate")
    coded = CodedFrames(sequence, plain_plugins.Shift.create(bits=0), BitstreamFile(path, JOB), position)
    assert len(coded) == 3
    for index, one in enumerate(coded):
        assert one.original.index == index
        assert np.array_equal(one.decoded, one.original.image >> 3 << 3)
        assert coded.size_bytes(index) == one.size_bytes == 3 + 8 * 16
        assert str(position) == f"evaluate, frame {index}"


def test_a_file_of_another_length_is_refused() -> None:
    sequence = plain_plugins.RampSequence(plain_plugins.RampParams(frames=3))
    with pytest.raises(CodingError, match=r"1 bitstreams for 3 .*ramp"):
        CodedFrames(sequence, plain_plugins.Shift.create(), BitstreamFile(filed(b"x"), JOB), WorkPosition())


@pytest.mark.parametrize(
    ("decoded", "words"),
    [
        (None, "NoneType"),
        (np.zeros((4, 5), np.int16), "dtype int16"),
        (np.zeros((5, 4), np.uint8), r"shape \(5, 4\).*\(4, 5\)"),
        (np.zeros((4, 5, 3), np.uint8), r"shape \(4, 5, 3\)"),
    ],
)
def test_what_is_not_the_frame_is_refused(decoded: object, words: str) -> None:
    with pytest.raises(CodingError, match=words):
        check_decoding(decoded, np.zeros((4, 5), np.uint8))


class Counted(plain_plugins.RampSequence):
    """Counts how often each frame is read."""

    def __init__(self, frames: int, fingerprint: str) -> None:
        super().__init__(plain_plugins.RampParams(frames=frames))
        self.fingerprint = fingerprint
        self.reads = [0] * frames

    def read(self, index: int) -> Frame:
        self.reads[index] += 1
        return super().read(index)


def test_frames_are_read_once_while_they_fit_and_the_rest_every_time() -> None:
    frame_bytes = 8 * 16
    cache = FrameCache(limit_bytes=3 * frame_bytes)
    source = Counted(5, "a")
    sequence = CachedSequence(source, "renamed", cache)
    for _ in range(4):
        list(sequence)
    assert source.reads == [1, 1, 1, 4, 4]
    assert cache.used_bytes == 3 * frame_bytes
    other = Counted(2, "b")
    for _ in range(2):
        list(CachedSequence(other, "other", cache))
    assert other.reads == [1, 1]
    assert (sequence.name, len(sequence)) == ("renamed", 5)


def test_the_cache_leaves_codecs_most_of_the_memory() -> None:
    assert cache_limit_bytes(256) == 64 << 20
    assert cache_limit_bytes(1 << 20) == MOST_BYTES


def test_writing_into_a_frame_harms_nobody_else(monkeypatch: pytest.MonkeyPatch) -> None:
    sequence = CachedSequence(Counted(1, "a"), "a", FrameCache())
    first = sequence.read(0)
    size = first.png_size_bytes
    first.image[:] = 0
    second = sequence.read(0)
    assert second.image.any()
    monkeypatch.setattr("codecbench.core.contracts.sequence.png_bytes", None)  # counted once, not again
    assert second.png_size_bytes == size


def test_who_looks_back_at_shuffled_pictures_has_each_decoded_twice_at_most(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each picture holds its number; pairs of neighbors are asked for, as those who follow a motion do."""
    codec = plain_plugins.Shift.create()
    images = [np.full((8, 8), number, np.uint8) for number in range(20)]
    bitstreams = [codec.encode(image) for image in images]
    decoded, decode = [], plain_plugins.Shift.decode

    def counted(self: plain_plugins.Shift, bitstream: bytes) -> Image:
        decoded.append(bitstream)
        return decode(self, bitstream)

    monkeypatch.setattr(plain_plugins.Shift, "decode", counted)
    pictures = ShuffledPictures(codec, bitstreams.__getitem__, len(images), WorkPosition())
    for number in range(len(images) - 1):
        for frame in (number, number + 1):
            assert (pictures.picture(frame, images[frame]) == decode(codec, bitstreams[frame])).all()
    assert len(decoded) <= 2 * len(images)
