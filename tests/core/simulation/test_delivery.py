"""A coded sequence over a link: known answers, and what must hold of every journey."""

from __future__ import annotations

import math
from collections import Counter
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from losing_link import Losing
from pydantic import ValidationError
from scipy.stats import binom

from codecbench.core.contracts.evaluator import SentPacket
from codecbench.core.contracts.link import Link
from codecbench.core.simulation.delivery import Delivery, deliver
from codecbench.core.simulation.receiver import Ranges
from codecbench.core.simulation.settings import LinkSettings, ReaderSettings
from codecbench.plugins.links.constant import Constant, Ideal
from codecbench.plugins.links.gilbert_elliott import GilbertElliott
from codecbench.plugins.links.trace import Trace, embedded_trace

HEADERS = {"mtu": 1000, "header_bytes": 0}


def stills(sizes: list[int]) -> list[SentPacket]:
    return [SentPacket(frame, size, True, frame + 1) for frame, size in enumerate(sizes)]


def sent(
    link: Link[Any], sizes: list[int], rate_hz: float = 10.0, seed: int = 0, stamps_s: Any = None, **params: Any
) -> Delivery:
    """Pictures that stand alone over a link that is not asked by name."""
    stamps_s = np.arange(len(sizes)) / rate_hz if stamps_s is None else stamps_s
    given = LinkSettings(link="given", **{**HEADERS, **params})
    return deliver(stills(sizes), stamps_s, link, given, np.random.default_rng(seed))


def latencies_s(found: Delivery) -> np.ndarray:
    return (found.handed_s - found.captured_s)[found.output_frames]


def test_over_an_ideal_link_every_picture_is_there_at_once() -> None:
    found = sent(Ideal.create(), [100, 5000, 1])
    assert found.outcomes == ("on time",) * 3
    assert found.handed_s.tolist() == found.captured_s.tolist()
    assert found.ages_s().tolist() == [0.0, 0.0, 0.0]
    assert (found.packets.sent, found.sent_bytes.tolist()) == (7, [100, 5000, 1])


def test_times_begin_with_the_first_picture() -> None:
    found = sent(Ideal.create(), [1, 1], stamps_s=np.array([1.3e9, 1.3e9 + 0.1]))
    assert found.captured_s == pytest.approx([0.0, 0.1], abs=1e-6)


def test_a_picture_takes_encoding_sending_travelling_and_decoding() -> None:
    link = Constant.create(rate_kbps=80, delay_ms=30)  # 10 ms for 100 bytes
    (picture,) = latencies_s(sent(link, [200], encode_ms=5, device_factor=4, decode_ms=7))
    assert picture == pytest.approx(0.020 + 0.020 + 0.030 + 0.007)


def test_measured_times_are_scaled_by_the_machine_that_takes_them() -> None:
    given = ReaderSettings(
        link="given", encode_ms="measured", decode_ms="measured", slam_ms="measured", device_factor=4, receiver_factor=3
    )
    assert given.requires == {"encode_ms": "encoding", "decode_ms": "decoding", "slam_ms": "reading"}
    timed = given.with_measured_times({"encode_ms": 5.0, "decode_ms": 7.0, "slam_ms": 2.0})
    assert (timed.encode_s, timed.decode_s, timed.read_s) == pytest.approx((0.020, 0.021, 0.006))
    assert timed.requires == {}
    with pytest.raises(TypeError, match=r"^'measured' is"):
        _ = given.encode_s
    assert LinkSettings(link="given", encode_ms=5).requires == {}


@pytest.mark.parametrize("value", ["fast", -1, None])
def test_a_time_is_milliseconds_or_the_word(value: Any) -> None:
    with pytest.raises(ValidationError) as refused:
        LinkSettings(link="given", encode_ms=value)
    (error,) = refused.value.errors()
    assert (error["loc"], error["type"]) == (("encode_ms",), "time")


def test_headers_are_sent_with_every_packet() -> None:
    link = Constant.create(rate_kbps=80)
    found = sent(link, [250], mtu=140, header_bytes=40)  # 100 + 100 + 50 bytes of data
    assert (found.packets.sent, found.sent_bytes.tolist()) == (3, [370])
    assert latencies_s(found)[0] == pytest.approx(0.037)


