"""Time of every installed codec with memory on ten 640x480 pictures. Run with `pytest tests/benchmarks`."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
import skimage.data

from codecbench import Packet, Picture, StreamCodec
from codecbench.core.engine.plugins.registry import installed

CODECS = [
    plugin.spec.name
    for plugin in installed().plugins("codec")
    if plugin.missing is None and issubclass(installed().load("codec", plugin.spec.name), StreamCodec)
]
"""Those that are installed: which others there are is known only where they are."""


@pytest.fixture(scope="module", params=["gray", "rgb"])
def pictures(request: pytest.FixtureRequest) -> list[np.ndarray]:
    """A picture that glides by three pixels a frame."""
    image = cv2.resize(skimage.data.astronaut(), (670, 480), interpolation=cv2.INTER_AREA)
    image = image if request.param == "rgb" else image[..., 1]
    return [np.ascontiguousarray(image[:, 3 * index : 3 * index + 640]) for index in range(10)]


@pytest.fixture(scope="module", params=CODECS)
def codec(request: pytest.FixtureRequest) -> Any:
    codec_class = installed().load("codec", request.param)
    return codec_class.create(**codec_class.examples[0])


def encoded(codec: Any, pictures: list[np.ndarray]) -> list[Packet]:
    session = codec.encoder(30.0)
    return [packet for picture in pictures for packet in session.push(picture)] + session.flush()


def decoded(codec: Any, packets: list[Packet]) -> list[Picture]:
    session = codec.decoder()
    return [picture for packet in packets for picture in session.push(packet)] + session.flush()


def test_encode_ten(benchmark: Any, codec: Any, pictures: list[np.ndarray]) -> None:
    packets = benchmark.pedantic(encoded, (codec, pictures), rounds=3, warmup_rounds=1)
    benchmark.extra_info["size_bytes"] = sum(len(packet.data) for packet in packets)
    assert len(packets) == len(pictures)


def test_decode_ten(benchmark: Any, codec: Any, pictures: list[np.ndarray]) -> None:
    found = benchmark.pedantic(decoded, (codec, encoded(codec, pictures)), rounds=3, warmup_rounds=1)
    assert [picture.state for picture in found] == ["whole"] * len(pictures)
