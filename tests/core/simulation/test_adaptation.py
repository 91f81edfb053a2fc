"""Pictures that are coded as the link asks."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from codecbench_delta.codec import Delta
from memory_sequence import MemorySequence, Plugins, context
from pydantic import Field

from codecbench import NULL_TRACE, Codec, Image, Params, Trace, Unsupported
from codecbench.core.contracts.codec import Capabilities
from codecbench.core.contracts.evaluator import SentPacket
from codecbench.core.simulation.adaptation import Throughput, adaptive_encoder
from codecbench.core.simulation.delivery import DeliveredFrames, Delivery, delivery_of
from codecbench.core.simulation.settings import Adaptation, LinkSettings
from codecbench.plugins.links.constant import Constant
from codecbench.plugins.links.trace import Trace as TraceLink

COUNT = 40


class SizedParams(Params):
    kilobytes: int = Field(default=1, ge=1, le=50)
    share: float = 0.5


class Sized(Codec[SizedParams]):
    """Bitstreams of the size that is asked for, which decode to pictures that show it."""

    name = "sized"
    version = "1"
    params_type = SizedParams
    capabilities = Capabilities()

    def encode(self, image: Image, *, trace: Trace = NULL_TRACE) -> bytes:
        return bytes([self.params.kilobytes]) * (1000 * self.params.kilobytes)

    def decode(self, bitstream: bytes, *, trace: Trace = NULL_TRACE) -> Image:
        return np.full((4, 4), bitstream[0], np.uint8)


def coded() -> Any:
    """Ten pictures a second, coded to 50 kilobytes each."""
    packets = tuple(SentPacket(frame, 50_000, True, frame + 1) for frame in range(COUNT))
    sequence = MemorySequence([np.zeros((4, 4), np.uint8)] * COUNT)
    return SimpleNamespace(sequence=sequence, codec=Sized.create(kilobytes=50), packets=packets)


def delivered(folder: Path, link: Any, low: int = 1, high: int = 50) -> Delivery:
    plugins = Plugins(given=lambda _: link)
    adapt = Adaptation(parameter="kilobytes", range=(low, high))
    settings = LinkSettings(link="given", mtu=1000, header_bytes=0, adapt=adapt)
    return delivery_of(coded(), settings, context(folder, 0, plugins))


def test_pictures_take_what_the_link_gives(tmp_path: Path) -> None:
    """100,000 bytes a second are 10,000 a picture, of which nine tenths are filled. The first is the coarsest."""
    found = delivered(tmp_path, Constant.create(rate_kbps=800))
    assert found.sizes_bytes.tolist() == [1000] + [9000] * (COUNT - 1)
    assert set(found.outcomes) == {"on time"}


def test_no_picture_leaves_the_range(tmp_path: Path) -> None:
    assert set(delivered(tmp_path, Constant.create(rate_kbps=800), 2, 6).sizes_bytes[1:].tolist()) == {6000}
    assert set(delivered(tmp_path, Constant.create(rate_kbps=800), 20, 30).sizes_bytes.tolist()) == {20_000}


def test_a_link_that_slows_down_gets_coarser_pictures(tmp_path: Path) -> None:
    """150,000 bytes a second for two seconds, then a tenth of that."""
    times_ms = [*range(0, 2000, 10), *range(2000, 4100, 100)]
    path = tmp_path / "slowing.trace"
    path.write_text("".join(f"{time_ms}\n" for time_ms in times_ms))
    found = delivered(tmp_path, TraceLink.create(file=path, offset_ms=0))
    early = found.sizes_bytes[2:18]
    late = [
        size for size, outcome in zip(found.sizes_bytes[32:], found.outcomes[32:], strict=True) if outcome == "on time"
    ]
    assert 10_000 <= early.min() <= early.max() <= 15_000
    assert late
    assert max(late) <= 3000


def test_the_reader_gets_the_pictures_that_were_sent(tmp_path: Path) -> None:
    found = delivered(tmp_path, Constant.create(rate_kbps=800))
    pictures = DeliveredFrames(coded(), found)
    assert pictures.image(0).max() == 1  # type: ignore[union-attr]
    assert pictures.image(1).max() == 9  # type: ignore[union-attr]


def test_a_range_may_fall_and_may_be_of_fractions() -> None:
    falling = adaptive_encoder(coded(), Adaptation(parameter="kilobytes", range=(9, 3)))
    assert falling.encode(0, None, 0).size_bytes == 9000
    assert len(falling.bitstreams[0]) == 9000
    fractions = adaptive_encoder(coded(), Adaptation(parameter="share", range=(0.1, 0.9)))
    assert fractions.encode(0, 1.0, 0).size_bytes == 50_000


@pytest.mark.parametrize(
    ("parameter", "ends", "words"),
    [("quality", (1, 5), "sized .*'quality'; .* share$"), ("kilobytes", (1, 60), "51")],
)
def test_what_the_codec_does_not_take_is_unsupported(parameter: str, ends: tuple[int, int], words: str) -> None:
    with pytest.raises(Unsupported, match=words):
        adaptive_encoder(coded(), Adaptation(parameter=parameter, range=ends))


def test_what_holds_pictures_back_cannot_adapt() -> None:
    held = SimpleNamespace(codec=Delta.create(hold=2), sequence=None)
    with pytest.raises(Unsupported, match="delta delays frames"):
        adaptive_encoder(held, Adaptation(parameter="gop", range=(1, 2)))  # type: ignore[arg-type]
    foreign = SimpleNamespace(codec=SimpleNamespace(name="features", carries="features"), sequence=None)
    with pytest.raises(Unsupported, match="features encodes neither"):
        adaptive_encoder(foreign, Adaptation(parameter="gop", range=(1, 2)))  # type: ignore[arg-type]


def test_throughput_is_of_the_time_in_which_something_was_sent() -> None:
    given = Throughput()
    assert given.bytes_per_s(0.0) is None
    given.add(1000, 0.0, 0.1)
    given.add(1000, 0.05, 0.2)  # waited for the first
    given.add(3000, 0.9, 1.0)
    assert given.bytes_per_s(0.1) == pytest.approx(10_000)
    assert given.bytes_per_s(0.95) == pytest.approx(10_000)  # the third has not left yet
    assert given.bytes_per_s(1.0) == pytest.approx(5000 / 0.3)
    assert given.bytes_per_s(1.15) == pytest.approx(4000 / 0.2)
    assert given.bytes_per_s(5.0) == pytest.approx(4000 / 0.2)  # nothing since: what was known last
