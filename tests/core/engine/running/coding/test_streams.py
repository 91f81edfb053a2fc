"""Codecs with memory: what encoders may return, decoding from the last start, pictures found again, live sending."""

from __future__ import annotations

import re
from collections import Counter
from io import BytesIO
from typing import Any

import numpy as np
import plain_plugins
import pytest
from bitstream_files import JOB, read_all, require_damage_noticed
from codecbench_delta.codec import Delta, DeltaDecoder
from stream_codecs import SHAPE, Reordered, Scripted

from codecbench import Image, Packet, Picture, StreamCodec, Unsupported
from codecbench.core.contracts.evaluator import SentPacket
from codecbench.core.engine.running.coding.coded_frames import CodedFrames
from codecbench.core.engine.running.coding.decoding import SharedPictures, StreamPictures
from codecbench.core.engine.running.coding.encoding import encode_sequence
from codecbench.core.engine.running.coding.position import CodingError, WorkPosition
from codecbench.core.engine.storage.bitstream_file import (
    BitstreamDamage,
    BitstreamFile,
    CodedPacket,
    write_bitstreams,
    write_stream,
)

PIXELS = SHAPE[0] * SHAPE[1]


def ramp(frames: int) -> plain_plugins.RampSequence:
    return plain_plugins.RampSequence(plain_plugins.RampParams(frames=frames))


def coded_file(codec: StreamCodec[Any], frames: int) -> BitstreamFile:
    stream = BytesIO()
    write_stream(stream, encode_sequence(codec, ramp(frames), WorkPosition()), JOB)
    return BitstreamFile(stream.getvalue(), JOB)


def coded(codec: StreamCodec[Any], frames: int, position: WorkPosition | None = None) -> CodedFrames:
    return CodedFrames(ramp(frames), codec, coded_file(codec, frames), position or WorkPosition())


def is_whole(found: CodedFrames, index: int) -> bool:
    frame = found.frame(index)
    return frame.original.index == index and np.array_equal(frame.decoded, frame.original.image)


def test_who_asks_a_codec_with_memory_for_one_picture_is_told_what_to_call() -> None:
    """An evaluator that was written for codecs of single pictures is unsupported, not broken."""
    codec = Reordered.create()
    for asked in (lambda: codec.encode(ramp(1).read(0).image), lambda: codec.decode(b"")):
        with pytest.raises(Unsupported, match=r"inter-frame .*encoder_of\("):
            asked()


# encoding


def test_packets_are_told_in_the_order_in_which_they_leave() -> None:
    sent = [(packet.frame, packet.starts, packet.after) for packet in coded(Reordered.create(anchors=2), 6).packets]
    assert sent == [(0, True, 1), (2, False, 3), (1, False, 3), (4, True, 5), (3, False, 5), (5, False, 6)]
    held = [packet.after - packet.frame - 1 for packet in coded(Delta.create(hold=3), 7).packets]
    assert held == [3, 3, 3, 3, 2, 1, 0]
    assert all(packet.after == packet.frame + 1 for packet in coded(Delta.create(), 7).packets)


def whole(frame: Any, data: Any = b"x", starts: Any = True) -> Packet:
    return Packet(data, frame, starts)


@pytest.mark.parametrize(
    ("packets", "words", "where"),
    [
        (lambda push: None, "push returned NoneType", "encode, frame 0"),
        (lambda push: [b"x"], "a list with bytes", "encode, frame 0"),
        (lambda push: [whole("0")], "str and bool", "encode, frame 0"),
        (lambda push: [whole(push, starts=1)], "int and int", "encode, frame 0"),
        (lambda push: [Packet(b"x", push, True, -1)], "with recovery_frames -1", "encode, frame 0"),
        (lambda push: [whole(push + 1)], "frame 1; 0 to 0", "encode, frame 0"),
        (lambda push: [whole(-1)], "frame -1; 0 to 0", "encode, frame 0"),
        (lambda push: [whole(0)], "frame 0 a second time", "encode, frame 1"),
        (lambda push: [whole(push, starts=False)], r"frame 0, .*starts=False", "encode, frame 0"),
        (lambda push: [whole(push, b"")], "frame 0 contains no bytes", "encode, frame 0"),
        (lambda push: [whole(push, "x")], "frame 0 contains str", "encode, frame 0"),
        (lambda push: [whole(0)] if push == 2 else [], "after flush: 1, 2", "encode"),
        (lambda push: [whole(push if push >= 0 else 0)], "flush .*frame 0 a second", "encode"),
    ],
)
def test_what_an_encoder_may_not_do(packets: Any, words: str, where: str) -> None:
    position = WorkPosition()
    with pytest.raises(CodingError, match=words):
        list(encode_sequence(Scripted(packets), ramp(3), position))
    assert str(position) == where


