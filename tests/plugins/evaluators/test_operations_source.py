"""Source counts of every codec that counts: equal to the interpreter's, and to themselves on every run."""

from __future__ import annotations

from dataclasses import astuple
from typing import Any

import numpy as np
import pytest
from memory_sequence import textured
from opcode_oracle import OracleTrace

from codecbench.core.contracts.image import Image
from codecbench.core.counting.trace import CountingTrace
from codecbench.plugins.codecs.jpeg_qf.codec import JpegQf
from codecbench.plugins.codecs.multilevel import Multilevel
from codecbench.plugins.evaluators.operations.evaluator import source_counts

pytestmark = pytest.mark.thorough

CODECS = {
    "jpeg_qf": JpegQf.create(qf=5),
    "jpeg_qf optimized 4:2:0": JpegQf.create(qf=20, color="ycbcr420", optimize=True),
    "multilevel": Multilevel.create(qf=10),
    "multilevel two levels, search": Multilevel.create(qf=50, levels=2, decoding="search"),
}


def picture(channels: int) -> Image:
    planes = [textured(17, 22, seed) for seed in range(channels)]
    return planes[0] if channels == 1 else np.ascontiguousarray(np.dstack(planes))


def listed(counts: dict[str, Any]) -> dict[str, list[int]]:
    return {stage: list(astuple(one)) for stage, one in counts.items()}


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # the interpreter warns where integers wrap
@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("name", CODECS)
def test_counts_equal_those_of_the_interpreter(name: str, channels: int) -> None:
    codec, image = CODECS[name], picture(channels)
    counting, watching = CountingTrace(), OracleTrace()
    bitstream = codec.encode(image, trace=counting)
    assert codec.encode(image, trace=watching) == bitstream
    assert listed(counting.counts) == watching.counters

    counting, watching = CountingTrace(), OracleTrace()
    decoded = codec.decode(bitstream, trace=counting)
    np.testing.assert_array_equal(codec.decode(bitstream, trace=watching), decoded)
    assert listed(counting.counts) == watching.counters


@pytest.mark.parametrize("name", CODECS)
def test_counts_are_the_same_on_every_run(name: str) -> None:
    codec, image = CODECS[name], textured(64, 80)
    assert source_counts(codec, image) == source_counts(codec, image)
