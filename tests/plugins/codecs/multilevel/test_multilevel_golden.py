"""Golden bitstreams: what version 1 wrote must stay readable, and stay what version 1 writes.

Set CODECBENCH_REGENERATE_GOLDEN to write them anew; raise the codec's version when their bytes change.
"""

from __future__ import annotations

import hashlib
import json
import os

import pytest
from multilevel_pictures import textured
from project import GOLDEN

from codecbench.plugins.codecs.multilevel import Multilevel

FOLDER = GOLDEN / "multilevel"
DIGESTS = FOLDER / "decoded_sha256.json"

GOLDEN: dict[str, tuple[int, dict[str, object]]] = {
    "gray": (1, {}),
    "rgb_qf100": (3, {"qf": 100}),
    "two_levels": (1, {"levels": 2, "qf": 10}),
    "search": (1, {"decoding": "search", "levels": 2, "qf": 20}),
    "random_keys": (1, {"decoding": "search", "keys": "random", "seed": 7}),
    "manual_keys": (1, {"decoding": "search", "keys": (0.1234567891, 0.52345678987, 0.87987654321), "qf": 50}),
    "groups_of_four_by_frequency": (3, {"group": 4, "scan": "coefficient", "color": "ycbcr420", "qf": 15}),
    "fast": (1, {"effort": "fast"}),
    "custom_table": (3, {"table": tuple(range(2, 66)), "color": "ycbcr444", "qf": 0.75}),
    "standard_table_as_gray": (3, {"table": "standard", "color": "gray", "qf": 1}),
    "context_gray": (1, {"profile": "context", "qf": 1.5}),
    "context_fast_with_restart_points": (3, {"profile": "context", "qf": 1, "effort": "fast", "restart": 1}),
    "context_standard_table_lapped": (
        3,
        {
            "profile": "context",
            "qf": 0.5,
            "effort": "normal",
            "table": "standard",
            "lapped": True,
            "color": "ycbcr444",
        },
    ),
}


def digest(image) -> str:  # type: ignore[no-untyped-def]
    return hashlib.sha256(repr(image.shape).encode() + image.tobytes()).hexdigest()


@pytest.fixture(scope="module")
def digests() -> dict[str, str]:
    if os.environ.get("CODECBENCH_REGENERATE_GOLDEN"):
        FOLDER.mkdir(parents=True, exist_ok=True)
        written = {}
        for name, (channels, setting) in GOLDEN.items():
            codec = Multilevel.create(**setting)
            stream = codec.encode(textured(45, 61, channels))
            (FOLDER / f"{name}.cbml").write_bytes(stream)
            written[name] = digest(codec.decode(stream))
        DIGESTS.write_text(json.dumps(written, indent=1) + "\n")
    return json.loads(DIGESTS.read_text())  # type: ignore[no-any-return]


@pytest.mark.parametrize("name", GOLDEN)
def test_golden_bitstream(name: str, digests: dict[str, str]) -> None:
    channels, setting = GOLDEN[name]
    stream = (FOLDER / f"{name}.cbml").read_bytes()
    assert digest(Multilevel.create().decode(stream)) == digests[name]
    assert Multilevel.create(**setting).encode(textured(45, 61, channels)) == stream


def test_no_golden_bitstream_is_left_over(digests: dict[str, str]) -> None:
    assert set(digests) == set(GOLDEN) == {path.stem for path in FOLDER.glob("*.cbml")}