def test_what_a_class_says_of_its_bytes_does_not_count() -> None:
    class Shy(bytes):
        def __len__(self) -> int:
            return 1

    (first, *_) = encode_sequence(Scripted(lambda push: [whole(push, Shy(b"four"))] if push >= 0 else []), ramp(2),
                                  WorkPosition())  # fmt: skip
    assert (type(first.data), len(first.data)) == (bytes, 4)


# decoding


@pytest.fixture
def pushes(monkeypatch: pytest.MonkeyPatch) -> Counter[int]:
    """How often the packet of each frame was decoded."""
    found: Counter[int] = Counter()
    push = DeltaDecoder.push

    def counted(self: DeltaDecoder, packet: Any, **options: Any) -> list[Picture]:
        found[packet.frame] += 1
        return push(self, packet, **options)

    monkeypatch.setattr(DeltaDecoder, "push", counted)
    return found


def test_who_reads_in_order_has_each_packet_decoded_once(pushes: Counter[int]) -> None:
    position = WorkPosition("evaluate")
    found = coded(Delta.create(gop=100), 12, position)
    for index, frame in enumerate(found):
        assert np.array_equal(frame.decoded, frame.original.image)
        assert found.size_bytes(index) == frame.size_bytes == len(frame.bitstream)
        assert str(position) == f"evaluate, frame {index}"
    assert pushes == Counter(range(12))


def test_frames_that_were_decoded_are_found_again(pushes: Counter[int]) -> None:
    found = coded(Delta.create(gop=100), 12)
    for index in (0, 3, 3, 1, 9, 2, 9):
        frame = found.frame(index)
        assert np.array_equal(frame.decoded, frame.original.image)
        frame.decoded[:] = 0  # harms nobody
    assert pushes == Counter(range(10))


def test_who_jumps_has_decoding_start_at_the_last_start(pushes: Counter[int]) -> None:
    found = coded(Delta.create(gop=4), 12)
    assert is_whole(found, 10)
    assert pushes == Counter([8, 9, 10])
    assert is_whole(found, 5)
    assert pushes == Counter([8, 9, 10, 4, 5])
    assert is_whole(found, 11)  # nothing of the session that was left is kept but its pictures
    assert pushes == Counter([8, 9, 10, 4, 5, 8, 9, 10, 11])


@pytest.mark.parametrize("kept", [1, 4])
def test_kept_pictures_are_bounded_and_reading_backwards_decodes_a_share_of_the_square(
    kept: int, pushes: Counter[int]
) -> None:
    frames, file = ramp(24), coded_file(Delta.create(gop=100), 24)
    pictures = StreamPictures(Delta.create(), file.packets, file.read, WorkPosition(), kept_bytes=kept * PIXELS)
    for index in reversed(range(24)):
        original = frames.read(index).image
        assert np.array_equal(pictures.picture(index, original), original)
    assert sum(pushes.values()) == sum(range(24, 0, -kept))


def test_the_next_evaluator_of_a_stream_finds_what_was_decoded(pushes: Counter[int]) -> None:
    file, shared = coded_file(Delta.create(gop=4), 12), SharedPictures(0)

    def read_by_another(limit: int, file: BitstreamFile = file) -> Counter[int]:
        before = Counter(pushes)
        pictures = shared.of(file.digest, limit * PIXELS)
        found = CodedFrames(ramp(12), Delta.create(), file, WorkPosition(), pictures)
        for frame in found:
            assert np.array_equal(frame.decoded, frame.original.image)
            frame.decoded[:] = 0  # harms nobody
        return pushes - before

    assert read_by_another(9) == Counter(range(12))
    assert read_by_another(9) == Counter([8, 9, 10, 11])  # the ninth fits too, and decoding starts there for the tenth
    assert read_by_another(12) == Counter([8, 9, 10, 11])
    assert read_by_another(12) == Counter()
    other = coded_file(Delta.create(gop=5), 12)
    assert read_by_another(12, other) == Counter(range(12))
    assert read_by_another(12) == Counter(range(12))


