"""The `operations` evaluator: which families there are for whom, and what they hold."""

from __future__ import annotations

import io
import math
import pickle
import shutil
from collections import defaultdict
from pathlib import Path
from typing import Any, ClassVar

import cv2
import numpy as np
import pytest
from codecbench_delta.codec import Delta
from memory_sequence import MemorySequence, context, textured
from PIL import Image as PillowImage
from pydantic import ValidationError

from codecbench.core.contracts.errors import Unsupported
from codecbench.plugins.codecs import jpeg2000
from codecbench.plugins.codecs.jpeg import Jpeg
from codecbench.plugins.codecs.jpeg2000 import Jpeg2000
from codecbench.plugins.codecs.jpeg_qf.codec import JpegQf
from codecbench.plugins.codecs.multilevel import Multilevel
from codecbench.plugins.codecs.raw import Raw
from codecbench.plugins.evaluators.operations import Operations, machine, machine_child, model
from codecbench.plugins.evaluators.operations.machine import classify, counters_of, read_profile, reassign_to_owners

FRAMES = MemorySequence([textured(480, 640, seed) for seed in range(3)])
SMALL = MemorySequence([textured(24, 32, seed) for seed in range(5)])


def values(codec: Any, folder: Path, sequence: MemorySequence = FRAMES, **params: Any) -> dict[str, dict[str, float]]:
    """Metric -> stage -> value, of the only frame sampled."""
    found: dict[str, dict[str, float]] = defaultdict(dict)
    declared = {metric.name for metric in Operations.metrics}
    for measured in Operations.create(**params).evaluate(codec, sequence, context(folder)):
        assert measured.metric in declared
        assert measured.stage not in found[measured.metric]
        found[measured.metric][measured.stage or ""] = measured.value
    return found


@pytest.mark.parametrize(
    ("codec", "encode", "decode"),
    [
        (Jpeg.create(quality=50), 5084160, 4500480),
        (JpegQf.create(qf=10), 5084160, 4500480),
        (Jpeg2000.create(ratio=10), 39442560, 25870720),
        (Multilevel.create(qf=10, decoding="search"), 6110464, 11273664),
    ],
)
def test_the_model_gives_the_totals_of_the_paper(codec: Any, encode: int, decode: int, tmp_path: Path) -> None:
    totals = values(codec, tmp_path, families=["model"])["model_total"]
    assert (totals["encode"], totals["decode"]) == (encode, decode)
    for direction in ("encode", "decode"):
        parts = [value for stage, value in totals.items() if stage.startswith(f"{direction}/")]
        assert sum(parts) == totals[direction]
        assert len(parts) >= 4


def test_an_opaque_codec_has_no_source_counts(tmp_path: Path) -> None:
    found = values(Jpeg.create(), tmp_path)
    assert found
    assert {name.split("_")[0] for name in found} == {"model"}


@pytest.mark.thorough
def test_source_counts_add_up_over_stages(tmp_path: Path) -> None:
    found = values(JpegQf.create(qf=10), tmp_path, SMALL, families=["source"])
    assert {name.split("_")[0] for name in found} == {"source"}
    for stages in found.values():
        for direction in ("encode", "decode"):
            assert stages[direction] == sum(v for stage, v in stages.items() if stage.startswith(f"{direction}/"))
    assert found["source_total"]["encode"] > 0
    classes = ("mults", "adds", "bit_ops", "comparisons", "shifts", "reads", "writes")
    assert found["source_total"]["decode/idct"] == sum(found[f"source_{name}"]["decode/idct"] for name in classes)


def test_a_codec_with_neither_is_unsupported_with_both_reasons(tmp_path: Path) -> None:
    with pytest.raises(Unsupported, match=r"raw is opaque.*no model"):
        values(Raw.create(), tmp_path)
    with pytest.raises(Unsupported, match="no model of jpeg2000"):
        values(Jpeg2000.create(lossless=True), tmp_path, SMALL)


