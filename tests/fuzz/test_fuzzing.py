"""What fuzzing found stays fixed, and the fuzzer finds what is broken."""

from __future__ import annotations

import logging
import re
from pathlib import Path
from typing import Any

import limits
import numpy as np
import pytest
from decoder_targets import TARGETS, Target
from limits import Finding, judge
from mutation import fuzz, mutated

from codecbench import BitstreamError, Image
from codecbench.plugins.codecs.raw import Raw

log = logging.getLogger("fuzz")
CORPUS = Path(__file__).parent / "corpus"
KEPT = sorted(path for path in CORPUS.glob("*/*") if path.is_file())
SHAPES = ((1, 1), (9, 17), (9, 17, 3))


@pytest.fixture(autouse=True)
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """Kernels may be compiled meanwhile, and the machine may be busy: only what hangs takes so long."""
    monkeypatch.setattr(limits, "MAX_TIME_S", 300.0)


@pytest.mark.parametrize("path", KEPT, ids=lambda path: f"{path.parent.name}-{path.name}")
def test_an_input_that_was_kept_is_survived(path: Path) -> None:
    judge(TARGETS[path.parent.name].codec(), path.read_bytes())


@pytest.mark.parametrize("target", TARGETS.values(), ids=TARGETS)
def test_a_repaired_bitstream_is_the_bitstream(target: Target) -> None:
    for bitstream in target.seeds(SHAPES):
        assert target.repair(bitstream) == bitstream


@pytest.mark.parametrize("target", [TARGETS[name] for name in ("raw", "png", "jpeg2000", "multilevel", "jpeg_qf")])
def test_repair_reaches_behind_the_checksum(target: Target) -> None:
    """With a byte near the end changed, the checksum is what refuses, and it does not once it is repaired."""
    bitstream = target.seeds(SHAPES)[-1]
    damaged = bytearray(bitstream)
    damaged[-20] ^= 1
    with pytest.raises(BitstreamError, match=r"checksum|CRC"):
        target.codec().decode(bytes(damaged))
    assert not re.search(r"checksum|CRC", judge(target.codec(), target.repair(bytes(damaged))).text)


@pytest.mark.parametrize("target", TARGETS.values(), ids=TARGETS)
def test_a_short_campaign_finds_nothing(target: Target, tmp_path: Path) -> None:
    campaign = fuzz(target, target.seeds(SHAPES), 5, tmp_path / "last", inputs=300)
    assert campaign.findings == {}
    assert campaign.inputs == sum(campaign.verdicts.values()) == 300


class _Trusting(Raw):
    """Fails in the three ways that the fuzzer looks for, on inputs that it has to find."""

    def decode(self, bitstream: bytes, **_: Any) -> Image:
        if bitstream[4:5] == b"\xff":
            raise IndexError("out of range")
        if bitstream[5:8] == b"\xff\xff\xff":
            np.ones(520 << 20, np.uint8)
        if bitstream[8:9] == b"\xff":
            return np.zeros((4, 4), np.uint8).astype(np.float32)
        return super().decode(bitstream)


class _TrustingTarget(Target):
    def codec_class(self) -> Any:
        return _Trusting


@pytest.mark.thorough
def test_the_fuzzer_finds_what_is_broken(tmp_path: Path) -> None:
    target = _TrustingTarget("trusting", TARGETS["raw"].repair)
    seed = Raw.create().encode(np.zeros((1, 1), np.uint8))
    campaign = fuzz(target, [seed], 1, tmp_path / "last", inputs=2000)
    found = " ".join(campaign.findings)
    assert "IndexError: out" in found
    assert "ImageError" in found


def test_memory_and_results_are_judged() -> None:
    codec = _Trusting.create()
    bitstream = bytearray(Raw.create().encode(np.zeros((1, 1), np.uint8)))
    assert judge(codec, bytes(bitstream)).kind == "decoded"
    bitstream[5:8] = b"\xff\xff\xff"
    with pytest.raises(Finding, match=r"5\d\d MiB"):
        judge(codec, bytes(bitstream))


def test_mutations_differ_and_repeat() -> None:
    data = bytes(range(200))
    first = [mutated(data, data, np.random.default_rng(seed)) for seed in range(50)]
    assert first == [mutated(data, data, np.random.default_rng(seed)) for seed in range(50)]
    assert len({*first, data}) > 45


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "setting", "shape"),
    [
        ("png", {}, (8192, 8192, 3)),
        ("jpeg", {"quality": 1}, (8192, 8192, 3)),
        ("jpeg", {"quality": 1, "progressive": True, "subsampling": "444"}, (8192, 4096, 3)),
        ("jpeg_qf", {"qf": 1000, "optimize": True}, (4096, 4096, 3)),
        ("jpeg2000", {"ratio": 50}, (4096, 4096, 3)),
        ("multilevel", {"qf": 1000}, (4728, 4728, 3)),
        ("multilevel", {"qf": 1000, "color": "gray"}, (8192, 8192, 3)),
    ],
)
def test_the_largest_pictures_stay_within_the_limits(
    name: str, setting: dict[str, Any], shape: tuple[int, ...], rng: np.random.Generator
) -> None:
    """Few bytes that stand for as many pixels as a decoder takes. Logs the rows of the table in docs/reliability.md."""
    label = " ".join([f"`{name}`", *(f"{key}={value}" for key, value in setting.items())])
    image = np.full(shape, 100, np.uint8)
    image[:200, :200] = rng.integers(0, 256, (200, 200, *shape[2:]))
    codec = TARGETS[name].codec_class().create(**setting)
    bitstream = codec.encode(image)
    del image
    codec.decode(codec.encode(np.zeros((8, 8, *shape[2:]), np.uint8)))
    verdict = judge(codec, bitstream)
    assert verdict.kind == "decoded"
    picture, memory = f"{shape[1]}x{shape[0]} RGB", f"{verdict.memory_bytes >> 20} MiB"
    log.info("| %s | %s | %s | %.1f s | %s |", label, picture, f"{len(bitstream):,}", verdict.time_s, memory)
