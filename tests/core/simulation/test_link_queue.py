"""Queues before a link, against what their disciplines say by hand."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

from codecbench import Channel, Passage, PluginError, Queue
from codecbench.core.simulation.link_queue import INTERVAL_S, EventSimulator, Packet, link_queue
from codecbench.plugins.links.constant import Constant


def dropped_at(discipline: str, gap_s: float, count: int, service_s: float = 0.01) -> tuple[list[float], int]:
    """When a queue drops packets that come every `gap_s`, and how many went."""
    simulator, drops, went = EventSimulator(), [], []

    def on_outcome(packet: Packet, passage: Passage | None) -> None:
        (drops if passage is None else went).append(simulator.now_s)

    channel = Constant.create(rate_kbps=8.0 / service_s).open(np.random.default_rng(0))  # of 1,000 bytes
    queue = link_queue(simulator, channel, Queue(1000, discipline), on_outcome, lambda: None)  # type: ignore[arg-type]
    for number in range(count):
        simulator.at(number * gap_s, lambda: queue.push(Packet(0, 1000)))
    simulator.run()
    assert queue.is_idle
    assert queue.waiting() == 0
    return drops, len(went)


def test_codel_drops_ever_more_often_after_an_interval() -> None:
    """A packet of 10 ms every 8 ms: the turn of number k comes at 10 k ms, after 2 k ms, with k / 4 behind it. From the
    eighth on that is longer than the target, and more than one packet waits."""
    drops, went = dropped_at("codel", 0.008, 400)
    assert len(drops) + went == 400
    gaps = np.diff(drops[:6])
    expected = [INTERVAL_S / math.sqrt(count) for count in range(1, 6)]
    assert gaps == pytest.approx(expected, abs=0.0101)  # drops happen when a packet's turn comes, every 10 ms
    assert drops[0] == pytest.approx(0.08 + INTERVAL_S)


def test_codel_leaves_a_short_burst_alone() -> None:
    assert dropped_at("codel", 0.0, 10) == ([], 10)


def test_codel_leaves_a_single_slow_packet_alone() -> None:
    """Each waits 40 ms behind one other, as on any slow link: there is never more than one packet to wait for."""
    assert dropped_at("codel", 0.05, 50, service_s=0.049)[0] == []


def test_a_full_queue_drops_the_newest() -> None:
    drops, went = dropped_at("drop_tail", 0.0, 1500)
    assert (len(drops), went) == (499, 1001)


@pytest.mark.parametrize("discipline", ["drop_tail", "codel"])
@pytest.mark.parametrize(
    "passage", [Passage(-1.0, 1.0), Passage(1.0, 0.5), Passage(math.nan, 1.0), Passage(1.0, math.inf)]
)
def test_a_link_that_answers_the_impossible_is_a_fault(discipline: str, passage: Passage) -> None:
    class Wrong(Channel):
        def carry(self, size_bytes: int, start_s: float) -> Passage:
            return passage

    simulator = EventSimulator()
    queue = link_queue(simulator, Wrong(), Queue(4, discipline), lambda *_: None, lambda: None)  # type: ignore[arg-type]
    with pytest.raises(PluginError, match=rf"^Wrong: .* 0(\.0)? s got {re.escape(str(passage))}$"):
        queue.push(Packet(0, 10))


def test_a_queue_without_room_is_none() -> None:
    with pytest.raises(ValueError, match="no room"):
        Queue(0)


def test_nothing_is_planned_for_the_past() -> None:
    simulator = EventSimulator()
    simulator.at(1.0, lambda: simulator.at(0.5, lambda: None))
    with pytest.raises(ValueError, match=r" 0\.5 s .* 1\.0 s,"):
        simulator.run()


def test_what_is_due_at_one_time_happens_in_the_order_of_planning() -> None:
    simulator, seen = EventSimulator(), []
    for name in "abc":
        simulator.at(1.0, lambda name=name: seen.append(name))  # type: ignore[misc]
    simulator.at(0.5, lambda: seen.append("first"))
    simulator.run()
    assert seen == ["first", "a", "b", "c"]