def test_a_codec_with_memory_is_opaque(tmp_path: Path) -> None:
    for family in ("source", "model", "machine"):
        with pytest.raises(Unsupported, match="delta is opaque"):
            list(Operations.create(families=[family]).evaluate(Delta.create(), SMALL, context(tmp_path)))


def test_frames_are_spread_over_the_sequence(tmp_path: Path) -> None:
    evaluator = Operations.create(frames=2, families=["model"])
    frames = {measured.frame for measured in evaluator.evaluate(Jpeg.create(), SMALL, context(tmp_path))}
    assert frames == {1, 3}


def test_families_have_one_spelling() -> None:
    assert Operations.create(families=["model", "source"]).params == Operations.create().params
    with pytest.raises(ValidationError, match="source, model, machine"):
        Operations.create(families=[])


@pytest.mark.parametrize(
    ("codec", "samples"),
    [
        (Jpeg.create(subsampling="420"), 1.5),
        (Jpeg.create(subsampling="422"), 2.0),
        (Jpeg2000.create(ratio=10), 3.0),
        (Multilevel.create(color="rgb"), 3.0),
        (Multilevel.create(color="ycbcr420"), 1.5),
        (Multilevel.create(color="gray"), 1.0),
    ],
)
def test_all_planes_of_a_color_image(codec: Any, samples: float) -> None:
    image = np.zeros((480, 640, 3), np.uint8)
    planes = model.coded_planes(image, codec.params.model_dump())
    assert sum(plane.samples for plane in planes) == samples * 480 * 640


def test_the_measured_share_is_that_of_the_coefficients_in_the_file() -> None:
    """Against the blocks that libjpeg's own quantiser leaves unequal to zero, told by decoding them again."""
    image = textured(48, 64, 3)
    bitstream = Jpeg.create(quality=30).encode(image)
    steps = np.array(PillowImage.open(io.BytesIO(bitstream)).quantization[0], float).reshape(8, 8)  # type: ignore[attr-defined]
    nonzero = 0
    for row in range(0, 48, 8):
        for column in range(0, 64, 8):
            block = cv2.dct(image[row : row + 8, column : column + 8].astype(np.float64) - 128)
            nonzero += np.count_nonzero(np.round(np.abs(block) / steps))
    assert model.measure_nonzero_share(image, bitstream) == pytest.approx(nonzero / image.size, abs=2e-3)
    assert 0 < nonzero / image.size < 0.5


@pytest.mark.parametrize(
    ("mnemonic", "counters"),
    [
        ("MULPS", ("mults",)), ("IMUL", ("mults",)), ("VFMADD231PD", ("mults", "adds")), ("PMADDWD", ("mults", "adds")),
        ("IDIV", ("mults", "divisions")), ("SQRTSD", ("mults", "divisions")), ("VDIVPS", ("mults", "divisions")),
        ("ADD", ("adds",)), ("VPADDD", ("adds",)), ("SUBSD", ("adds",)), ("LEA", ("adds",)), ("PABSW", ("adds",)),
        ("INC", ("adds",)), ("PXOR", ("bit_ops",)), ("VANDPS", ("bit_ops",)), ("NOT", ("bit_ops",)),
        ("BT", ("bit_ops",)),
        ("CMP", ("comparisons",)), ("TEST", ("comparisons",)), ("PCMPEQB", ("comparisons",)),
        ("MAXSD", ("comparisons",)),
        ("PMINUB", ("comparisons",)), ("SHL", ("shifts",)), ("VPSRLDQ", ("shifts",)), ("SARX", ("shifts",)),
        ("ROL", ("shifts",)), ("MOV", ()), ("VMOVDQU", ()), ("JNE", ()), ("CALL", ()), ("PSHUFB", ()), ("CVTSI2SD", ()),
        ("PUNPCKLBW", ()), ("SETE", ()), ("RET", ()), ("NOP", ()), ("PACKUSWB", ()), ("INSERTPS", ()), ("MOVMSKPS", ()),
    ],
)  # fmt: skip
def test_each_instruction_has_its_class(mnemonic: str, counters: tuple[str, ...]) -> None:
    assert counters_of(mnemonic) == counters


