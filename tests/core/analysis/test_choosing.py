"""Which settings are good enough over a link, from runs whose answer is known."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import Any

import pytest
from measured_runs import cell_result, run_of
from told import numbers

from codecbench.core.analysis.choosing import IDLE_ERROR, TOO_OLD, Candidate, Demand, NotMeasured, candidates
from codecbench.core.analysis.table import CellResult
from codecbench.core.contracts.evaluator import Measurement
from codecbench.core.contracts.metric import Metric
from codecbench.core.engine.planning.model import PluginSetting
from codecbench.core.engine.storage.samples import parquet_from_samples, table_from_parquet
from codecbench.core.report.choosing import answer, choices, link_picks
from codecbench.core.report.page import render
from codecbench.core.report.strips import link_strips
from codecbench.core.report.views import Pick, answer_picks

WAIT = Metric("wait", "ms", "lower", "", quantity="delay")
GONE = Metric("gone", "1", "lower", "", label="gone astray", quantity="cause")
IDLE = Metric("idle", "1", "lower", "", label="never begun", quantity="cause")
MISS = Metric("miss", "m", "lower", "", quantity="error")
BLIND = Metric("blind", "m", "neither", "", quantity="idle")
NEW = Metric("new", "1", "higher", "", quantity="fresh")
OF_FRAMES, OF_READER = (WAIT, GONE, IDLE), (MISS, BLIND, NEW)
FRAMES = 10
UNSEEN_M = 1.0
"""What a reader errs in these worlds with nothing received."""


def over(
    q: float, repeat: int, link: str, own: dict[str, float], waits_ms: tuple[float, ...] = (), **params: Any
) -> CellResult:
    """A cell over a link. own: what it measured once. waits_ms: of its frames, NaN where one is gone."""
    cell = cell_result(
        "plain", q, f"over_{link}", repeat=repeat, sequence_name=params.pop("sequence", "s"), count=FRAMES
    )
    used = PluginSetting("link", link, "1")
    evaluator = replace(cell.cell.evaluator, params={"link": link, **params}, uses=(used,))
    samples = [Measurement("wait", wait, frame) for frame, wait in enumerate(waits_ms) if not math.isnan(wait)]
    kept = table_from_parquet(parquet_from_samples(samples))
    return replace(
        cell,
        cell=replace(cell.cell, evaluator=evaluator),
        metrics={metric.name: metric for metric in (OF_FRAMES if waits_ms else OF_READER)},
        measurements=tuple(Measurement(name, value) for name, value in own.items()),
        samples=lambda: kept,
    )


def size(q: float, sequence: str = "s") -> CellResult:
    return cell_result("plain", q, "size", own={("bits", ""): [q]}, sequence_name=sequence)


def delivered(q: float, in_time: int, link: str = "radio", repeats: int = 5, **more: Any) -> list[CellResult]:
    """So many of ten frames come after 50 ms, one after 150 ms if there is room, and the rest goes astray."""
    waits = [50.0] * in_time + [150.0] * (in_time < FRAMES)
    gone = (FRAMES - len(waits)) / FRAMES
    waits += [math.nan] * (FRAMES - len(waits))
    return [over(q, repeat, link, {"gone": gone, "idle": 0.0}, waits, **more) for repeat in range(repeats)]


def read(
    q: float, errors_m: list[float], link: str = "radio", blind: float = UNSEEN_M, new: float = 0.8, **more: Any
) -> list[CellResult]:
    """A run for each error, beside that with nothing received, with a fresh pose at that share of the moments."""
    own = [{"miss": error, "blind": blind, "new": new} for error in errors_m]
    return [over(q, repeat, link, values, **more) for repeat, values in enumerate(own)]


def judged(demand: Demand, *cells: CellResult) -> dict[str, Candidate]:
    found = candidates(run_of(*cells), demand)
    return {candidate.point: candidate for candidate in found}


ALL = Demand("radio", deadline_ms=100, error_m=0.1, share=0.9)
RUN = [
    *(size(q) for q in (1.0, 2.0, 4.0, 8.0)),
    *delivered(1.0, 10), *read(1.0, [0.3] * 5),  # all there, and too coarse
    *delivered(2.0, 10), *read(2.0, [0.05] * 5),
    *delivered(4.0, 9), *read(4.0, [0.02] * 5),
    *delivered(8.0, 3), *read(8.0, [0.01] * 5),  # most are gone
]  # fmt: skip


def test_a_setting_passes_where_frames_come_in_time_and_are_of_use() -> None:
    found = judged(ALL, *RUN)
    verdicts = {point: candidate.verdict for point, candidate in found.items()}
    assert verdicts == {"q=1.0": "fails", "q=2.0": "passes", "q=4.0": "passes", "q=8.0": "fails"}
    assert found["q=8.0"].share == pytest.approx(0.3)
    assert found["q=8.0"].causes == pytest.approx({"gone astray": 0.6, TOO_OLD: 0.1, "never begun": 0})
    assert found["q=1.0"].error_m == 0.3
    assert {point: candidate.limit for point, candidate in found.items()} == {
        "q=1.0": "error", "q=2.0": None, "q=4.0": None, "q=8.0": "time"
    }  # fmt: skip


def test_what_is_not_asked_is_not_judged() -> None:
    in_time = judged(Demand("radio", deadline_ms=100, share=0.9), *RUN)
    assert in_time["q=1.0"].verdict == "passes"
    assert in_time["q=8.0"].verdict == "fails"
    near = judged(Demand("radio", error_m=0.1), *RUN)
    assert near["q=1.0"].verdict == "fails"
    assert near["q=8.0"].verdict == "passes"
    assert {candidate.verdict for candidate in judged(Demand("radio"), *RUN).values()} == {"passes"}


def test_the_setting_to_take_over_a_link_is_picked() -> None:
    assert answer_picks(run_of(*RUN)) == [Pick("plain", "q=1.0", True)]
    worse = [*delivered(1.0, 10, "worse"), *read(1.0, [2.0] * 5, "worse"), *read(2.0, [0.05] * 5, "worse")]
    both = run_of(*RUN, *worse)
    assert answer_picks(both) == answer_picks(both, "radio") == [Pick("plain", "q=1.0", True)]
    assert answer_picks(both, "worse") == [Pick("plain", "q=2.0", True)]
    lost = [size(1.0), *read(1.0, [2.0] * 5)]
    assert answer_picks(run_of(*lost)) == []


def test_an_error_no_smaller_than_with_nothing_received_is_no_success() -> None:
    """A camera that hardly moves: a reader that gets nothing errs 4.3 cm, which is less than is asked."""
    still = [size(1.0), *read(1.0, [0.043] * 8, blind=0.043, new=0.0)]
    for demand in (Demand("radio"), Demand("radio", error_m=0.05)):
        *_, answers = choices(run_of(*still), demand)
        (sentence,) = answers.sentences
        for part in ("Nothing passes", "over radio", "fresh poses", "plain q=1.0"):
            assert part in sentence
        assert numbers(sentence) == [1.0, 1.0, 1.0, 0.5, 0.0, 50.0]
    told_wrong = [size(1.0), *read(1.0, [0.044] * 8, blind=0.043), *read(2.0, [0.042] * 8, blind=0.043)]
    found = judged(Demand("radio", error_m=0.05), *told_wrong)
    assert (found["q=1.0"].verdict, found["q=1.0"].limit) == ("fails", "idle")
    assert found["q=2.0"].verdict == "passes"
    (table, _) = choices(run_of(*told_wrong), Demand("radio", error_m=0.05))
    assert table.rows[0][-1].startswith("error 0.044 m")
    assert numbers(table.rows[0][-1]) == [0.044, 0.043]


def test_a_reader_with_too_few_fresh_poses_does_not_track() -> None:
    seldom = [size(1.0), *read(1.0, [0.02] * 8, new=0.49), *read(2.0, [0.02] * 8, new=0.5)]
    found = judged(Demand("radio"), *seldom)
    assert [candidate.verdict for candidate in found.values()] == ["fails", "passes"]
    assert found["q=1.0"].limit == "fresh"


def test_a_record_without_the_error_with_nothing_received_must_be_measured_again() -> None:
    old = [size(1.0), *read(1.0, [0.02] * 8, blind=math.nan, new=math.nan), *read(2.0, [0.2] * 8, blind=math.nan)]
    table, answers = choices(run_of(*old), Demand("radio", error_m=0.1))
    assert [row[-2] for row in table.rows] == ["inconclusive", "fails"]
    assert table.rows[0][-1].startswith("not measured: ")
    assert table.rows[1][-1] == "error 0.2 m > 0.1 m"
    for part in ("plain q=1.0: ", IDLE_ERROR, "--recompute over_radio`"):
        assert part in table.sentences[1]
    assert answers.sentences[0].startswith("Nothing is known")
    assert "1 of 2 settings" in answers.sentences[0]


def test_a_later_deadline_finds_more_in_time() -> None:
    assert judged(Demand("radio", deadline_ms=200), *RUN)["q=4.0"].share == 1.0
    assert judged(Demand("radio", deadline_ms=40), *RUN)["q=4.0"].share == 0.0


def test_the_passing_setting_of_least_rate_is_chosen_and_the_limits_of_others_named() -> None:
    table, answers = choices(run_of(*RUN), ALL)
    assert table.title.startswith("s: over radio, ")
    assert numbers(table.title) == [90.0, 100.0, 0.1]
    assert table.heads == (
        "setting", "rate [bpp]", "on time", "error [m]", "fresh pose", "runs", "verdict", "because"
    )  # fmt: skip
    assert [row[:-1] for row in table.rows] == [
        ("plain q=1.0", "1", "100 %", "0.3", "80 %", "5/5 and 0/5", "fails"),
        ("plain q=2.0", "2", "100 %", "0.05", "80 %", "5/5 and 5/5", "passes"),
        ("plain q=4.0", "4", "90 %", "0.02", "80 %", "5/5 and 5/5", "passes"),
        ("plain q=8.0", "8", "30 %", "0.01", "80 %", "0/5 and 5/5", "fails"),
    ]
    assert [numbers(row[-1]) for row in table.rows] == [[0.3, 0.1], [], [], [30.0, 90.0, 60.0]]
    assert table.rows[-1][-1].endswith("60 % gone astray")
    assert [numbers(rule) for rule in table.sentences] == [[0.5, 50.0, 0.1, 95.0, 50.0]]
    (sentence,) = answers.sentences
    assert sentence.startswith("Over radio use plain q=2.0: 2 bpp; ")
    assert numbers(sentence)[2:] == [5.0, 5.0, 57.0, 95.0, 0.05, 0.1, 1.0, 0.5, 80.0, 50.0, 100.0, 90.0]


def test_few_runs_are_inconclusive_and_the_missing_number_is_named() -> None:
    cells = [size(1.0), *delivered(1.0, 10, repeats=5), *read(1.0, [0.05, 0.05])]
    table, answers = choices(run_of(*cells), ALL)
    assert table.rows[0][-2] == "inconclusive"
    assert table.rows[0][-1].startswith("only 2 runs; ")
    assert numbers(table.rows[0][-1]) == [2.0, 2.0]
    (sentence,) = answers.sentences
    for part in ("Nothing is known", "over radio", "too few runs", "plain q=1.0"):
        assert part in sentence
    assert numbers(sentence) == [1.0, 1.0, 1.0, 2.0, 2.0]
    mixed = [size(1.0), *read(1.0, [0.05, 0.05, 0.05, 0.2])]
    table, _ = choices(run_of(*mixed), Demand("radio", error_m=0.1))
    assert table.rows[0][-1].startswith("error 0.2 m > 0.1 m in 1 of 4 runs")
    assert numbers(table.rows[0][-1]) == [0.2, 0.1, 1.0, 4.0, 4.0]


def test_what_was_not_measured_is_named() -> None:
    table, _ = choices(run_of(size(1.0), *delivered(1.0, 10), *read(2.0, [0.05] * 5)), ALL)
    assert table.rows[0][-2] == "inconclusive"
    assert table.rows[0][-1].endswith(": the error")
    error, in_time = table.sentences[1:]
    assert error.startswith("plain q=1.0: the error was")
    assert in_time.startswith("plain q=2.0: the share of frames")


def test_frames_in_time_decide_alone_where_nothing_reads_them() -> None:
    table, answers = choices(run_of(size(1.0), *delivered(1.0, 10)), Demand("radio", deadline_ms=100))
    assert table.sentences[0].startswith("No evaluator reads")
    (sentence,) = answers.sentences
    assert "use plain q=1.0" in sentence
    assert "no evaluator reads" in sentence
    assert numbers(sentence) == [1.0, 1.0, 5.0, 5.0, 57.0, 95.0, 100.0, 95.0]
    with pytest.raises(NotMeasured, match=r"no error.*; .*deadline"):
        candidates(run_of(size(1.0), *delivered(1.0, 10)), Demand("radio", error_m=0.1))


def test_a_reader_that_failed_erred_beyond_all() -> None:
    crashed = [replace(cell, status="crashed", measurements=()) for cell in read(1.0, [0.0] * 5)]
    found = judged(Demand("radio", error_m=0.1), size(1.0), *crashed)["q=1.0"]
    assert (found.verdict, found.limit) == ("fails", "failed")


def test_transports_over_one_link_are_separate_candidates() -> None:
    cells = [size(1.0), *delivered(1.0, 3, transport="datagrams"), *delivered(1.0, 10, transport="arq")]
    cells += read(1.0, [0.05] * 5, transport="arq")
    found = {candidate.way: candidate for candidate in candidates(run_of(*cells), ALL)}
    assert found.keys() == {"transport=datagrams", "transport=arq"}
    assert found["transport=arq"].verdict == "passes"
    assert found["transport=datagrams"].unmeasured == ("the error",)


def test_other_links_do_not_count_and_are_named_where_there_is_nothing() -> None:
    cells = [size(1.0), *delivered(1.0, 10), *delivered(1.0, 0, link="sound")]
    assert judged(Demand("radio", deadline_ms=100), *cells)["q=1.0"].share == 1.0
    with pytest.raises(NotMeasured, match=r"'light'.* radio, sound"):
        candidates(run_of(*cells), Demand("light", deadline_ms=100))


def timed(q: float, encode_ms: float) -> CellResult:
    cell = cell_result("plain", q, "clock")
    code = Metric("code_ms", "ms", "lower", "", ("median",), role="time", quantity="encoding")
    return replace(cell, metrics={"code_ms": code}, summaries={("code_ms", "", "median"): encode_ms})


def test_a_slower_device_makes_pictures_older() -> None:
    cells = [size(1.0), *delivered(1.0, 10), timed(1.0, 11.0)]
    asked = {"deadline_ms": 100.0, "share": 0.9}
    assert judged(Demand("radio", **asked, device_factor=4.0), *cells)["q=1.0"].share == 1.0  # 50 + 44 ms
    assert judged(Demand("radio", **asked, device_factor=5.0), *cells)["q=1.0"].share == 0.0  # 50 + 55 ms
    table, _ = choices(run_of(*cells), Demand("radio", **asked, device_factor=4.0))
    assert table.title.startswith("s: over radio")
    assert "4 times slower" in table.title
    assert numbers(table.title) == [90.0, 4.0, 100.0]
    with pytest.raises(NotMeasured, match="no encoding"):
        judged(Demand("radio", **asked, device_factor=4.0), *cells[:-1])


def test_what_was_simulated_is_not_added_again() -> None:
    cells = [size(1.0), *delivered(1.0, 10, encode_ms="measured"), timed(1.0, 11.0)]
    assert judged(Demand("radio", deadline_ms=100), *cells)["q=1.0"].share == 1.0
    with pytest.raises(NotMeasured, match="encode_ms"):
        judged(Demand("radio", deadline_ms=100, device_factor=4.0), *cells)


def test_sequences_come_together_first() -> None:
    cells = [size(1.0), size(1.0, "t"), *delivered(1.0, 10), *delivered(1.0, 3, sequence="t")]
    *tables, answers = choices(run_of(*cells), Demand("radio", deadline_ms=100))
    assert [table.title.split(":")[0] for table in tables] == ["all sequences together", "s", "t"]
    assert [table.rows[0][2] for table in tables] == ["65 %", "100 %", "30 %"]
    assert [table.rows[0][5] for table in tables] == ["5/10", "5/5", "0/5"]
    assert "100 % of frames" in tables[1].sentences[0]
    assert len(answers.sentences) == 1
    assert answers.sentences[0].startswith("Nothing is known")


def test_without_a_rate_nothing_is_called_the_least() -> None:
    table, answers = choices(run_of(*delivered(1.0, 10)), Demand("radio", deadline_ms=100))
    assert table.sentences[1].startswith("No rate was measured")
    assert "plain q=1.0" in answers.sentences[0]
    assert "not known; passes" in answers.sentences[0]


BY_ERROR = [
    *(size(q) for q in (1.0, 2.0, 4.0)),
    *read(1.0, [1.1] * 5),
    *read(2.0, [0.10, 0.12, 0.09, 0.11, 0.40]),
    *read(4.0, [0.01] * 5),
]  # fmt: skip


def test_the_error_is_the_same_with_a_demand_and_without() -> None:
    asked, free = (judged(demand, *BY_ERROR) for demand in (Demand("radio", error_m=0.5), Demand("radio")))
    assert asked["q=2.0"].error_m == free["q=2.0"].error_m == 0.11
    heads = [choices(run_of(*BY_ERROR), demand)[0].heads for demand in (Demand("radio", error_m=0.5), Demand("radio"))]
    assert heads[0] == heads[1]


def test_without_a_demand_the_least_rate_that_passes_is_taken_over_each_link() -> None:
    cells = [*BY_ERROR, *read(1.0, [0.9] * 5, "wire"), *delivered(1.0, 10, "pigeon")]
    run = run_of(*cells)
    radio, wire, answers = choices(run, Demand(""))
    picks = link_picks(run, Demand(""))
    assert ["over radio" in table.title for table in picks] == [True, False]
    assert "over wire" in picks[1].title
    assert picks[0].heads == ("codec", "setting", "bpp", "error m", "fresh", "runs", "next coarser")
    assert picks[0].rows == (("plain", "q=2.0", "2.00", "0.110", "80 %", "5/5", "q=1.0 fails"),)
    assert picks[1].rows == (("plain", "q=1.0", "1.00", "0.900", "80 %", "5/5", "none tried"),)
    assert [table.title.split(",")[0] for table in (radio, wire)] == ["s: over radio", "s: over wire"]
    named = [re.findall(r"^Over (\w+) use plain (q=[\d.]+):", sentence) for sentence in answers.sentences]
    assert named == [[("radio", "q=2.0")], [("wire", "q=1.0")]]
    alone, _ = choices(run_of(*cells), Demand("wire"))
    assert alone.title.startswith("s: over wire")


def test_a_link_over_which_nothing_passes_has_the_nearest_setting() -> None:
    cells = [*BY_ERROR, *read(1.0, [0.9] * 5, "wire")]
    _, table = link_picks(run_of(*cells), Demand("", error_m=0.5))
    assert table.rows == (("plain", "q=1.0", "1.00", "0.900", "80 %", "0/5", "fails: error too large"),)


def test_links_over_which_nothing_was_measured_are_refused() -> None:
    with pytest.raises(NotMeasured, match="has a link"):
        choices(run_of(size(1.0)), Demand("", error_m=0.1))
    with pytest.raises(NotMeasured, match=r"no error .* radio"):
        choices(run_of(size(1.0), *delivered(1.0, 10)), Demand(""))
    with pytest.raises(NotMeasured, match=r"'light'.* has radio"):
        choices(run_of(*BY_ERROR), Demand("light"))


KBPS = Metric("kbps", "kbit/s", "lower", "", role="rate", headline=True)
BYTES = Metric("bytes", "bytes", "lower", "", role="rate")


def coded(codec: str, q: float, kbps: float) -> list[CellResult]:
    """A codec of so many kbit/s at 25 frames a second, whose frames are read over the radio with 2 cm of error."""
    own = {("kbps", ""): [kbps], ("bytes", ""): [kbps / (8e-3 * 25)]}
    rate = replace(cell_result(codec, q, "size", own=own), metrics={"kbps": KBPS, "bytes": BYTES})
    reader = read(q, [0.02] * 8)
    setting = replace(reader[0].cell.codec, name=codec)
    return [rate, *(replace(cell, cell=replace(cell.cell, codec=setting)) for cell in reader)]


def test_the_answer_compares_the_cost_with_the_smallest_anchor_that_passes() -> None:
    cells = [*coded("fine", 1.0, 600.0), *coded("plain", 2.0, 2000.0), *coded("plain", 3.0, 3000.0)]
    run = run_of(*cells)
    told = answer(run, candidates(run, Demand("radio", error_m=0.05)))
    for part in (
        "radio use fine q=1.0: 0.6 Mbit/s at 25 fps (0.27 GB/h), 70 % less",
        "smallest plain",
        "(q=2.0, 2 Mbit/s)",
    ):
        assert part in told
    assert numbers(told)[7:] == [8.0, 8.0, 68.0, 95.0, 0.02, 0.05, 1.0, 0.5, 80.0, 50.0]
    run = run_of(*coded("fine", 1.0, 600.0), coded("plain", 2.0, 2000.0)[0], *read(2.0, [2.0] * 8))
    told = answer(run, candidates(run, Demand("radio")))
    assert "no plain setting" in told
    assert "8 of 8 runs" in told


def test_the_report_begins_with_what_to_take_over_each_link() -> None:
    html = render(run_of(*BY_ERROR), lambda _: {"frames": [], "originals": []})
    section = html[html.index('<section id="answer"') :]
    (bold,) = re.findall('<p class="answer"><b>(.*?)</b>; ', section)
    assert "radio" in bold
    assert bold.endswith("plain q=2.0: 2 bpp")
    shown = section[section.index('<div id="links">') : section.index("</table>")]
    assert "<td" in shown


def test_the_pick_of_each_codec_over_a_link_is_in_one_table() -> None:
    run = run_of(*coded("fine", 1.0, 600.0), *coded("plain", 2.0, 2000.0), *coded("plain", 3.0, 3000.0))
    (table,) = link_picks(run, Demand("radio", error_m=0.05))
    assert "over radio, s" in table.title
    assert numbers(table.title) == [0.05]
    assert table.heads == ("codec", "setting", "Mbit/s", "vs. plain")
    assert table.rows == (("fine", "q=1.0", "0.600", "-70 %"), ("plain", "q=2.0", "2.00", "–"))
    (same,) = table.sentences
    for part in ("error m 0.0200", "fresh 80 %", "runs 8/8"):
        assert part in same
    run = run_of(*coded("fine", 1.0, 600.0), coded("plain", 2.0, 2000.0)[0], *read(2.0, [2.0] * 8))
    (table,) = link_picks(run, Demand("radio"))
    assert [row[0] for row in table.rows] == ["fine"]
    assert [sentence.endswith(": plain.") for sentence in table.sentences] == [True]


def test_the_strip_of_a_codec_over_a_link_has_its_pick_and_why_the_next_coarser_fails() -> None:
    """Over a link a finer setting may fail where a coarser one passes."""
    cells = [*BY_ERROR, size(8.0), *read(8.0, [1.2] * 5)]
    (found,) = link_strips(run_of(*cells))
    assert found.about.endswith("over radio")
    assert found.unit == "bpp"
    (row,) = found.rows
    assert (row.curve, row.pick, row.cost, row.saved) == ("plain", "q=2.0", "2 bpp", "the anchor")
    assert row.words == "q=8.0: fails; q=4.0, q=2.0: passes; q=1.0: fails"
    assert [mark.is_pick for mark in row.marks] == [False, False, True, False]
    assert row.after.startswith("q=1.0 fails (error 1.1 m")
    assert numbers(row.after) == [1.0, 1.1, 1.0]
    assert [row.cost for strips in link_strips(run_of(size(1.0), *read(1.0, [1.1] * 5))) for row in strips.rows] == [
        "passes nowhere"
    ]
