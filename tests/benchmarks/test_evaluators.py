"""Time of the evaluators' work on 640x480 pictures. Run with `pytest tests/benchmarks`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from memory_sequence import CodedInMemory, FunctionCodec, MemorySequence, Plugins, context, jpeg, textured

from codecbench.core.contracts.evaluator import CodedFrame, SequenceEvaluator
from codecbench.core.contracts.sequence import Frame, FrameSequence
from codecbench.plugins.codecs.jpeg import Jpeg
from codecbench.plugins.datasets.synthetic.dataset import Synthetic
from codecbench.plugins.evaluators.features import Features
from codecbench.plugins.evaluators.fidelity import multiscale_similarity, similarity
from codecbench.plugins.evaluators.localization import Localization
from codecbench.plugins.evaluators.relative_pose import RelativePose
from codecbench.plugins.slam_backends.orb import Orb


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


class Filmed(MemorySequence):
    """Frames of another sequence, held in memory with what evaluators keep beside them, as in a worker."""

    def __init__(self, source: FrameSequence) -> None:
        self.kept = [source.read(index) for index in range(len(source))]
        super().__init__([frame.image for frame in self.kept], source.camera, source.ground_truth)
        self.timestamps_s, self.frame_rate_hz = source.timestamps_s, source.frame_rate_hz

    def read(self, index: int) -> Frame:
        return self.kept[index]


class Stored(CodedInMemory):
    """Every frame coded beforehand and decoded whenever it is asked for."""

    def __init__(self, sequence: FrameSequence, quality: int) -> None:
        super().__init__(sequence)
        self.codec = Jpeg.create(quality=quality)
        self.bitstreams = [self.codec.encode(sequence.read(index).image) for index in range(len(sequence))]

    def frame(self, index: int) -> CodedFrame:
        bitstream = self.bitstreams[index]
        return CodedFrame(self.sequence.read(index), bitstream, self.codec.decode(bitstream))


@pytest.fixture(scope="module")
def film() -> Filmed:
    return Filmed(Synthetic.create(world="room", frames=60).open())


@pytest.mark.parametrize(
    ("evaluator", "metric"),
    [
        pytest.param(Localization.create(), "located_auc", id="localization"),
        pytest.param(RelativePose.create(), "correct_matches", id="relative_pose"),
    ],
)
def test_one_frame_or_pair(
    benchmark: Any, tmp_path: Path, film: Filmed, evaluator: SequenceEvaluator[Any], metric: str
) -> None:
    """All that a setting costs, decoding included; the round before pays for the map and the raw frames' features."""
    plugins = Plugins(orb=lambda params: Orb.create(**params))
    coded = Stored(film, 20)

    def asked() -> int:
        found = evaluator.evaluate(coded, context(tmp_path, 0, plugins))  # type: ignore[arg-type]
        return sum(m.metric == metric and math.isfinite(m.value) for m in found)

    benchmark.extra_info["units"] = benchmark.pedantic(asked, rounds=5, warmup_rounds=1)
    assert benchmark.extra_info["units"] > 20
