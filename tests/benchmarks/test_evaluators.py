"""Time of the evaluators' work on 640x480 pictures. Run with `pytest tests/benchmarks`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from memory_sequence import CodedInMemory, FunctionCodec, MemorySequence, context, jpeg, textured

from codecbench.plugins.evaluators.features import Features
from codecbench.plugins.evaluators.quality.ssim import multiscale_similarity, similarity


@pytest.fixture(scope="module")
def pair() -> tuple[np.ndarray, np.ndarray]:
    gray = textured(480, 640)
    return gray, jpeg(gray, 20)


def test_both_ssims(benchmark: Any, pair: tuple[np.ndarray, np.ndarray]) -> None:
    found = benchmark.pedantic(similarity, pair, rounds=20, warmup_rounds=1)
    assert 0 < found.inner < 1


def test_ms_ssim(benchmark: Any, pair: tuple[np.ndarray, np.ndarray]) -> None:
    finest = similarity(*pair)
    found = benchmark.pedantic(multiscale_similarity, (*pair, finest), rounds=20, warmup_rounds=1)
    assert 0 < found < 1


def test_features_of_six_frames(benchmark: Any, tmp_path: Path) -> None:
    wall = textured(480, 640 + 6 * 6)
    images = [np.ascontiguousarray(wall[:, 6 * i : 6 * i + 640]) for i in range(6)]
    small = {image.tobytes(): jpeg(image, 20) for image in images}

    def evaluate() -> int:
        coded = CodedInMemory(MemorySequence(images), FunctionCodec(lambda image: small[image.tobytes()]))
        return len(list(Features.create().evaluate(coded, context(tmp_path))))

    assert benchmark.pedantic(evaluate, rounds=5, warmup_rounds=1) > 0
