"""What arrives over a link, as cells of a run say it."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import skimage.data
from memory_sequence import Plugins, context
from pydantic import ValidationError

from codecbench.core.contracts.evaluator import Measurement, Outcome, SentPacket
from codecbench.core.engine.planning.description import without_defaults
from codecbench.plugins.codecs.jpeg import Jpeg
from codecbench.plugins.codecs.raw import Raw
from codecbench.plugins.evaluators.delivery import DeliveryEvaluator
from codecbench.plugins.links.constant import Constant, Ideal
from codecbench.plugins.links.presets import WifiEdge

PLUGINS = Plugins(
    ideal=lambda params: Ideal.create(**params),
    constant=lambda params: Constant.create(**params),
    wifi_edge=lambda params: WifiEdge.create(**params),
)


def coded(sizes: list[int], rate_hz: float = 10.0) -> Any:
    """A coded sequence of which only sizes are known: nothing else may be asked of it."""
    packets = tuple(SentPacket(frame, size, True, frame + 1) for frame, size in enumerate(sizes))
    sequence = SimpleNamespace(timestamps_s=1.3e9 + np.arange(len(sizes)) / rate_hz, frame_rate_hz=rate_hz)
    return SimpleNamespace(packets=packets, sequence=sequence, codec=Raw.create())


def measured(folder: Path, sizes: list[int], repeat: int = 0, **params: Any) -> list[Measurement]:
    return list(DeliveryEvaluator.create(**params).evaluate(coded(sizes), context(folder, repeat, PLUGINS)))


def values(found: list[Measurement], metric: str) -> list[float]:
    return [m.value for m in found if m.metric == metric]


def test_every_metric_is_measured_and_no_other(tmp_path: Path) -> None:
    found = measured(tmp_path, [3000] * 40, link="wifi_edge")
    of_parts = {"partial_share", "partial_whole_share"}
    assert {m.metric for m in found} == {metric.name for metric in DeliveryEvaluator.metrics} - of_parts
    assert all(m.reason for m in found if math.isnan(m.value))


@pytest.mark.parametrize(("params", "is_partial"), [({"restart": 1}, True), ({}, False)])
def test_pictures_that_came_in_part_say_how_much_of_them_is_whole(
    tmp_path: Path, params: dict[str, Any], is_partial: bool
) -> None:
    codec = Jpeg.create(quality=80, **params)
    bitstream = codec.encode(skimage.data.camera()[::4, ::4])
    known = coded([len(bitstream)] * 200)
    known.codec, known.frame = codec, lambda index: SimpleNamespace(bitstream=bitstream)
    lossy = {"link": "constant", "link_params": {"rate_kbps": 1e5, "loss": 0.1}, "mtu": 540, "partial": True}
    found = list(DeliveryEvaluator.create(**lossy).evaluate(known, context(tmp_path, 0, PLUGINS)))
    (share,), (whole,) = values(found, "partial_share"), values(found, "partial_whole_share")
    assert (share > 0.3) == is_partial
    assert (0.5 < whole < 1.0) == is_partial
    sent_kbps = 8e-3 * len(bitstream) / 0.1
    all_of_them = np.mean(values(found, "on_time")) * sent_kbps
    assert values(found, "goodput_kbps")[0] == pytest.approx(all_of_them, rel=0.3 if is_partial else 1e-9)
    assert (values(found, "goodput_kbps")[0] < 0.99 * all_of_them) == is_partial
    assert all(m.reason for m in found if math.isnan(m.value))


def test_a_slow_link_by_hand(tmp_path: Path) -> None:
    """275 ms for each picture of 1,060 bytes and 40 of headers, every 100 ms: pictures 0, 2, 5 and 7 are sent."""
    constant = {"link": "constant", "link_params": {"rate_kbps": 32}, "deadline_ms": 330}
    found = measured(tmp_path, [1060] * 8, **constant)
    assert values(found, "on_time") == [1, 0, 0, 0, 0, 1, 0, 0]
    assert values(found, "delay_ms")[0] == pytest.approx(275)
    assert values(found, "delay_ms")[5] == pytest.approx(325, abs=1e-3)
    assert values(found, "age_ms") == pytest.approx([0, 100, 200, 300, 400, 500, 600, 700], abs=1e-3)
    shares = {name: values(found, f"{name}_share") for name in ("late", "lost", "broken", "skipped")}
    assert shares == {"late": [2 / 8], "lost": [0.0], "broken": [0.0], "skipped": [4 / 8]}
    assert values(found, "goodput_kbps") == pytest.approx([8e-3 * 2 * 1060 / 0.8])
    assert values(found, "sent_kbps") == pytest.approx([8e-3 * 4 * 1100 / 0.8])
    assert values(found, "wasted_share") == pytest.approx([0.5])
    assert values(found, "packets_late") == [2.0]
    assert values(found, "longest_stall_s") == pytest.approx([0.55], abs=1e-6)
    assert (values(found, "stalls_half_s"), values(found, "stalls_1_s")) == ([1.0], [0.0])
    missing = next(m for m in found if m.metric == "delay_ms" and m.frame == 1)
    assert str(missing.reason).endswith(" skipped")


def test_a_timeline_shows_the_age_of_the_newest_frame(tmp_path: Path) -> None:
    """Pictures 0, 2, 5 and 7 of eight come, each 275 ms after it was begun with."""
    evaluator = DeliveryEvaluator.create(link="constant", link_params={"rate_kbps": 32})
    found = tuple(evaluator.evaluate(coded([1060] * 8), context(tmp_path, 0, PLUGINS)))
    drawing = evaluator.drawing(Outcome(0, found, tmp_path))
    age, delay = drawing.lines
    assert age.points == pytest.approx(
        np.array([[0, 0], [0.275, 0.275], [0.275, 0.275], [0.55, 0.55], [0.55, 0.35], [0.825, 0.625],
                  [0.825, 0.325], [1.1, 0.6], [1.1, 0.4], [1.1, 0.4]]), abs=1e-5,
    )  # fmt: skip
    assert delay.points == pytest.approx(np.array([[0, 0.275], [0.2, 0.35], [0.5, 0.325], [0.7, 0.4]]), abs=1e-5)
    assert drawing.caption == "50 % on time, 50 % skipped"
    assert drawing.axes == ("time [s]", "age [s]")
    assert (drawing.timeline.positions, drawing.timeline.quantity) == (None, age.name)
    assert drawing.timeline.errors == pytest.approx(np.array(values(found, "age_ms")) / 1e3, abs=1e-5)
    rows = {row.name: np.flatnonzero(row.holds).tolist() for row in drawing.timeline.rows}
    assert rows == {"on time": [0, 2, 5, 7], "skipped": [1, 3, 4, 6]}


def test_a_timeline_from_before_fates_were_kept_is_drawn_without_them(tmp_path: Path) -> None:
    (tmp_path / "timeline.csv").write_text("0.000000,0.100000\n0.100000,inf\n")
    drawing = DeliveryEvaluator.create().drawing(Outcome(0, (), tmp_path))
    assert drawing.timeline.errors == pytest.approx([0.0, 0.1], abs=1e-9)
    assert drawing.timeline.rows == ()


def test_where_nothing_comes_its_age_only_rises(tmp_path: Path) -> None:
    evaluator = DeliveryEvaluator.create(link="constant", link_params={"rate_kbps": 32}, deadline_ms=10)
    found = tuple(evaluator.evaluate(coded([1060] * 8), context(tmp_path, 0, PLUGINS)))
    (age,) = evaluator.drawing(Outcome(0, found, tmp_path)).lines
    assert age.points == pytest.approx(np.array([[0, 0], [0.7, 0.7]]), abs=1e-5)


def test_every_codec_meets_the_same_luck_and_every_repeat_another(tmp_path: Path) -> None:
    sizes = [3000] * 60
    first, again, other = (values(measured(tmp_path, sizes, r, link="wifi_edge"), "on_time") for r in (0, 0, 1))
    assert first == again
    assert first != other
    seeded = values(measured(tmp_path, sizes, 0, link="wifi_edge", link_seed=4), "on_time")
    assert seeded != first


def test_smaller_pictures_survive_better(tmp_path: Path) -> None:
    lossy = {"link": "constant", "link_params": {"rate_kbps": 1e6, "loss": 0.05}}
    shares = [np.mean(values(measured(tmp_path, [size] * 500, **lossy), "on_time")) for size in (1000, 10_000, 50_000)]
    assert shares[0] > 0.9 > shares[1] > 0.5 > 0.3 > shares[2]


def test_the_link_is_declared_and_more_repeats_change_no_identity() -> None:
    evaluator = DeliveryEvaluator.create(link="constant", link_params={"rate_kbps": 5}, repeats=9)
    (used,) = evaluator.uses
    assert (used.kind, used.name, used.params) == ("link", "constant", {"rate_kbps": 5})
    assert evaluator.repeats == 9
    identities = [evaluator.repeat_identity(repeat) for repeat in range(9)]
    fewer = DeliveryEvaluator.create(link="constant", link_params={"rate_kbps": 5})
    assert all(identity == fewer.repeat_identity(0) for identity in identities)
    assert without_defaults(identities[0], evaluator.params) == {"link": "constant", "link_params": {"rate_kbps": 5}}


def test_delivery_needs_a_link() -> None:
    with pytest.raises(ValidationError, match="link: ideal"):
        DeliveryEvaluator.create(link=None)
