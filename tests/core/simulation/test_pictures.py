"""What a decoder makes of what came: pictures that are whole, made up, or none."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import skimage.data
from codecbench_delta.codec import Delta
from losing_link import Losing

from codecbench.core.contracts.evaluator import SentPacket
from codecbench.core.simulation.delivery import DeliveredFrames, deliver
from codecbench.core.simulation.receiver import PartialDecoder
from codecbench.core.simulation.settings import LinkSettings
from codecbench.plugins.codecs.jpeg import Jpeg
from codecbench.plugins.codecs.png import Png

COUNT = 12


def film() -> list[np.ndarray]:
    rng = np.random.default_rng(3)
    return [rng.integers(0, 256, (8, 10), dtype=np.uint8) for _ in range(COUNT)]


def coded(images: list[np.ndarray], gop: int, hold: int = 0) -> Any:
    """A stream, of which frames can be asked as they are without any loss."""
    encoder = Delta.create(gop=gop, hold=hold).encoder(10.0)
    packets, units = {}, []
    for given, image in enumerate(images, 1):
        for packet in encoder.push(image) + (encoder.flush() if given == COUNT else []):
            packets[packet.frame] = packet.data
            units.append(SentPacket(packet.frame, len(packet.data), packet.starts, given))
    frames = {i: SimpleNamespace(bitstream=packets[i], decoded=images[i]) for i in range(COUNT)}
    return SimpleNamespace(packets=tuple(units), codec=Delta.create(), frame=frames.__getitem__)


def received(stream: Any, lost: tuple[int, ...], concealed: bool) -> dict[int, np.ndarray | None]:
    link = Losing(*lost)
    settings = LinkSettings(link="given", queue_policy="fifo", concealed=concealed)
    delivery = deliver(stream.packets, np.arange(COUNT) / 10, link, settings, np.random.default_rng(0))
    pictures = DeliveredFrames(stream, delivery)
    return {frame: pictures.image(frame) for frame in delivery.output_frames}


@pytest.mark.parametrize("concealed", [False, True])
def test_without_loss_every_picture_is_the_one_that_was_sent(concealed: bool) -> None:
    images = film()
    found = received(coded(images, 5), (), concealed)
    assert list(found) == list(range(COUNT))
    assert all(np.array_equal(found[frame], images[frame]) for frame in found)


def test_after_a_loss_pictures_come_back_with_the_next_start() -> None:
    images = film()
    found = received(coded(images, 5), (2,), concealed=False)
    assert list(found) == [0, 1, *range(5, COUNT)]
    assert all(np.array_equal(found[frame], images[frame]) for frame in found)


def test_what_the_decoder_makes_up_is_what_the_reader_gets() -> None:
    """This codec shows its last whole picture again."""
    images = film()
    found = received(coded(images, 5), (2,), concealed=True)
    assert list(found) == [0, 1, 3, 4, *range(5, COUNT)]
    for frame, picture in found.items():
        assert np.array_equal(picture, images[1 if frame in (3, 4) else frame]), frame


def test_an_encoder_that_holds_back_loses_and_conceals_the_same() -> None:
    images = film()
    found = received(coded(images, 5, hold=3), (2,), concealed=True)
    assert list(found) == [0, 1, 3, 4, *range(5, COUNT)]
    assert np.array_equal(found[4], images[1])


def test_a_picture_that_came_in_part_is_what_the_codec_makes_of_it() -> None:
    codec = Jpeg.create(quality=90, restart=1)
    images = [skimage.data.camera()[frame : frame + 128, ::4].copy() for frame in range(3)]
    bitstreams = [codec.encode(image) for image in images]
    units = tuple(SentPacket(frame, len(data), True, frame + 1) for frame, data in enumerate(bitstreams))
    frames = [SimpleNamespace(bitstream=data, decoded=codec.decode(data)) for data in bitstreams]
    stream: Any = SimpleNamespace(packets=units, codec=codec, frame=frames.__getitem__)
    link = Losing(1)
    settings = LinkSettings(link="given", partial=True, mtu=-(-max(map(len, bitstreams)) // 3) + 40)
    partial_decode = PartialDecoder(stream, {}).whole_share
    delivery = deliver(
        units, np.arange(3) / 10, link, settings, np.random.default_rng(0), partial_decode=partial_decode
    )
    assert delivery.outcomes == ("partial", "on time", "on time")
    pictures = DeliveredFrames(stream, delivery)
    first = pictures.image(0)
    assert first is not None
    assert first.shape == images[0].shape
    assert 0.3 < (first == frames[0].decoded).mean() < 1.0
    assert np.array_equal(pictures.image(1), frames[1].decoded)


def test_a_codec_that_cannot_decode_parts_loses_its_pictures() -> None:
    stream: Any = SimpleNamespace(codec=Png.create(), frame=None)
    assert PartialDecoder(stream, {}).decode(0, ((0, 100),)) is None
