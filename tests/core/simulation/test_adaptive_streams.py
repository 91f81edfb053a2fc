"""Streams that are coded as the link asks: new sessions at other settings, each of which begins with a start."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import skimage.data
from hypothesis import given, settings
from hypothesis import strategies as st
from losing_link import Losing
from memory_sequence import MemorySequence, Plugins, context
from pydantic import Field

from codecbench import NULL_TRACE, Image, Loss, Packet, Params, Picture, PluginError, StreamCodec, Trace
from codecbench.core.contracts.codec import Capabilities
from codecbench.core.contracts.evaluator import SentPacket
from codecbench.core.contracts.link import Channel, Link
from codecbench.core.contracts.params import NoParams
from codecbench.core.contracts.stream import StreamDecoder, StreamEncoder
from codecbench.core.simulation.delivery import DeliveredFrames, Delivery, deliver, delivery_of
from codecbench.core.simulation.settings import Adaptation, LinkSettings
from codecbench.plugins.codecs.multilevel.stream import MultilevelStream
from codecbench.plugins.links.constant import Constant
from codecbench.plugins.links.gilbert_elliott import GilbertElliott

RATE_HZ = 10.0


class SizedParams(Params):
    kilobytes: int = Field(default=1, ge=1, le=50)


class Sized(StreamCodec[SizedParams]):
    """Packets of so many kilobytes, of which the first of a session has three times as many. A picture shows the size
    and is whole where everything from the start on came; else it is made up, as 255, once there was a start."""

    name = "sized"
    version = "1"
    params_type = SizedParams
    capabilities = Capabilities()

    def encoder(self, frame_rate_hz: float) -> StreamEncoder:
        return _SizedEncoder(self.params.kilobytes)

    def decoder(self) -> StreamDecoder:
        return _SizedDecoder()


class _SizedEncoder(StreamEncoder):
    def __init__(self, kilobytes: int) -> None:
        self.kilobytes, self.pushed = kilobytes, 0

    def push(self, image: Image, *, trace: Trace = NULL_TRACE) -> list[Packet]:
        starts = self.pushed == 0
        data = bytes([self.kilobytes]) * (1000 * self.kilobytes * (3 if starts else 1))
        self.pushed += 1
        return [Packet(data, self.pushed - 1, starts)]

    def flush(self) -> list[Packet]:
        return []


class _SizedDecoder(StreamDecoder):
    def __init__(self) -> None:
        self.next, self.has_begun, self.is_whole = 0, False, False

    def push(self, packet: Packet | Loss, *, trace: Trace = NULL_TRACE) -> list[Picture]:
        frame, self.next = self.next, self.next + 1
        if isinstance(packet, Packet):
            assert packet.frame == frame, "pictures of a session are numbered from 0"
            self.is_whole |= packet.starts
            self.has_begun |= packet.starts
            if self.is_whole:
                return [Picture(frame, "whole", np.full((4, 4), packet.data[0], np.uint8))]
        self.is_whole = False
        if not self.has_begun:
            return [Picture(frame, "missing", None)]
        return [Picture(frame, "concealed", np.full((4, 4), 255, np.uint8))]

    def flush(self) -> list[Picture]:
        return []


class Halving(Constant):
    """From `at_s` on it has half of its rate."""

    at_s = 4.0

    def open(self, rng: np.random.Generator) -> Channel:
        rates = [Constant.create(**{**self.params.model_dump(), "rate_kbps": self.params.rate_kbps / half}).open(rng)
                 for half in (1, 2)]  # fmt: skip
        channel: Any = SimpleNamespace(carry=lambda size, start_s: rates[start_s >= self.at_s].carry(size, start_s))
        return channel


def coded(codec: Any, images: list[Image]) -> Any:
    """Ten pictures a second."""
    encoder = codec.encoder(RATE_HZ)
    packets = [packet for image in images for packet in encoder.push(image)]
    units = tuple(SentPacket(packet.frame, len(packet.data), packet.starts, packet.frame + 1) for packet in packets)
    return SimpleNamespace(sequence=MemorySequence(images), codec=codec, packets=units)


def blank(count: int, kilobytes: int = 1) -> Any:
    return coded(Sized.create(kilobytes=kilobytes), [np.zeros((4, 4), np.uint8)] * count)


def delivered(folder: Path, stream: Any, link: Any, adapt: Any = ("kilobytes", (1, 50)), **more: Any) -> Delivery:
    adaptation = None if adapt is None else Adaptation(parameter=adapt[0], range=adapt[1])
    given_settings = {"link": "given", "mtu": 1000, "header_bytes": 0, "queue_policy": "fifo", "adapt": adaptation}
    plugins = Plugins(given=lambda _: link)
    return delivery_of(stream, LinkSettings(**{**given_settings, **more}), context(folder, 0, plugins))


def test_a_stream_takes_what_the_link_gives_from_the_second_second_on(tmp_path: Path) -> None:
    """100,000 bytes a second, of which nine tenths are 81,000 in nine pictures: a start of three and eight others of
    seven kilobytes are 77,000, and of eight they are 88,000. It then stays, so that no other start is sent."""
    found = delivered(tmp_path, blank(40), Constant.create(rate_kbps=800))
    assert found.sizes_bytes.tolist() == [3000] + [1000] * 9 + [21_000] + [7000] * 29
    assert [unit.session for unit in found.units] == [0] * 10 + [1] * 30
    assert set(found.outcomes) == {"on time"}


def test_the_reader_gets_what_the_sessions_sent(tmp_path: Path) -> None:
    stream = blank(30)
    found = delivered(tmp_path, stream, Constant.create(rate_kbps=800))
    pictures = DeliveredFrames(stream, found)
    assert [pictures.image(frame).max() for frame in found.output_frames] == [1] * 10 + [7] * 20  # type: ignore[union-attr]


def test_where_the_rate_halves_pictures_stay_on_time_with_adaptation_and_not_without(tmp_path: Path) -> None:
    """After four seconds 50,000 bytes a second are left. Without adaptation 7,000 a picture wait for 0.4 s more with
    each second. With it they do so for the second after which it is known; then the coarsest lets the queue drain, and
    of 40,500 bytes in nine pictures there is room for three kilobytes each and nine for the start."""
    link, deadline_ms = Halving.create(rate_kbps=800, queue_packets=9999), 600
    adapted = delivered(tmp_path, blank(100), link, deadline_ms=deadline_ms)
    assert set(adapted.outcomes) == {"on time"}
    assert adapted.sizes_bytes[30:50].tolist() == [7000] * 20
    assert adapted.sizes_bytes[50:60].tolist() == [3000] + [1000] * 9
    assert adapted.sizes_bytes[60:].tolist() == [9000] + [3000] * 39
    fixed = delivered(tmp_path, blank(100, 7), link, None, deadline_ms=deadline_ms)
    assert set(fixed.outcomes[:50]) == {"on time"}
    assert set(fixed.outcomes[60:]) == {"late"}


def test_a_session_whose_start_is_lost_is_broken_until_the_next(tmp_path: Path) -> None:
    """Also where made-up pictures are asked for: the decoder of the session before has no part in it."""
    stream = blank(40)
    for concealed in (False, True):
        found = delivered(tmp_path, stream, Losing(10), mtu=60_000, header_bytes=40, concealed=concealed)
        assert list(found.outcomes) == ["on time"] * 10 + ["lost"] + ["broken"] * 29
        assert DeliveredFrames(stream, found).image(9) is not None


def test_a_loss_in_a_session_is_concealed_by_its_own_decoder(tmp_path: Path) -> None:
    stream = blank(30)
    found = delivered(tmp_path, stream, Losing(5), mtu=60_000, header_bytes=40, concealed=True)
    assert list(found.outcomes) == ["on time"] * 5 + ["lost"] + ["concealed"] * 4 + ["on time"] * 20
    pictures = DeliveredFrames(stream, found)
    shown = [pictures.image(frame).max() for frame in found.output_frames]  # type: ignore[union-attr]
    assert shown == [1] * 5 + [255] * 4 + [50] * 20


def test_a_picture_that_never_comes_to_the_encoder_breaks_nothing(tmp_path: Path) -> None:
    """Encoding takes one and a half pictures: the session goes on with those that are taken."""
    stream = blank(40)
    link = Constant.create(rate_kbps=8000)
    found = delivered(tmp_path, stream, link, queue_policy="latest_only", encode_ms=150)
    assert set(found.outcomes) == {"on time", "skipped"}
    assert 0.25 < found.outcomes.count("skipped") / 40 < 0.4
    pictures = DeliveredFrames(stream, found)
    assert all(pictures.image(frame) is not None for frame in found.output_frames)


def test_a_codec_wrongly_declared_low_delay_is_named(tmp_path: Path) -> None:
    class Late(StreamCodec[NoParams]):
        name, version, params_type, capabilities = "late", "1", NoParams, Capabilities()

        def encoder(self, frame_rate_hz: float) -> Any:
            return SimpleNamespace(push=lambda image: [])

        def decoder(self) -> Any: ...

    stream = blank(2)
    stream.codec = type("Given", (Late,), {"params_type": SizedParams})(SizedParams())
    with pytest.raises(PluginError, match=r"^late .* 0 packets .*frame 0"):
        delivered(tmp_path, stream, Losing())


@settings(max_examples=60)
@given(
    link=st.sampled_from([
        Constant.create(rate_kbps=300, delay_ms=15, jitter_ms=10, loss=0.1, queue_packets=12),
        Constant.create(rate_kbps=900, delay_ms=1, queue="codel", queue_packets=60),
        GilbertElliott.create(rate_kbps=1500, good_ms=400, bad_ms=60, bad_loss=0.7, delay_ms=5, queue_packets=30),
        Halving.create(rate_kbps=600, queue_packets=40),
    ]),
    transport=st.sampled_from(["datagrams", "fec", "arq", "reliable"]),
    policy=st.sampled_from(["latest_only", "fifo", "drop_late", "auto"]),
    encode_ms=st.sampled_from([0.0, 130.0]),
    concealed=st.booleans(),
    count=st.integers(1, 70),
)  # fmt: skip
def test_whatever_is_sent_has_one_fate_and_a_picture_where_it_is_handed_on(
    tmp_path_factory: pytest.TempPathFactory, link: Link[Any], transport: str, policy: str, encode_ms: float,
    concealed: bool, count: int,
) -> None:  # fmt: skip
    more = {"transport": transport, "queue_policy": policy, "encode_ms": encode_ms, "concealed": concealed}
    if policy == "drop_late":
        more["deadline_ms"] = 400
    stream, folder = blank(count), tmp_path_factory.getbasetemp()
    found = delivered(folder, stream, link, **more)
    packets = found.packets
    assert packets.sent == packets.arrived + packets.lost + packets.dropped
    assert len(found.outcomes) == count
    frames = [unit.frame for unit in found.units]
    assert frames == sorted(found.bitstreams)
    begun = [unit.frame for unit in found.units if unit.starts]
    assert all(later - before >= RATE_HZ for before, later in pairwise(begun))
    pictures = DeliveredFrames(stream, found)
    for frame in found.output_frames:
        picture = pictures.image(frame)
        assert picture is not None
        assert (picture.max() == 255) == (found.outcomes[frame] == "concealed")
        assert picture.max() in (255, found.bitstreams[frame][0])
    again = delivered(folder, stream, link, **more)
    assert (again.outcomes, again.packets, again.bitstreams) == (found.outcomes, packets, found.bitstreams)


def moving(count: int) -> list[Image]:
    whole = skimage.data.astronaut()
    films = [whole[100 + 2 * i : 196 + 2 * i, 100 + 3 * i : 228 + 3 * i] for i in range(count)]
    noise = np.random.default_rng(0).normal(0, 8, (count, 96, 128, 3))
    return list(np.clip(np.stack(films) + noise, 0, 255).astype(np.uint8))


def require_adapts(folder: Path, codec: Any, parameter: str, ends: tuple[float, float], rate_kbps: float) -> None:
    """Of a link that halves its rate: on time with adaptation, and the pictures are what a decoder makes of sessions of
    their own; at the finest setting, which that link does not carry, late."""
    images = moving(60)
    stream, link = coded(codec, images), Halving.create(rate_kbps=rate_kbps, queue_packets=9999)
    link.at_s = 2.5
    found = delivered(folder, stream, link, (parameter, ends), deadline_ms=700)
    assert found.outcomes.count("on time") >= 58
    sessions = {unit.session for unit in found.units}
    assert 2 <= len(sessions) <= 6
    pictures = DeliveredFrames(stream, found)
    errors = [np.abs(pictures.image(frame).astype(int) - images[frame]).mean() for frame in found.output_frames]  # type: ignore[union-attr]
    assert max(errors) < 40
    finest = type(codec)(codec.params_type.model_validate({**codec.params.model_dump(), parameter: ends[1]}))
    fixed = deliver(
        coded(finest, images).packets, np.arange(60) / RATE_HZ, link,
        LinkSettings(link="given", mtu=1000, header_bytes=0, queue_policy="fifo", deadline_ms=700),
        np.random.default_rng(0),
    )  # fmt: skip
    assert fixed.outcomes.count("on time") < 30


def test_a_stream_of_ours_adapts(tmp_path: Path) -> None:
    require_adapts(tmp_path, MultilevelStream.create(qf=20), "qf", (90, 1), 500)


@pytest.mark.parametrize(
    ("name", "params", "parameter", "ends", "rate_kbps"),
    [
        ("H264", {"qp": 30}, "qp", (45, 15), 200),
        ("H264", {"qp": 30, "intra_refresh": True, "gop": 10}, "qp", (45, 15), 200),
        ("H264", {"bitrate_kbps": 100}, "bitrate_kbps", (30.0, 600.0), 200),
        ("Mjpeg", {"qp": 5}, "qp", (31, 2), 300),
    ],
)
def test_video_codecs_adapt(
    tmp_path: Path, name: str, params: dict[str, Any], parameter: str, ends: tuple[float, float], rate_kbps: float
) -> None:
    pytest.importorskip("av", reason="the extra `video` is not installed")
    from codecbench.plugins.codecs.video import codecs

    require_adapts(tmp_path, getattr(codecs, name).create(**params), parameter, ends, rate_kbps)