@pytest.mark.parametrize("order", [range(13), range(12, -1, -1), (7, 8, 3, 11, 12, 0, 5), (12, 1)])
@pytest.mark.parametrize("anchors", [1, 2, 100])
def test_pictures_that_are_sent_out_of_order_are_found(order: Any, anchors: int) -> None:
    """Frames before one that starts, and sent after it, are decoded from the start before."""
    for frames in (13, 14):
        found = coded(Reordered.create(anchors=anchors), frames)
        assert all(is_whole(found, index) for index in order)


def picture(frame: int, state: Any = "whole", image: Any = None) -> Picture:
    return Picture(frame, state, np.zeros(SHAPE, np.uint8) if image is None else image)


@pytest.mark.parametrize(
    ("pictures", "words"),
    [
        (lambda packet: None, "returned NoneType"),
        (lambda packet: [packet], "a list with Packet"),
        (lambda packet: [picture(packet.frame)] * 2, "frame 0 a second time"),
        (lambda packet: [picture(packet.frame, "concealed")], "frame 0 as concealed"),
        (lambda packet: [Picture(packet.frame, "missing", None)], "frame 0 as missing"),
        (lambda packet: [picture(packet.frame, image=np.zeros((4, 4), np.uint8))], r"decode returned shape \(4, 4\)"),
        (lambda packet: [picture(packet.frame, image=[1])], "decode returned list"),
        (lambda packet: [], "after all packets"),
    ],
)
def test_what_a_decoder_may_not_do(pictures: Any, words: str) -> None:
    def packets(push: int) -> list[Packet]:
        return [whole(push)] if push >= 0 else []

    with pytest.raises(CodingError, match=words):
        coded(Scripted(packets, pictures), 3).frame(0)


def test_a_session_that_raised_is_not_used_again() -> None:
    failing = {1}

    def pictures(packet: Packet) -> list[Picture]:
        if packet.frame in failing:
            raise ValueError("not today")
        return [picture(packet.frame)]

    found = coded(Scripted(lambda push: [whole(push, starts=push == 0)] if push >= 0 else [], pictures), 3)
    with pytest.raises(ValueError, match="not today"):
        found.frame(1)
    failing.clear()
    assert found.frame(2).decoded.shape == SHAPE


def test_a_file_of_another_kind_of_codec_is_made_again() -> None:
    stills = BytesIO()
    write_bitstreams(stills, [b"x"] * 3, JOB)
    with pytest.raises(BitstreamDamage, match=r"single frames.* delta"):
        CodedFrames(ramp(3), Delta.create(), BitstreamFile(stills.getvalue(), JOB), WorkPosition())
    with pytest.raises(BitstreamDamage, match=r"a stream.* shift"):
        CodedFrames(ramp(3), plain_plugins.Shift.create(), coded_file(Delta.create(), 3), WorkPosition())


def test_a_codec_without_memory_sends_each_frame_at_once() -> None:
    stills = BytesIO()
    write_bitstreams(stills, [b"x", b"four"], JOB)
    found = CodedFrames(ramp(2), plain_plugins.Shift.create(), BitstreamFile(stills.getvalue(), JOB), WorkPosition())
    assert found.packets == (SentPacket(0, 1, True, 1), SentPacket(1, 4, True, 2))


def test_an_encoder_that_holds_frames_back_is_noted() -> None:
    def held(codec: Any) -> list[list[str]]:
        return [re.findall(r"\d+ \w+", note) for note in coded(codec, 7).notes]

    assert held(Delta.create()) == []
    assert held(Delta.create(hold=1)) == [["1 frame", "33 ms"]]
    assert held(Delta.create(hold=3)) == [["3 frames", "100 ms"]]
    assert held(Reordered.create()) == [["1 frame", "33 ms"]]


