"""Every packet lost in turn; where intra refresh makes pictures whole; damage and headers that ask for too much."""

from __future__ import annotations

import dataclasses
import re
import resource
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from losing_link import Losing
from video_pictures import gliding_pictures

pytest.importorskip("av", reason="the extra `video` is not installed")

from codecbench import LOST, BitstreamError, Packet
from codecbench.core.conformance.harness import decoded_of, packets_of
from codecbench.core.contracts.evaluator import SentPacket
from codecbench.core.simulation.delivery import DeliveredFrames, deliver
from codecbench.core.simulation.settings import LinkSettings
from codecbench.plugins.codecs.video.codecs import H264, Av1, Ffv1, Hevc, Mjpeg, Vp9
from codecbench.plugins.codecs.video.header import Header

CODECS: list[Any] = [H264, Hevc, Av1, Vp9, Mjpeg, Ffv1]
EVERY_CODEC = pytest.mark.parametrize("codec_class", CODECS, ids=lambda codec_class: codec_class.name)
FIRST_BYTES_AS_SENT = 11


def lose_each_in_turn(codec: Any, packets: list[Packet]) -> dict[str, int]:
    """Count the states of pictures between a loss and the next start, which must be as in the whole stream."""
    expected = {picture.frame: picture.image for picture in decoded_of(codec, packets)}
    found = {"whole": 0, "concealed": 0, "missing": 0}
    for lost, packet in enumerate(packets):
        pictures = decoded_of(codec, [*packets[:lost], LOST, *packets[lost + 1 :]])
        assert [picture.frame for picture in pictures] == list(range(len(packets)))
        restart = min((later.frame for later in packets[lost + 1 :] if later.starts), default=len(packets))
        for picture in pictures:
            if picture.state == "whole":
                assert np.array_equal(picture.image, expected[picture.frame])
            if picture.frame >= restart:
                assert picture.state == "whole"
            elif codec.is_low_delay() and picture.frame > packet.frame:
                found[picture.state] += 1
        assert pictures[packet.frame].state != "whole"
    return found


@EVERY_CODEC
def test_each_packet_of_a_short_stream_may_be_lost(codec_class: Any) -> None:
    codec = codec_class.create(gop=1 if codec_class is Mjpeg else 5)
    states = lose_each_in_turn(codec, packets_of(codec, gliding_pictures(12, 48, 64, 3)))
    assert states["whole"] == 0, "until the next start nothing may be called so"
    if codec_class is not Mjpeg:
        assert states["concealed"] + states["missing"] > 0


@pytest.mark.thorough
@EVERY_CODEC
@pytest.mark.parametrize("latency", ["low", "any"])
def test_each_packet_of_sixty_frames_may_be_lost(codec_class: Any, latency: Any) -> None:
    if latency == "any" and codec_class in (Mjpeg, Ffv1):
        pytest.skip("has no look-ahead")
    codec = codec_class.create(gop=1 if codec_class is Mjpeg else 15, latency=latency)
    lose_each_in_turn(codec, packets_of(codec, gliding_pictures(60, 96, 128, 1)))


@EVERY_CODEC
def test_everything_may_be_lost_up_to_a_start(codec_class: Any) -> None:
    codec = codec_class.create(gop=1 if codec_class is Mjpeg else 4)
    packets = packets_of(codec, gliding_pictures(10, 48, 64, 1))
    whole = decoded_of(codec, packets)
    for gone in range(1, 9):
        pictures = decoded_of(codec, [LOST] * gone + packets[gone:])
        restart = min(packet.frame for packet in packets[gone:] if packet.starts)
        assert [picture.state for picture in pictures] == ["missing"] * restart + ["whole"] * (10 - restart)
        assert np.array_equal(pictures[-1].image, whole[-1].image)


