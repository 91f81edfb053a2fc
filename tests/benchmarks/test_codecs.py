"""Time of every installed codec on 640x480 pictures of each layout it takes. Run with `pytest tests/benchmarks`."""

from __future__ import annotations

from functools import cache
from typing import Any

import cv2
import numpy as np
import pytest
import skimage.data

from codecbench import Codec, Image
from codecbench.core.contracts.image import layout_of
from codecbench.core.engine.plugins.registry import Plugin, installed
from codecbench.plugins.datasets.synthetic.dataset import Synthetic


@cache
def pictures() -> dict[str, Image]:
    """A photograph in color and gray, and what a depth sensor sees of a room."""
    image = cv2.resize(skimage.data.astronaut(), (640, 480), interpolation=cv2.INTER_AREA)
    depth = Synthetic.create(stream="depth", frames=1).open().read(0).image
    return {"gray": np.ascontiguousarray(image[..., 1]), "rgb": np.ascontiguousarray(image), "depth": depth}


@pytest.fixture(scope="module", params=["gray", "rgb", "depth"])
def picture(request: pytest.FixtureRequest, codec: Any) -> Image:
    image = pictures()[request.param]
    if layout_of(image) not in codec.capabilities.layouts:
        pytest.skip(f"{codec.name} does not take {layout_of(image)}")
    return image


def codes_pictures(plugin: Plugin) -> bool:
    """Whether the codec codes single pictures, or is not installed, which the test then says."""
    return plugin.missing is not None or issubclass(installed().load("codec", plugin.spec.name), Codec)


@pytest.fixture(
    scope="module", params=[plugin.spec.name for plugin in installed().plugins("codec") if codes_pictures(plugin)]
)
def codec(request: pytest.FixtureRequest) -> Any:
    missing = installed().find("codec", request.param).missing
    if missing is not None:
        pytest.skip(missing)
    codec_class = installed().load("codec", request.param)
    return codec_class.create(**codec_class.examples[0])


def test_encode(benchmark: Any, codec: Any, picture: np.ndarray) -> None:
    bitstream = benchmark.pedantic(codec.encode, (picture,), rounds=9, warmup_rounds=2)
    benchmark.extra_info["size_bytes"] = len(bitstream)
    benchmark.extra_info["setting"] = " ".join(f"{key}={value}" for key, value in codec.examples[0].items())
    assert codec.decode(bitstream).shape == picture.shape


def test_decode(benchmark: Any, codec: Any, picture: np.ndarray) -> None:
    bitstream = codec.encode(picture)
    decoded = benchmark.pedantic(codec.decode, (bitstream,), rounds=9, warmup_rounds=2)
    assert decoded.shape == picture.shape