@pytest.mark.parametrize("load", [pytest.param(0.3, marks=pytest.mark.thorough), 0.7])
def test_waiting_times_are_those_of_a_queue_with_one_server(load: float) -> None:
    """Poisson arrivals and equal service times: the formula of Pollaczek and Khinchine."""
    service_s, count = 0.01, 25_000
    stamps_s = np.cumsum(np.random.default_rng(5).exponential(service_s / load, count))
    link = Constant.create(rate_kbps=80, queue_packets=10_000)
    found = sent(link, [100] * count, stamps_s=stamps_s, queue_policy="fifo")
    waited_s = latencies_s(found) - service_s
    assert waited_s.mean() == pytest.approx(load * service_s / (2.0 * (1.0 - load)), rel=0.08)


@pytest.mark.parametrize("packets", [4, *(pytest.param(count, marks=pytest.mark.thorough) for count in (1, 16))])
def test_a_picture_of_many_packets_is_lost_more_often(packets: int) -> None:
    count, loss = 8000, 0.03
    found = sent(Constant.create(rate_kbps=1e6, loss=loss), [1000 * packets] * count)
    expected = 1.0 - (1.0 - loss) ** packets
    error = math.sqrt(expected * (1.0 - expected) / count)
    assert Counter(found.outcomes)["lost"] / count == pytest.approx(expected, abs=4.0 * error)


def test_redundancy_saves_what_a_binomial_says() -> None:
    count, loss = 8000, 0.1
    found = sent(Constant.create(rate_kbps=1e6, loss=loss), [10_000] * count, transport="fec", fec_share=0.25)
    assert found.packets.sent == 13 * count
    expected = float(binom.sf(9, 13, 1.0 - loss))
    error = math.sqrt(expected * (1.0 - expected) / count)
    assert Counter(found.outcomes)["on time"] / count == pytest.approx(expected, abs=4.0 * error)


def test_repair_goes_on_until_the_deadline() -> None:
    """Sent at 0, and again after each round trip of 40 ms while the picture is at most 101 ms old: three times."""
    count, loss = 20_000, 0.3
    link = Constant.create(rate_kbps=1e6, delay_ms=20, loss=loss)
    found = sent(link, [1000] * count, transport="arq", deadline_ms=101)
    share = Counter(found.outcomes)["lost"] / count
    assert share == pytest.approx(loss**3, abs=4.0 * math.sqrt(loss**3 / count))
    assert found.packets.sent / count == pytest.approx(1.0 + loss + loss**2, rel=0.01)
    assert set(np.round(latencies_s(found), 3)) == {0.02, 0.06, 0.1}


def test_a_reliable_transport_loses_nothing_and_makes_the_rest_wait() -> None:
    link = Constant.create(rate_kbps=1e6, delay_ms=20, loss=0.3)
    reliable = sent(link, [1000] * 3000, rate_hz=100, transport="reliable", queue_policy="fifo")
    arq = sent(link, [1000] * 3000, rate_hz=100, transport="arq", queue_policy="fifo")
    assert set(reliable.outcomes) == {"on time"}
    assert (np.diff(reliable.handed_s) >= 0).all()
    assert np.median(latencies_s(reliable)) > 0.04 > np.median(latencies_s(arq))
    assert set(arq.outcomes) == {"on time", "late"}  # those that a newer one has overtaken


@pytest.mark.parametrize("name", ["lte_still", "lte_moving"])
def test_what_comes_through_a_trace_is_what_it_gives(name: str) -> None:
    found = sent(
        Trace.create(trace=name, offset_ms=0), [15_000] * 3000, rate_hz=200, transport="reliable", queue_policy="fifo",
        mtu=1500,
    )  # fmt: skip
    received = np.count_nonzero(found.handed_s <= 60.0) * 15_000
    assert received == pytest.approx(1500 * len(embedded_trace(name)), abs=2 * 15_000)  # type: ignore[arg-type]


def test_only_the_newest_picture_waits() -> None:
    """Each takes 275 ms on the way, and one comes every 100 ms."""
    found = sent(Constant.create(rate_kbps=32), [1100] * 8, mtu=1100)
    assert [frame for frame, outcome in enumerate(found.outcomes) if outcome == "on time"] == [0, 2, 5, 7]
    assert found.handed_s[found.output_frames] == pytest.approx([0.275, 0.55, 0.825, 1.1])
    assert found.ages_s() == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.4, 0.5])
    assert found.gaps_s() == pytest.approx([0.275, 0.275, 0.275, 0.275, 0.0])


def test_a_queue_of_all_pictures_grows_old() -> None:
    found = sent(Constant.create(rate_kbps=32), [1000] * 8, queue_policy="fifo")
    assert latencies_s(found) == pytest.approx(0.25 + 0.15 * np.arange(8))


