"""The links that ship: each keeps the contract, and does what is known of it."""

from __future__ import annotations

import gzip
import re
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from codecbench import Link, Passage, Unsupported
from codecbench.core.conformance.links import check_link
from codecbench.core.engine.plugins.registry import installed
from codecbench.plugins.links.constant import Constant
from codecbench.plugins.links.generator import TRACES, main, trace
from codecbench.plugins.links.gilbert_elliott import GilbertElliott
from codecbench.plugins.links.trace import Trace, embedded_trace, opportunities_ms

SETTINGS: dict[str, dict[str, Any]] = {
    "constant": {"rate_kbps": 1000, "delay_ms": 10, "loss": 0.1},
    "gilbert_elliott": {"rate_kbps": 1000, "good_ms": 100, "bad_ms": 10, "jitter_ms": 3, "jitter": "uniform"},
}
LINKS = [plugin.spec.name for plugin in installed().plugins("link")]


def passages(link: Link[Any], size_bytes: int, gap_s: float, count: int, seed: int = 0) -> list[Passage]:
    """Packets of one size, each `gap_s` after the one before, or when that has left."""
    channel = link.open(np.random.default_rng(seed))
    found: list[Passage] = []
    for number in range(count):
        found.append(channel.carry(size_bytes, max(number * gap_s, found[-1].sent_s if found else 0.0)))
    return found


@pytest.mark.parametrize("name", LINKS)
def test_every_link_keeps_the_contract(name: str) -> None:
    check_link(installed().create("link", name, SETTINGS.get(name, {})))


def test_a_constant_link_takes_the_time_of_its_rate_and_its_delay() -> None:
    (first, second) = passages(Constant.create(rate_kbps=1000, delay_ms=30), 1250, 0.0, 2)
    assert first == pytest.approx((0.010, 0.040))
    assert second == pytest.approx((0.020, 0.050))


@pytest.mark.parametrize(("distribution", "deviation_ms"), [("exponential", 4.0), ("uniform", 8.0 / np.sqrt(12.0))])
def test_jitter_has_its_mean_and_its_distribution(distribution: str, deviation_ms: float) -> None:
    link = Constant.create(rate_kbps=1000, delay_ms=30, jitter_ms=4, jitter=distribution)
    found = passages(link, 125, 0.01, 20_000)
    extra_ms = np.array([1e3 * (p.arrives_s - p.sent_s) - 30.0 for p in found if p.arrives_s is not None])
    assert extra_ms.min() > -1e-6
    assert extra_ms.mean() == pytest.approx(4.0, rel=0.03)
    assert extra_ms.std() == pytest.approx(deviation_ms, rel=0.03)


def test_packets_are_lost_independently_at_the_stated_share() -> None:
    lost = np.array(
        [p.arrives_s is None for p in passages(Constant.create(rate_kbps=1000, loss=0.2), 125, 0.01, 40_000)]
    )
    assert lost.mean() == pytest.approx(0.2, abs=0.008)  # four standard errors
    assert (lost[1:] & lost[:-1]).mean() == pytest.approx(0.04, abs=0.004)


@pytest.mark.thorough
def test_bursts_of_gilbert_and_elliott_have_their_mean_lengths() -> None:
    link = GilbertElliott.create(rate_kbps=1e6, good_ms=300, bad_ms=100)
    lost = [p.arrives_s is None for p in passages(link, 100, 0.001, 300_000)]
    assert np.mean(lost) == pytest.approx(0.25, abs=0.03)
    runs = [(state, sum(1 for _ in members)) for state, members in groupby(lost)]
    for state, mean_ms in ((True, 100.0), (False, 300.0)):
        lengths = np.array([length for found, length in runs if found == state])
        assert lengths.mean() == pytest.approx(mean_ms, abs=4.0 * mean_ms / np.sqrt(len(lengths)) + 1.0)
        assert lengths.std() == pytest.approx(lengths.mean(), rel=0.15)  # as exponential times are


def test_losses_in_each_state_are_those_stated() -> None:
    link = GilbertElliott.create(rate_kbps=1e6, good_ms=300, bad_ms=100, good_loss=0.05, bad_loss=0.5)
    lost = np.mean([p.arrives_s is None for p in passages(link, 100, 0.001, 200_000)])
    assert lost == pytest.approx(0.75 * 0.05 + 0.25 * 0.5, abs=0.02)


def test_fades_do_not_depend_on_what_is_sent() -> None:
    link = GilbertElliott.create(rate_kbps=1e6, good_ms=300, bad_ms=100)
    often = [p.arrives_s is None for p in passages(link, 100, 0.001, 20_000)]
    seldom = [p.arrives_s is None for p in passages(link, 100, 0.01, 2_000)]
    assert often[::10] == seldom


