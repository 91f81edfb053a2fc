"""Ten thousand damaged bitstreams of each profile: no crash, no hang, and no picture changed in silence."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from damage import damaged_copies
from decoder_targets import TARGETS
from multilevel_pictures import textured

from codecbench.core.contracts.codec import Fragment
from codecbench.core.contracts.errors import BitstreamError
from codecbench.plugins.codecs.multilevel import Multilevel

COUNT = 10_000
SLOWEST_S = 4.0
DECODER = Multilevel.create()
SETTINGS: dict[str, tuple[dict[str, Any], ...]] = {
    "static": (
        {},
        {"decoding": "search"},
        {"effort": "fast"},
        {"levels": 2, "scan": "coefficient"},
        {"levels": 2, "decoding": "search", "keys": "random"},
        {"levels": 3, "group": 2, "color": "ycbcr420", "table": tuple(range(1, 65))},
        {"levels": 2, "group": 4, "keys": "random", "effort": "fast", "table": "flat", "color": "ycbcr420"},
        {"qf": 40.0, "decoding": "search", "keys": (0.1234567891, 0.52345678987, 0.87987654321)},
    ),
    "context": (
        {"qf": 1},
        {"qf": 0.3, "effort": "normal", "color": "ycbcr444", "lapped": True},
        {"qf": 2, "effort": "fast", "color": "rgb"},
        {"qf": 1, "restart": 1},
        {"qf": 4, "restart": 1, "lapped": True, "effort": "fast", "color": "gray"},
        {"qf": 0.5, "table": tuple(range(8, 72)), "chroma": 3},
    ),
}
Coded = list[tuple[bytes, np.ndarray]]


@pytest.fixture(scope="module", params=SETTINGS)
def coded(request: pytest.FixtureRequest) -> Coded:
    """Bitstreams of a profile, each with what it decodes to."""
    image = textured(40, 56, 3)
    streams = [Multilevel.create(profile=request.param, **one).encode(image) for one in SETTINGS[request.param]]
    return [(stream, DECODER.decode(stream)) for stream in streams]


def decoded_ones(
    coded: Coded, seed: int, repair: Callable[[bytes], bytes], within_s: float = math.inf
) -> list[tuple[int, bytes, np.ndarray]]:
    """Which bitstream, its damaged copy and the picture, of those copies that are not refused; each in time."""
    streams, found, slowest_s = [stream for stream, _ in coded], [], 0.0
    for index, copy in damaged_copies(streams, COUNT, np.random.default_rng(seed)):
        data, start = repair(copy), time.process_time()
        with suppress(BitstreamError):
            found.append((index, data, DECODER.decode(data)))
        slowest_s = max(slowest_s, time.process_time() - start)
    assert slowest_s < within_s
    return found


def test_damage_is_refused(coded: Coded) -> None:
    for index, copy, picture in decoded_ones(coded, 1, bytes):
        stream, whole = coded[index]
        assert copy == stream
        assert np.array_equal(picture, whole)


@pytest.mark.thorough
def test_damage_behind_valid_checksums(coded: Coded) -> None:
    """Without their help the decoder must still neither crash nor hang; most damage it sees."""
    unseen = decoded_ones(coded, 2, TARGETS["multilevel"].repair, SLOWEST_S)
    assert all(picture.dtype == np.uint8 for _, _, picture in unseen)
    assert len(unseen) < COUNT / 2


@pytest.mark.thorough
def test_what_is_salvaged_is_right() -> None:
    """Slices of a damaged bitstream that are called whole are those of the whole picture, to the last bit."""
    settings = [one for one in SETTINGS["context"] if "restart" in one]
    image = textured(120, 56, 3)
    streams = [Multilevel.create(profile="context", **one).encode(image) for one in settings]
    pictures = [DECODER.decode(stream) for stream in streams]
    whole_rows = 0
    for index, copy in damaged_copies(streams, COUNT, np.random.default_rng(3)):
        if not copy:
            continue
        try:
            found = DECODER.decode_partial([Fragment(0, copy)])
        except BitstreamError:
            continue
        assert np.array_equal(found.image[found.whole], pictures[index][found.whole])
        whole_rows += int(found.whole[:, 0].sum())
    assert whole_rows > 0