def test_late_pictures_are_passed_over() -> None:
    """275 ms on the way; of what waits, nothing older than 100 ms is begun with."""
    found = sent(Constant.create(rate_kbps=32), [1100] * 8, mtu=1100, queue_policy="drop_late", deadline_ms=100)
    assert [frame for frame, outcome in enumerate(found.outcomes) if outcome != "skipped"] == [0, 2, 5]
    assert Counter(found.outcomes) == {"late": 3, "skipped": 5}


def test_an_encoder_that_is_too_slow_leaves_pictures_out() -> None:
    found = sent(Ideal.create(), [10] * 9, encode_ms=44, device_factor=5)
    assert [frame for frame, outcome in enumerate(found.outcomes) if outcome == "on time"] == [0, 2, 4, 6, 8]
    assert found.handed_s[[0, 2, 4]] == pytest.approx([0.22, 0.44, 0.66])


def test_what_finds_no_room_is_dropped() -> None:
    """One is being sent and three wait; the fifth packet of a picture has no place."""
    link = Constant.create(rate_kbps=8, queue_packets=3)
    at_once = sent(link, [5000, 3000], rate_hz=0.01, queue_policy="fifo")
    assert at_once.outcomes == ("lost", "on time")
    assert (at_once.packets.dropped, at_once.packets.arrived) == (1, 7)
    paced = sent(link, [5000, 3000], rate_hz=0.01)
    assert paced.outcomes == ("on time", "on time")
    assert paced.packets.dropped == 0


def stream(*starts: bool) -> list[SentPacket]:
    return [SentPacket(frame, 1000, start, frame + 1) for frame, start in enumerate(starts)]


def test_a_stream_is_broken_until_it_starts_again() -> None:
    units = stream(True, False, False, False, True, False)
    found = deliver(
        units, np.arange(6) / 10, Losing(1), LinkSettings(link="given", **HEADERS), np.random.default_rng(0)
    )
    assert found.outcomes == ("on time", "lost", "broken", "broken", "on time", "on time")


def test_what_a_decoder_makes_up_is_handed_on_where_that_is_asked() -> None:
    units = stream(False, True, False, False, False, True)
    settings = LinkSettings(link="given", concealed=True, **HEADERS)
    found = deliver(units, np.arange(6) / 10, Losing(2), settings, np.random.default_rng(0))
    assert found.outcomes == ("broken", "on time", "lost", "concealed", "concealed", "on time")
    assert found.output_frames == [1, 3, 4, 5]
    assert found.came.tolist() == [True, True, False, True, True, True]


@pytest.mark.parametrize(("starts", "policy"), [([True] * 9, "latest_only"), ([True] + [False] * 8, "fifo")])
def test_pictures_that_depend_on_each_other_all_wait_and_others_give_way(starts: list[bool], policy: Any) -> None:
    link = Constant.create(rate_kbps=32)
    found = [
        deliver(
            stream(*starts), np.arange(9) / 10, link, LinkSettings(link="given", queue_policy=name, **HEADERS),
            np.random.default_rng(0),
        )
        for name in ("auto", policy)
    ]  # fmt: skip
    assert found[0].outcomes == found[1].outcomes
    assert ("skipped" in found[0].outcomes) == (policy == "latest_only")


def test_a_stream_that_begins_in_its_middle_waits_for_a_start() -> None:
    units = stream(False, False, True, False)
    found = deliver(
        units, np.arange(4) / 10, Ideal.create(), LinkSettings(link="given", **HEADERS), np.random.default_rng(0)
    )
    assert found.outcomes == ("broken", "broken", "on time", "on time")


def refreshed(count: int, every: int) -> list[SentPacket]:
    """A stream of one start, refreshed in the `every` frames from each recovery point on."""
    points = range(every, count, every)
    return [SentPacket(i, 1000, i == 0, i + 1, every - 1 if i in points else None) for i in range(count)]


@pytest.mark.parametrize(
    ("lost", "first_picture", "whole"),
    [((0,), 4, 7), ((1,), 2, 7), ((4,), 5, 11), ((3, 6), 4, 11), ((0, 4), 8, 11)],
)
def test_a_refreshed_stream_is_whole_again_when_the_refresh_has_gone_round(
    lost: tuple[int, ...], first_picture: int, whole: int
) -> None:
    """Recovery points at 4 and 8, each of 4 frames: one of which a packet is lost promises nothing."""
    units, stamps_s = refreshed(12, 4), np.arange(12) / 10
    for concealed in (False, True):
        settings = LinkSettings(link="given", queue_policy="fifo", concealed=concealed, **HEADERS)
        found = deliver(units, stamps_s, Losing(*lost), settings, np.random.default_rng(0))
        expected = ["on time"] * 12
        expected[lost[0] : whole] = ["broken"] * (whole - lost[0])
        if concealed:
            expected[first_picture:whole] = ["concealed"] * (whole - first_picture)
        for frame in lost:
            expected[frame] = "lost"
        assert list(found.outcomes) == expected