def test_intra_refresh_makes_pictures_whole_without_a_start() -> None:
    """x264 marks where; from there on every picture is that of the stream without losses."""
    gop = 10
    codec = H264.create(intra_refresh=True, gop=gop)
    packets = packets_of(codec, gliding_pictures(50, 96, 128, 1))
    assert [packet.frame for packet in packets if packet.starts] == [0]
    expected = [picture.image for picture in decoded_of(codec, packets)]
    for lost in range(1, 25):
        pictures = decoded_of(codec, [*packets[:lost], LOST, *packets[lost + 1 :]])
        states = [picture.state for picture in pictures]
        healed = states.index("whole", lost)
        assert set(states[healed:]) == {"whole"}
        assert healed - lost <= 2 * gop
        for picture in pictures[healed:]:
            assert np.array_equal(picture.image, expected[picture.frame])


def test_a_decoder_that_joins_an_intra_refreshed_stream_gets_whole_pictures_in_time() -> None:
    codec = H264.create(intra_refresh=True, gop=10)
    packets = packets_of(codec, gliding_pictures(40, 96, 128, 1))
    expected = [picture.image for picture in decoded_of(codec, packets)]
    pictures = decoded_of(codec, packets[13:])
    states = {picture.frame: picture.state for picture in pictures}
    first = min(frame for frame, state in states.items() if state == "whole")
    assert 20 < first <= 30
    assert {state for frame, state in states.items() if frame >= first} == {"whole"}
    assert all(np.array_equal(shown.image, expected[shown.frame]) for shown in pictures if shown.frame >= first)


REFRESHED: list[dict[str, Any]] = [
    {"gop": 8},
    {"gop": 6, "qp": 20, "preset": "slow", "pixel_format": "yuv444p"},
    {"gop": 10, "bitrate_kbps": 150},
]


@pytest.mark.parametrize("params", REFRESHED, ids=str)
def test_over_a_link_a_refreshed_stream_is_whole_when_its_decoder_shows_what_was_sent(params: dict[str, Any]) -> None:
    """Packets are lost one by one and in pairs. What the simulation calls on time is to the bit the stream without
    losses, and what it calls concealed, lost or broken is not called whole by the decoder."""
    codec, count = H264.create(intra_refresh=True, **params), 34
    images = gliding_pictures(count, 96, 128, 1)
    packets = packets_of(codec, images)
    sent = [picture.image for picture in decoded_of(codec, packets)]
    units = tuple(SentPacket(p.frame, len(p.data), p.starts, p.frame + 1, p.recovery_frames) for p in packets)
    assert next(unit.frame for unit in units if unit.recovery_frames is not None) == params["gop"]
    frames = [
        SimpleNamespace(bitstream=packet.data, decoded=image) for packet, image in zip(packets, sent, strict=True)
    ]
    coded: Any = SimpleNamespace(packets=units, codec=codec, frame=frames.__getitem__)
    settings = LinkSettings(link="given", mtu=60_000, queue_policy="fifo", concealed=True)
    for lost in [(k,) for k in range(18)] + [(k, k + 9) for k in range(8)]:
        link = Losing(*lost)
        found = deliver(units, np.arange(count) / 30, link, settings, np.random.default_rng(0))
        received = [LOST if packet.frame in lost else packet for packet in packets]
        states = {picture.frame: picture.state for picture in decoded_of(codec, received)}
        assert [outcome == "on time" for outcome in found.outcomes] == [
            states.get(i) == "whole" for i in range(count)
        ], lost
        assert [outcome == "concealed" for outcome in found.outcomes] == [
            states.get(i) == "concealed" for i in range(count)
        ]
        shown = DeliveredFrames(coded, found)
        for frame in found.output_frames:
            equal = np.array_equal(shown.image(frame), sent[frame])
            assert equal or found.outcomes[frame] == "concealed"
        assert found.outcomes[-1] == "on time"


