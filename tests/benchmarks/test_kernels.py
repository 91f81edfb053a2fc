"""Speed of the codecs' kernels on one plane of 640x480: fast build, and counting build beside it.

The counting build is not meant to be fast; it is here so that a change that makes it slow is seen.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest

from codecbench.core.contracts.codec import Codec
from codecbench.core.contracts.image import Image
from codecbench.core.counting.kernel import Kernel
from codecbench.core.counting.operations import new_counters
from codecbench.plugins.codecs.dct.color import luma_from_rgb
from codecbench.plugins.codecs.jpeg_qf.codec import JpegQf
from codecbench.plugins.codecs.multilevel import Multilevel

CODECS: dict[str, Codec[Any]] = {"jpeg_qf": JpegQf.create(qf=5), "multilevel": Multilevel.create(qf=5)}

Call = tuple[Kernel, tuple[Any, ...]]


class Recorder:
    """A trace that notes every kernel that is run, with a copy of its arguments, by stage."""

    def __init__(self) -> None:
        self.calls: dict[str, list[Call]] = {}
        self._stage = ""

    def stage(self, name: str) -> Recorder:
        self._stage = name
        return self

    def __enter__(self) -> Callable[..., Any]:
        return self._run

    def __exit__(self, *_: object) -> None:
        return None

    def _run(self, kernel: Kernel, *arguments: Any) -> Any:
        kept = tuple(part.copy() if isinstance(part, np.ndarray) else part for part in arguments)
        self.calls.setdefault(self._stage, []).append((kernel, kept))
        return kernel(*arguments)


def picture() -> Image:
    noise = np.random.default_rng(0).standard_normal((480, 640))
    smooth = sum(weight * cv2.GaussianBlur(noise, (0, 0), weight) for weight in (1, 4, 16))
    return cv2.normalize(smooth, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)  # type: ignore[call-overload,no-any-return]


def stages() -> list[tuple[str, list[Call]]]:
    found = []
    for name, codec in CODECS.items():
        encoding, decoding = Recorder(), Recorder()
        codec.decode(codec.encode(picture(), trace=encoding), trace=decoding)
        for direction, recorder in (("encode", encoding), ("decode", decoding)):
            found += [(f"{name}/{direction}/{stage}", calls) for stage, calls in recorder.calls.items()]
    return found


STAGES = stages()


@pytest.mark.parametrize("build", ["fast", "counting"])
@pytest.mark.parametrize("calls", [calls for _, calls in STAGES], ids=[name for name, _ in STAGES])
def test_stage(benchmark: Any, calls: list[Call], build: str) -> None:
    counters = new_counters()
    first = [() if build == "fast" else (counters,)] * len(calls)
    run = [kernel.fast if build == "fast" else kernel.counting_build for kernel, _ in calls]

    def prepared() -> tuple[tuple[Any, ...], dict[str, Any]]:
        copies = [[p.copy() if isinstance(p, np.ndarray) else p for p in arguments] for _, arguments in calls]
        return (copies,), {}

    def work(copies: list[list[Any]]) -> None:
        for function, counting, arguments in zip(run, first, copies, strict=True):
            function(*counting, *arguments)

    work(*prepared()[0])
    benchmark.pedantic(work, setup=prepared, rounds=9)
    assert (counters.sum() > 0) == (build == "counting")


@pytest.mark.parametrize("through", ["kernel", "dispatcher"])
def test_one_call(benchmark: Any, through: str) -> None:
    """What a kernel costs over the dispatcher of its fast build: under a microsecond a call."""
    function = luma_from_rgb if through == "kernel" else luma_from_rgb.fast
    benchmark(function, np.zeros((1, 1, 3), np.uint8), np.zeros((1, 1), np.uint8))