def test_pictures_of_a_stream_wait_for_what_they_depend_on() -> None:
    """The second has a packet that is sent twice; the third is there before it, and cannot be decoded."""
    units = stream(True, False, False)
    settings = LinkSettings(link="given", transport="arq", queue_policy="fifo", **HEADERS)
    slow = type("Slow", (Losing,), {"delay_s": 0.1})(1)
    found = deliver(units, np.arange(3) / 10, slow, settings, np.random.default_rng(0))
    assert found.handed_s == pytest.approx([0.0, 0.3, 0.3])
    assert set(found.outcomes) == {"on time"}


def test_pictures_sent_in_another_order_are_shown_in_theirs() -> None:
    """As with pictures between two others: 0, 2, 1, the last two when the encoder has been given three."""
    units = [SentPacket(0, 1000, True, 1), SentPacket(2, 1000, False, 3), SentPacket(1, 1000, False, 3)]
    settings = LinkSettings(link="given", queue_policy="fifo", **HEADERS)
    found = deliver(units, np.arange(3) / 10, Constant.create(rate_kbps=800), settings, np.random.default_rng(0))
    assert found.handed_s == pytest.approx([0.01, 0.22, 0.22])


def partly(
    *lost: int, sizes: list[int] | None = None, keep: Any = lambda frame, ranges: 0.5, **params: Any
) -> Delivery:
    """Pictures of three packets, some of which are lost."""
    given = LinkSettings(link="given", partial=True, **{**HEADERS, **params})
    units = stills(sizes or [2500] * 4)
    return deliver(
        units, np.arange(len(units)) / 10, Losing(*lost), given, np.random.default_rng(0), partial_decode=keep
    )


def test_what_came_of_a_picture_is_handed_on_where_that_is_asked() -> None:
    """What is lost in the middle is known by the packet after it, at the end by the next picture, of the last never."""
    asked = {}

    def keep(frame: int, ranges: Ranges) -> float | None:
        asked[frame] = ranges
        return 0.5

    found = partly(1, 5, 11, keep=keep)
    assert found.outcomes == ("partial", "partial", "on time", "lost")
    assert found.handed_s[:3] == pytest.approx([0.0, 0.2, 0.2])
    assert asked == {0: ((0, 1000), (2000, 2500)), 1: ((0, 2000),)}
    assert found.output_bytes == 1500 + 2000 + 2500


def test_what_a_decoder_makes_nothing_of_is_lost() -> None:
    found = partly(1, 3, keep=lambda frame, ranges: 0.5 if ranges[0][0] == 0 else None)
    assert found.outcomes == ("partial", "lost", "on time", "on time")
    assert partly(0, 1, 2).outcomes[0] == "lost"


def test_parts_that_are_too_old_are_lost() -> None:
    assert partly(2, deadline_ms=80).outcomes == ("lost", "on time", "on time", "on time")
    assert partly(2, deadline_ms=150).outcomes[0] == "partial"


def test_redundancy_that_does_not_suffice_leaves_its_data() -> None:
    """Three of data and one more, of which two come."""
    found = partly(1, 3, transport="fec", fec_share=0.3)
    assert found.outcomes[0] == "partial"
    assert found.parts[0].received.ranges == ((0, 1000), (2000, 2500))


def test_what_comes_whole_is_never_taken_for_a_part() -> None:
    """Jitter lets packets overtake each other, and pictures too."""
    link = Constant.create(rate_kbps=2000, jitter_ms=40, loss=0.1)
    without, having = (
        deliver(
            stills([3500] * 300), np.arange(300) / 30, link, LinkSettings(link="given", partial=partial),
            np.random.default_rng(4), partial_decode=(lambda frame, ranges: 0.5) if partial else None,
        )
        for partial in (False, True)
    )  # fmt: skip
    assert (without.came == having.came).all()
    assert {having.outcomes[frame] for frame in np.flatnonzero(having.came)} <= {"on time", "late"}
    assert Counter(having.outcomes)["partial"] > 50


LINKS = st.sampled_from(
    [
        Ideal.create(),
        Constant.create(rate_kbps=60, delay_ms=15, jitter_ms=10, loss=0.2, queue_packets=4),
        Constant.create(rate_kbps=200, delay_ms=1, queue="codel", queue_packets=40),
        GilbertElliott.create(rate_kbps=300, good_ms=200, bad_ms=60, bad_loss=0.7, delay_ms=5, queue_packets=8),
        Trace.create(trace="lte_moving", delay_ms=20, queue="codel"),
    ]
)
UNITS = st.lists(st.tuples(st.integers(1, 6000), st.booleans()), min_size=1, max_size=60)