@EVERY_CODEC
def test_bytes_that_a_decoder_cannot_read_are_refused_and_the_next_start_is_whole(codec_class: Any) -> None:
    codec = codec_class.create(gop=1 if codec_class is Mjpeg else 4)
    packets = packets_of(codec, gliding_pictures(8, 48, 64, 1))
    expected = decoded_of(codec, packets)
    decoder = codec.decoder()
    with pytest.raises(BitstreamError):
        decoder.push(dataclasses.replace(packets[0], data=packets[0].data[:FIRST_BYTES_AS_SENT] + bytes(60)))
    pictures = [picture for packet in packets[1:] for picture in decoder.push(packet)]
    assert [picture.frame for picture in pictures] == list(range(1, 8))
    assert [picture.state for picture in pictures[3:]] == ["whole"] * 4
    assert all(np.array_equal(left.image, right.image) for left, right in zip(pictures[3:], expected[4:], strict=True))


@pytest.mark.parametrize("scale", [1, 257], ids=["8 bits", "16 bits"])
def test_ffv1_refuses_each_damaged_or_missing_slice(scale: int) -> None:
    """FFmpeg wrote the checksums, and its decoder decodes slices whose checksum is wrong."""
    pictures = [
        picture * np.array(scale, f"uint{8 if scale == 1 else 16}") for picture in gliding_pictures(2, 48, 64, 1)
    ]
    codec = Ffv1.create()
    packets = packets_of(codec, pictures)
    assert [picture.state for picture in decoded_of(codec, packets)] == ["whole"] * 2
    for frame, packet in enumerate(packets):
        sent = packet.data
        header = len(sent) - len(Header.parse(sent, Ffv1.magic)[1]) if packet.starts else 0
        damaged = [sent[:at] + bytes([sent[at] ^ 1 << at % 8]) + sent[at + 1 :] for at in range(header, len(sent))]
        slices, end = [], len(sent)
        while end > header:
            slices.append(sent[end - 8 - int.from_bytes(sent[end - 8 : end - 5], "big") : end])
            end -= len(slices[-1])
        damaged += [sent.replace(one, b"") for one in slices]
        for data in damaged:
            decoder = codec.decoder()
            for earlier in packets[:frame]:
                decoder.push(earlier)
            with pytest.raises(BitstreamError):
                decoder.push(dataclasses.replace(packet, data=data))


@EVERY_CODEC
def test_streams_of_the_others_are_refused(codec_class: Any) -> None:
    pictures = gliding_pictures(2, 48, 64, 1)
    for other in CODECS:
        if other is not codec_class:
            with pytest.raises(
                BitstreamError, match=f"{re.escape(repr(other.magic))} .*{re.escape(repr(codec_class.magic))}"
            ):
                codec_class.create().decoder().push(packets_of(other.create(), pictures)[0])


@EVERY_CODEC
def test_a_header_that_asks_for_too_much_is_refused_before_memory_is_taken(codec_class: Any) -> None:
    (packet, *_) = packets_of(codec_class.create(), gliding_pictures(2, 48, 64, 1))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for width, height in ((0xFFFF, 0xFFFF), (0, 5), (0xFFFF, 2000)):
        sizes = width.to_bytes(2, "little") + height.to_bytes(2, "little")
        with pytest.raises(BitstreamError):
            codec_class.create().decoder().push(
                dataclasses.replace(packet, data=packet.data[:5] + sizes + packet.data[9:])
            )
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000


def test_a_stream_larger_than_its_header_says_is_refused() -> None:
    """The header tells 64x48; the sequence behind it is of 640x480."""
    small, large = (packets_of(H264.create(), gliding_pictures(1, *size, 1))[0] for size in ((48, 64), (480, 640)))
    forged = small.data[:FIRST_BYTES_AS_SENT] + large.data[FIRST_BYTES_AS_SENT:]
    with pytest.raises(BitstreamError):
        H264.create().decoder().push(dataclasses.replace(small, data=forged))