def trace_file(folder: Path, *times_ms: int) -> Path:
    path = folder / "own.trace"
    path.write_text("".join(f"{time}\n" for time in times_ms))
    return path


def test_a_trace_gives_its_opportunities_and_loops(tmp_path: Path) -> None:
    link = Trace.create(file=trace_file(tmp_path, 2, 5, 10), offset_ms=0, delay_ms=1)
    found = passages(link, 1500, 0.0, 7)
    assert [p.sent_s for p in found] == pytest.approx([0.002, 0.005, 0.010, 0.012, 0.015, 0.020, 0.022])
    assert all(p.arrives_s == pytest.approx(p.sent_s + 0.001) for p in found)


def test_small_packets_share_an_opportunity_and_large_ones_take_several(tmp_path: Path) -> None:
    link = Trace.create(file=trace_file(tmp_path, 2, 5, 10), offset_ms=0)
    assert [p.sent_s for p in passages(link, 750, 0.0, 4)] == pytest.approx([0.002, 0.002, 0.005, 0.005])
    assert [p.sent_s for p in passages(link, 4000, 0.0, 2)] == pytest.approx([0.010, 0.020])


def test_an_opportunity_that_nobody_waits_for_is_gone(tmp_path: Path) -> None:
    channel = Trace.create(file=trace_file(tmp_path, 2, 5, 10), offset_ms=0).open(np.random.default_rng(0))
    assert [channel.carry(100, start_s).sent_s for start_s in (0.001, 0.003, 0.0051, 0.0101)] == pytest.approx(
        [0.002, 0.005, 0.010, 0.012]
    )


@pytest.mark.parametrize("name", TRACES)
def test_the_throughput_of_a_trace_is_its_opportunities(name: str) -> None:
    times_ms = embedded_trace(name)  # type: ignore[arg-type]
    found = passages(Trace.create(trace=name, offset_ms=0), 1500, 0.0, 2 * len(times_ms))
    assert found[-1].sent_s == pytest.approx(2e-3 * times_ms[-1])
    received_kbps = 8e-3 * 1500 * len(found) / found[-1].sent_s
    assert received_kbps == pytest.approx(12.0 * len(times_ms) / (1e-3 * times_ms[-1]))


def test_a_trace_begins_where_chance_says_or_where_it_is_told(tmp_path: Path) -> None:
    own = trace_file(tmp_path, *range(10, 1010, 10))
    starts = {passages(Trace.create(file=own), 1500, 0.0, 1, seed)[0].sent_s for seed in range(20)}
    assert len(starts) > 5
    assert passages(Trace.create(file=own, offset_ms=1005), 1500, 0.0, 1)[0].sent_s == pytest.approx(0.005)


@pytest.mark.parametrize(
    ("text", "words"),
    [("1\ntwo\n", ":2: got 'two'"), ("5\n4\n", ":2: 4 comes after 5"), ("", "above 0"), ("0\n", "above 0")],
)
def test_what_is_no_trace_is_named_with_its_line(text: str, words: str) -> None:
    with pytest.raises(Unsupported, match=words):
        opportunities_ms(text, "x.trace")


def test_a_missing_trace_is_unsupported(tmp_path: Path) -> None:
    with pytest.raises(Unsupported, match=f"{re.escape(str(tmp_path / 'none'))} .*Mahimahi file"):
        Trace.create(file=tmp_path / "none")


def test_a_trace_counts_with_its_content(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    own = trace_file(tmp_path, 1, 2)
    same = trace_file(tmp_path / "a", 1, 2)
    identities = [Trace.create(file=path).params.identity() for path in (own, same)]
    assert identities[0] == identities[1]
    trace_file(tmp_path, 1, 3)
    assert Trace.create(file=own).params.identity() != identities[0]


@pytest.mark.parametrize("name", TRACES)
def test_the_traces_that_ship_are_those_that_the_generator_makes(name: str) -> None:
    assert embedded_trace(name) == trace(TRACES[name])  # type: ignore[arg-type]


def test_a_wandering_rate_has_its_mean() -> None:
    model = TRACES["lte_still"]
    found = len(trace(model, 300.0)) / 300.0
    assert found == pytest.approx(model.mean_pps, rel=0.05)


def test_the_generator_writes_what_ships(tmp_path: Path) -> None:
    main(tmp_path)
    for name in TRACES:
        written = gzip.decompress((tmp_path / f"{name}.gz").read_bytes()).decode()
        assert opportunities_ms(written, name) == embedded_trace(name)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "params", [{"rate_kbps": 0}, {"rate_kbps": 1, "loss": 1.0}, {"rate_kbps": 1, "queue_packets": 0}]
)
def test_wrong_parameters_are_refused(params: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        Constant.create(**params)