# storing


def test_every_flipped_bit_and_every_cut_of_a_stream_is_noticed() -> None:
    stream = BytesIO()
    packets = [CodedPacket(b"first", 0, True, 1), CodedPacket(b"third", 2, False, 3), CodedPacket(b"x", 1, False, 3)]
    assert write_stream(stream, packets, JOB) == 11
    content = stream.getvalue()
    require_damage_noticed(content)
    with pytest.raises(BitstreamDamage, match=f"bitstreams of job {JOB}"):
        BitstreamFile(content, "1e" * 16)
    assert read_all(content) == [b"first", b"x", b"third"]
    assert [packet.frame for packet in BitstreamFile(content, JOB).packets] == [0, 2, 1]


@pytest.mark.parametrize("frames", [(0, 0), (0, 2), (1, 2)])
def test_a_stream_that_has_not_one_packet_of_each_frame_is_damaged(frames: tuple[int, int]) -> None:
    stream = BytesIO()
    write_stream(stream, [CodedPacket(b"x", frame, True, 1) for frame in frames], JOB)
    with pytest.raises(BitstreamDamage, match="one packet"):
        BitstreamFile(stream.getvalue(), JOB)


# sending


def decoded_alone(codec: StreamCodec[Any], images: list[Image]) -> list[tuple[int, Image]]:
    """Sizes and pictures of these images as a stream of their own."""
    encoder, decoder = codec.encoder(30.0), codec.decoder()
    packets = [packet for image in images for packet in encoder.push(image)]
    return [(len(packet.data), decoder.push(packet)[0].image) for packet in packets]  # type: ignore[misc]


def test_frames_that_are_sent_make_a_stream_of_their_own(pushes: Counter[int]) -> None:
    codec, sequence = Delta.create(gop=3), ramp(12)
    sender, chosen = coded(codec, 12).sender(), [1, 4, 5, 9]
    found = [sender.send(index) for index in chosen]
    sent = Counter(pushes)
    expected = decoded_alone(codec, [sequence.read(index).image for index in chosen])
    assert [frame.original.index for frame in found] == chosen
    for frame, (size_bytes, image) in zip(found, expected, strict=True):
        assert frame.size_bytes == size_bytes
        assert np.array_equal(frame.decoded, image)
    assert sent == Counter(range(4))  # the third of these starts, not the sequence's third


def test_a_frame_that_was_sent_is_given_again_and_later_ones_are_as_if_it_had_not_been_asked_for() -> None:
    once, twice = coded(Delta.create(gop=100), 12).sender(), coded(Delta.create(gop=100), 12).sender()
    for index in (2, 3, 7):
        first, again = once.send(index), twice.send(index)
        assert (first.bitstream, first.decoded.tolist()) == (again.bitstream, again.decoded.tolist())
        for before in (2, 3, 7):
            if before <= index:
                given = twice.send(before)
                assert np.array_equal(given.decoded, given.original.image)


def test_a_stream_does_not_go_back() -> None:
    sender = coded(Delta.create(), 12).sender()
    sender.send(7)
    with pytest.raises(Unsupported, match=r"frame 3 .*after frame 7"):
        sender.send(3)


def test_a_sender_of_single_pictures_goes_where_it_likes() -> None:
    stills = BytesIO()
    shift = plain_plugins.Shift.create()
    write_bitstreams(stills, (packet.data for packet in encode_sequence(shift, ramp(4), WorkPosition())), JOB)
    sender = CodedFrames(ramp(4), shift, BitstreamFile(stills.getvalue(), JOB), WorkPosition()).sender()
    assert [sender.send(index).original.index for index in (3, 1, 3)] == [3, 1, 3]


def test_frames_that_are_held_back_cannot_be_sent_as_they_are_chosen() -> None:
    with pytest.raises(Unsupported, match=r"^delta .*frames back"):
        coded(Delta.create(hold=1), 4).sender().send(0)
    late = Scripted(lambda push: [whole(push)] if push >= 0 else [])
    with pytest.raises(Unsupported, match="decoder of scripted"):
        coded(late, 4).sender().send(0)