PROFILE = """
positions: instr line
ob=/lib/one.so
fn=f
0x1000 0 5
0x1004 0 2
cob=/lib/two.so
calls=2 0x30 0
0x1004 0 900
0x40 0 7

ob=/lib/two.so
fn=g
0x40 0 1
"""


def test_profiles_are_read_without_the_cost_of_calls_and_jumps_find_their_library() -> None:
    objects = read_profile(PROFILE.splitlines())
    assert objects["/lib/one.so"] == {0x1000: 5, 0x1004: 2, 0x40: 7}
    code = {"/lib/one.so": [(0x1000, b"\x90" * 16)], "/lib/two.so": [(0, b"\x90" * 128)]}
    assert reassign_to_owners(objects, code) == {"/lib/one.so": {0x1000: 5, 0x1004: 2}, "/lib/two.so": {0x40: 8}}


def test_instructions_are_classified_with_their_memory_operands() -> None:
    pytest.importorskip("iced_x86", reason="the extra `machine` is not installed")
    text = bytes.fromhex("4801 07480faf 0ec5fc5807c390")  # add [rdi], rax; imul rcx, [rsi]; vaddps; ret; nop
    counts, unknown = classify(
        read_profile(["ob=x", *(f"0x{a:x} 0 10" for a in (0, 3, 7, 11, 12, 99))])["x"], [(0, text)]
    )
    assert (counts.adds, counts.mults, counts.reads, counts.writes) == (20, 10, 10 + 10 + 10 + 10, 10)
    assert unknown == 10


def test_a_machine_without_valgrind_gives_a_reason_and_no_number(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: None)
    found = values(Jpeg.create(), tmp_path, SMALL, families=["model", "machine"])
    assert math.isnan(found["machine_total"]["encode"])
    assert found["model_total"]["encode"] > 0
    with pytest.raises(Unsupported, match="install valgrind"):
        values(Jpeg.create(), tmp_path, SMALL, families=["machine"])


class _Profiler:
    """Stands in for callgrind: what it was asked to profile, by label."""

    profiled: ClassVar[dict[str, Any]] = {}

    def profile(self, function: Any, argument: Any, label: str) -> Any:
        self.profiled[label] = function
        return function(argument)


def test_the_profiled_process_searches_before_it_counts(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    codec = Jpeg2000.create(cr_percent=80)
    expected = codec.encode(textured(64, 80, 1))
    (tmp_path / "task.pickle").write_bytes(pickle.dumps((Jpeg2000, codec.params, textured(64, 80, 1))))
    monkeypatch.setattr(machine_child, "Callgrind", _Profiler)
    monkeypatch.setattr(machine_child, "_SET_PARENT_DEATH_SIGNAL", 0)  # no such request: this process goes on
    machine_child.main(tmp_path)
    monkeypatch.setattr(jpeg2000, "png_bytes", None)  # a search would ask for the size of the PNG
    assert _Profiler.profiled["encode"](textured(64, 80, 1)) == expected
    assert (tmp_path / "kernels.pickle").exists()


@pytest.mark.slow
@pytest.mark.skipif(machine.reason_unavailable() is not None, reason=str(machine.reason_unavailable()))
def test_machine_counts_repeat_and_grow_with_the_image() -> None:
    codec = Jpeg.create(quality=75)
    small, again, large = (machine.count_executed(codec, textured(height, 320, 1)) for height in (160, 160, 320))
    for direction in ("encode", "decode"):
        assert small[direction].total == pytest.approx(again[direction].total, rel=2e-3)
        assert 1.5 < large[direction].mults / small[direction].mults < 2.5
        assert small[direction].reads > 160 * 320 / 16
