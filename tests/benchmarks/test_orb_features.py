"""Speed of `orb_features` on sets of 1000 features; the bar is 3 ms for encoding and decoding, on one core.

pytest tests/benchmarks/test_orb_features.py --benchmark-only
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from codecbench.core.contracts.features import Features
from codecbench.core.contracts.image import gray_from_image
from codecbench.plugins.codecs.orb_features.codec import OrbFeatures
from codecbench.plugins.datasets.tum import Tum

benchmark_plugin = pytest.importorskip("pytest_benchmark")

FRAMES = 30
SETTINGS: dict[str, dict[str, Any]] = {
    "intra": {},
    "inter": {"mode": "inter"},
    "lossy": {"mode": "inter", "angle_bits": 6, "descriptor": "lossy"},
    "raw": {"descriptor": "raw"},
}


@pytest.fixture(scope="module")
def film(data_folder: Path) -> list[Features]:
    sequence, codec = Tum.create(path=str(data_folder / "fr3_office_715")).open(), OrbFeatures.create()
    return [codec.extract(gray_from_image(sequence.read(index).image)) for index in range(FRAMES)]


@pytest.mark.parametrize("direction", ["encode", "decode"])
@pytest.mark.parametrize("setting", SETTINGS.values(), ids=SETTINGS)
def test_one_set_after_another(benchmark: Any, film: list[Features], setting: dict[str, Any], direction: str) -> None:
    """Each round takes the next set of the film, so that with memory all but the first are coded after another."""
    codec = OrbFeatures.create(gop=FRAMES, **setting)
    first = codec.encoder()
    packets = [first.push(found) for found in film]
    session, sets = (codec.encoder(), film) if direction == "encode" else (codec.decoder(), packets)
    arguments = iter(sets)
    benchmark.pedantic(lambda: session.push(next(arguments)), rounds=FRAMES - 2, iterations=1, warmup_rounds=2)  # type: ignore[arg-type]
    benchmark.extra_info["bytes_a_feature"] = sum(len(packet.data) for packet in packets) / sum(map(len, film))