@settings(max_examples=150)
@given(
    link=LINKS,
    drawn=UNITS,
    transport=st.sampled_from(["datagrams", "fec", "arq", "reliable"]),
    policy=st.sampled_from(["latest_only", "fifo", "drop_late", "auto"]),
    deadline_ms=st.one_of(st.none(), st.floats(20, 600)),
    encode_ms=st.sampled_from([0.0, 3.0, 60.0]),
    decode_ms=st.sampled_from([0.0, 45.0]),
    concealed=st.booleans(),
    partial=st.booleans(),
    refresh=st.one_of(st.none(), st.integers(0, 5)),
    seed=st.integers(0, 99),
)
def test_everything_has_one_fate(
    link: Link[Any],
    drawn: list[tuple[int, bool]],
    transport: Any,
    policy: Any,
    deadline_ms: float | None,
    encode_ms: float,
    decode_ms: float,
    concealed: bool,
    partial: bool,
    refresh: int | None,
    seed: int,
) -> None:
    partial &= transport in ("datagrams", "fec")  # of pictures that stand alone
    drawn = [(size, starts or partial) for size, starts in drawn]
    units = [
        SentPacket(frame, size, starts or frame == 0, frame + 1, refresh if frame % 7 == 6 else None)
        for frame, (size, starts) in enumerate(drawn)
    ]
    stamps_s = np.cumsum(np.random.default_rng(seed).exponential(0.04, len(units)))
    deadline_ms = deadline_ms or (200.0 if policy == "drop_late" else None)
    given = LinkSettings(
        link="given", transport=transport, queue_policy=policy, deadline_ms=deadline_ms, encode_ms=encode_ms,
        decode_ms=decode_ms, concealed=concealed, partial=partial,
    )  # fmt: skip

    def partial_decode(frame: int, ranges: Ranges) -> float | None:
        assert all(0 <= begin < end <= drawn[frame][0] for begin, end in ranges)
        assert all(before[1] < after[0] for before, after in pairwise(ranges))
        assert ranges != ((0, drawn[frame][0]),)
        return 0.5 if ranges[0][0] == 0 else None

    found = deliver(
        units, stamps_s, link, given, np.random.default_rng(seed), partial_decode=partial_decode if partial else None
    )
    packets, most = found.packets, link.queue.packets
    assert packets.sent == packets.arrived + packets.lost + packets.dropped
    assert 0 <= packets.late <= packets.arrived
    assert min(found.waiting) >= 0
    assert most is None or max(found.waiting) <= most
    assert len(found.outcomes) == len(units) == len(found.waiting)
    taken_s = (found.handed_s - found.captured_s)[found.output_frames]
    assert (taken_s >= link.delay_s + 1e-3 * (encode_ms + decode_ms) - 1e-9).all()
    assert (taken_s <= given.deadline_s).all()
    assert (np.diff(found.handed_s[found.output_frames]) >= 0).all()
    assert [
        frame for frame, outcome in enumerate(found.outcomes) if outcome in ("on time", "concealed", "partial")
    ] == found.output_frames
    assert set(found.parts) >= {frame for frame, outcome in enumerate(found.outcomes) if outcome == "partial"}
    assert not any(found.came[frame] for frame in found.parts)
    assert concealed or "concealed" not in found.outcomes
    if policy == "fifo":
        assert "skipped" not in found.outcomes
    if transport in ("arq", "reliable") and deadline_ms is None:
        assert "lost" not in found.outcomes
    again = deliver(
        units, stamps_s, link, given, np.random.default_rng(seed), partial_decode=partial_decode if partial else None
    )
    assert (again.outcomes, again.packets) == (found.outcomes, packets)
    assert again.handed_s.tobytes() == found.handed_s.tobytes()


@pytest.mark.parametrize(
    ("params", "words"),
    [
        ({"mtu": 500}, "mtu needs a link"),
        ({"link": "ideal", "mtu": 40, "header_bytes": 40}, "header_bytes 40 .*mtu 40"),
        ({"link": "ideal", "queue_policy": "drop_late"}, "needs deadline_ms"),
        ({"link": "ideal", "partial": True, "transport": "arq"}, "; arq retransmits"),
    ],
)
def test_settings_that_mean_nothing_are_refused(params: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        LinkSettings(**params)
