"""What coding through the engine costs beside bare calls of the codec: sessions, packets, checks, checksums.

JPEG frames of 640x480 are coded, decoded and measured both ways in turn, so that whatever else the machine does befalls
both alike.
Run with `pytest tests/benchmarks/test_contract.py --benchmark-json FILE`.
"""

from __future__ import annotations

import io
import statistics
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import cv2
import numpy as np
import pytest
import skimage.data
from memory_sequence import MemorySequence, context

from codecbench.core.contracts.evaluator import CodedFrame, Measurement
from codecbench.core.engine.planning.model import PluginSetting
from codecbench.core.engine.plugins.registry import own_registry
from codecbench.core.engine.plugins.serving import keep_memory
from codecbench.core.engine.running.coding.coded_frames import CodedFrames
from codecbench.core.engine.running.coding.encoding import encode_sequence
from codecbench.core.engine.running.coding.position import WorkPosition
from codecbench.core.engine.running.workbench import PluginFactory
from codecbench.core.engine.storage.bitstream_file import BitstreamFile, write_bitstreams
from codecbench.plugins.codecs.jpeg import Jpeg
from codecbench.plugins.evaluators.quality import Quality

FRAMES: Final = 10
ROUNDS: Final = 20
JOB: Final = "0f"
CODEC: Final = Jpeg.create(quality=30)
QUALITY: Final = Quality.create()


@pytest.fixture(scope="module", params=["gray", "rgb"])
def sequence(request: pytest.FixtureRequest) -> MemorySequence:
    """A picture that glides by three pixels a frame; reading costs nothing on either side."""
    image = cv2.resize(skimage.data.astronaut(), (640 + 3 * FRAMES, 480), interpolation=cv2.INTER_AREA)
    image = image if request.param == "rgb" else image[..., 1]
    return MemorySequence([np.ascontiguousarray(image[:, 3 * at : 3 * at + 640]) for at in range(FRAMES)])


def encoded_bare(sequence: MemorySequence) -> list[bytes]:
    return [CODEC.encode(image) for image in sequence.images]


def encoded_by_engine(sequence: MemorySequence) -> list[bytes]:
    return [packet.data for packet in encode_sequence(CODEC, sequence, WorkPosition())]


class Bare:
    """Decodes as CodedFrames does, and nothing else."""

    def __init__(self, sequence: MemorySequence, bitstreams: list[bytes]) -> None:
        self.sequence, self.codec, self._bitstreams = sequence, CODEC, bitstreams

    def __len__(self) -> int:
        return len(self._bitstreams)

    def size_bytes(self, index: int) -> int:
        return len(self._bitstreams[index])

    def frame(self, index: int) -> CodedFrame:
        bitstream = self._bitstreams[index]
        return CodedFrame(self.sequence.read(index), bitstream, CODEC.decode(bitstream))

    def __iter__(self) -> Iterator[CodedFrame]:
        return map(self.frame, range(len(self)))


def by_engine(sequence: MemorySequence, bitstreams: list[bytes]) -> CodedFrames:
    file = io.BytesIO()
    write_bitstreams(file, bitstreams, JOB)
    return CodedFrames(sequence, CODEC, BitstreamFile(file.getvalue(), JOB), WorkPosition())


def side_by_side(
    benchmark: Any,
    bare: Callable[[], Any],
    engine: Callable[[], Any],
    clock: Callable[[], float] = time.process_time,
) -> None:
    """Times of the process for one frame, and the median of what the engine adds in each round, in percent.

    Who is first changes with each round.
    """
    taken: dict[Callable[[], Any], list[float]] = {bare: [], engine: []}

    def both() -> None:
        order = (bare, engine) if len(taken[bare]) % 2 else (engine, bare)
        for work in order:
            begun = clock()
            work()
            taken[work].append(clock() - begun)

    benchmark.pedantic(both, rounds=ROUNDS, warmup_rounds=2)
    added = [100 * (ours / theirs - 1) for ours, theirs in zip(taken[engine], taken[bare], strict=True)]
    benchmark.extra_info["bare_ms"] = 1e3 * statistics.median(taken[bare]) / FRAMES
    benchmark.extra_info["engine_ms"] = 1e3 * statistics.median(taken[engine]) / FRAMES
    benchmark.extra_info["overhead_percent"] = statistics.median(added)


def test_encode(benchmark: Any, sequence: MemorySequence) -> None:
    assert encoded_by_engine(sequence) == encoded_bare(sequence)
    side_by_side(benchmark, lambda: encoded_bare(sequence), lambda: encoded_by_engine(sequence))


def test_decode(benchmark: Any, sequence: MemorySequence) -> None:
    bitstreams = encoded_bare(sequence)
    side_by_side(benchmark, lambda: list(Bare(sequence, bitstreams)), lambda: list(by_engine(sequence, bitstreams)))


def test_cell(benchmark: Any, sequence: MemorySequence, tmp_path: Path) -> None:
    """All that a cell of `quality` takes: encoding, decoding, measuring."""

    def bare() -> list[Measurement]:
        coded: Any = Bare(sequence, encoded_bare(sequence))
        return list(QUALITY.evaluate(coded, context(tmp_path)))

    def engine() -> list[Measurement]:
        return list(QUALITY.evaluate(by_engine(sequence, encoded_by_engine(sequence)), context(tmp_path)))

    assert engine() == bare()
    side_by_side(benchmark, bare, engine)


def test_hosts(benchmark: Any, sequence: MemorySequence, tmp_path: Path) -> None:
    """A JPEG cell whose codec decodes in a host, as those of other distributions do, by the wall clock."""
    keep_memory()  # as workers do
    plugins, file = PluginFactory(own_registry()), io.BytesIO()
    params = CODEC.params.model_dump(mode="json")
    hosted = plugins.create(PluginSetting("codec", "jpeg", Jpeg.version, params, distribution="codecbench"), JOB)
    packets = [packet.data for packet in encode_sequence(hosted, sequence, WorkPosition())]
    assert packets == encoded_bare(sequence)
    write_bitstreams(file, packets, JOB)

    def cell(codec: Any) -> list[Measurement]:
        coded = CodedFrames(sequence, codec, BitstreamFile(file.getvalue(), JOB), WorkPosition())
        return list(QUALITY.evaluate(coded, context(tmp_path)))

    assert cell(hosted) == cell(CODEC)
    side_by_side(benchmark, lambda: cell(CODEC), lambda: cell(hosted), time.perf_counter)
    plugins.end()
