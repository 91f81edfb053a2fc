"""Speed of the multi-level codec and its stages; bars are for one core and 640x480.

pytest tests/benchmarks/test_multilevel.py --benchmark-only
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from codecbench.core.contracts.image import gray_from_image
from codecbench.plugins.codecs.dct.blocks import blocks_from_plane, plane_from_blocks
from codecbench.plugins.codecs.dct.tables import PAPER, steps_from_table
from codecbench.plugins.codecs.multilevel import Multilevel

benchmark_plugin = pytest.importorskip("pytest_benchmark")


@pytest.fixture(scope="module")
def color(data_folder: Path) -> np.ndarray:
    path = sorted((data_folder / "fr3_png16" / "rgb").glob("*.png"))[0]
    return cv2.cvtColor(cv2.imread(str(path)), cv2.COLOR_BGR2RGB)


@pytest.fixture(scope="module", params=["gray", "rgb"])
def picture(request: pytest.FixtureRequest, color: np.ndarray) -> np.ndarray:
    return gray_from_image(color) if request.param == "gray" else color


@pytest.mark.parametrize("qf", [5, 20, 100])
@pytest.mark.parametrize(("levels", "effort"), [(1, "best"), (1, "fast"), (2, "best")])
def test_encode_and_decode(benchmark, picture: np.ndarray, qf: int, levels: int, effort: str) -> None:  # type: ignore[no-untyped-def]
    """Bars at one level and QF 5: gray 5 ms, RGB 12 ms."""
    codec = Multilevel.create(qf=qf, levels=levels, effort=effort)
    decoded = benchmark.pedantic(lambda: codec.decode(codec.encode(picture)), rounds=20, iterations=1, warmup_rounds=2)
    assert decoded.shape == picture.shape


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("direction", ["encode", "decode"])
def test_slices_on_threads(benchmark, picture: np.ndarray, direction: str, threads: int) -> None:  # type: ignore[no-untyped-def]
    """The profile `context` in two slices; by the clock, on a machine of two cores that does nothing else."""
    codec = Multilevel.create(profile="context", qf=2, restart=15, threads=threads)
    argument = picture if direction == "encode" else codec.encode(picture)
    benchmark.pedantic(getattr(codec, direction), (argument,), rounds=20, iterations=1, warmup_rounds=2)


@pytest.mark.parametrize("direction", ["encode", "decode"])
@pytest.mark.parametrize("decoding", ["header", "search"])
def test_direction(benchmark, color: np.ndarray, direction: str, decoding: str) -> None:  # type: ignore[no-untyped-def]
    codec = Multilevel.create(decoding=decoding)
    argument = color if direction == "encode" else codec.encode(color)
    benchmark.pedantic(getattr(codec, direction), (argument,), rounds=20, iterations=1, warmup_rounds=2)


def test_blocks_from_plane(benchmark, color: np.ndarray) -> None:  # type: ignore[no-untyped-def]
    steps = steps_from_table(PAPER, 5)
    plane = gray_from_image(color)
    blocks = benchmark.pedantic(blocks_from_plane, (plane, steps), rounds=50, iterations=1, warmup_rounds=2)
    assert blocks.shape == (4800, 64)


def test_plane_from_blocks(benchmark, color: np.ndarray) -> None:  # type: ignore[no-untyped-def]
    steps = steps_from_table(PAPER, 5)
    blocks = blocks_from_plane(gray_from_image(color), steps)
    plane = benchmark.pedantic(plane_from_blocks, (blocks, (480, 640), steps), rounds=50, iterations=1, warmup_rounds=2)
    assert plane.shape == (480, 640)
