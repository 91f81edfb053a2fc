"""Which settings are good enough over a link, from runs whose answer is known."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from measured_runs import cell_result, run_of

from codecbench.core.analysis.choosing import Candidate, Demand, NotMeasured, candidates, least_errors
from codecbench.core.analysis.table import CellResult
from codecbench.core.contracts.evaluator import Measurement
from codecbench.core.contracts.metric import Metric
from codecbench.core.engine.planning.model import PluginSetting
from codecbench.core.engine.storage.samples import parquet_from_samples, table_from_parquet
from codecbench.core.report.choosing import choices, chosen
from codecbench.core.report.page import render

WAIT = Metric("wait", "ms", "lower", "", need="delay")
GONE = Metric("gone", "1", "lower", "", label="gone astray", need="cause")
IDLE = Metric("idle", "1", "lower", "", label="never begun", need="cause")
MISS = Metric("miss", "m", "lower", "", need="error")
METRICS = {metric.name: metric for metric in (WAIT, GONE, IDLE, MISS)}
FRAMES = 10


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
        metrics={name: METRICS[name] for name in (["wait", "gone", "idle"] if waits_ms else ["miss"])},
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


def read(q: float, errors_m: list[float], link: str = "radio", **more: Any) -> list[CellResult]:
    return [over(q, repeat, link, {"miss": error}, **more) for repeat, error in enumerate(errors_m)]


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


def test_a_setting_holds_where_pictures_come_in_time_and_are_of_use() -> None:
    found = judged(ALL, *RUN)
    verdicts = {point: candidate.verdict for point, candidate in found.items()}
    assert verdicts == {"q=1.0": "fails", "q=2.0": "passes", "q=4.0": "passes", "q=8.0": "fails"}
    assert found["q=8.0"].share == pytest.approx(0.3)
    assert found["q=8.0"].causes == pytest.approx(
        {"gone astray": 0.6, "older than the deadline": 0.1, "never begun": 0}
    )
    assert found["q=1.0"].error_m == 0.3


def test_what_is_not_asked_is_not_judged() -> None:
    in_time = judged(Demand("radio", deadline_ms=100, share=0.9), *RUN)
    assert in_time["q=1.0"].verdict == "passes"
    assert in_time["q=8.0"].verdict == "fails"
    near = judged(Demand("radio", error_m=0.1), *RUN)
    assert near["q=1.0"].verdict == "fails"
    assert near["q=8.0"].verdict == "passes"


def test_a_later_deadline_finds_more_in_time() -> None:
    assert judged(Demand("radio", deadline_ms=200), *RUN)["q=4.0"].share == 1.0
    assert judged(Demand("radio", deadline_ms=40), *RUN)["q=4.0"].share == 0.0


def test_the_least_bytes_that_hold_are_taken_and_the_limits_of_others_said() -> None:
    (verdict,) = choices(run_of(*RUN), ALL)
    assert verdict.title == "s: over radio, 90 % of the pictures within 100 ms and an error of at most 0.1 m"
    assert verdict.heads == ("setting", "rate [bpp]", "in time", "error [m]", "verdict", "limited by")
    assert [row[0] for row in verdict.rows] == ["plain q=1.0", "plain q=2.0", "plain q=4.0", "plain q=8.0"]
    assert verdict.rows[3] == (
        "plain q=8.0", "8", "30 % (0/5 runs)", "0.01 (5/5 runs)", "fails", "pictures gone astray (60 %)",
    )  # fmt: skip
    assert verdict.sentences == (
        "Over radio take plain q=2.0, 2 bpp, the least of 2 settings that hold (5/5 runs, at least 57 % at 95 %; "
        "5/5 runs, at least 57 % at 95 %).",
        "Limited by the error, though pictures come in time: plain q=1.0.",
        "Limited by pictures gone astray: plain q=8.0.",
    )


def test_few_runs_tell_nothing_and_how_many_more_would_is_said() -> None:
    cells = [size(1.0), *delivered(1.0, 10, repeats=5), *read(1.0, [0.05, 0.05])]
    (verdict,) = choices(run_of(*cells), ALL)
    assert verdict.sentences == (
        "Over radio no setting is known to hold.",
        "plain q=1.0 cannot be told: at least 2 more repeats would tell.",
    )
    assert verdict.rows[0][-1] == "too few runs"


def test_what_was_not_measured_is_said() -> None:
    (verdict,) = choices(run_of(size(1.0), *delivered(1.0, 10)), ALL)
    assert "plain q=1.0 cannot be judged by the error: add an evaluator" in verdict.sentences[1]


def test_a_reader_that_failed_erred_beyond_all() -> None:
    crashed = [replace(cell, status="crashed", measurements=()) for cell in read(1.0, [0.0] * 5)]
    assert judged(Demand("radio", error_m=0.1), size(1.0), *crashed)["q=1.0"].verdict == "fails"


def test_ways_over_one_link_are_told_apart_and_journeys_that_are_equal_are_not() -> None:
    cells = [size(1.0), *delivered(1.0, 3, transport="datagrams"), *delivered(1.0, 10, transport="arq")]
    cells += read(1.0, [0.05] * 5, transport="arq")
    found = {candidate.way: candidate for candidate in candidates(run_of(*cells), ALL)}
    assert found.keys() == {"transport=datagrams", "transport=arq"}
    assert found["transport=arq"].verdict == "passes"
    assert found["transport=datagrams"].unmeasured == ("the error",)


def test_other_links_do_not_count_and_are_named_where_there_is_nothing() -> None:
    cells = [size(1.0), *delivered(1.0, 10), *delivered(1.0, 0, link="sound")]
    assert judged(Demand("radio", deadline_ms=100), *cells)["q=1.0"].share == 1.0
    with pytest.raises(NotMeasured, match="nothing was measured over link 'light'; it has radio, sound"):
        candidates(run_of(*cells), Demand("light", deadline_ms=100))
    with pytest.raises(NotMeasured, match="no evaluator of it has a link"):
        candidates(run_of(size(1.0)), Demand("radio", deadline_ms=100))


def timed(q: float, encode_ms: float) -> CellResult:
    cell = cell_result("plain", q, "clock")
    code = Metric("code_ms", "ms", "lower", "", ("median",), role="time", need="encoding")
    return replace(cell, metrics={"code_ms": code}, summaries={("code_ms", "", "median"): encode_ms})


def test_a_slower_device_makes_pictures_older() -> None:
    cells = [size(1.0), *delivered(1.0, 10), timed(1.0, 11.0)]
    asked = {"deadline_ms": 100.0, "share": 0.9}
    assert judged(Demand("radio", **asked, device_factor=4.0), *cells)["q=1.0"].share == 1.0  # 50 + 44 ms
    assert judged(Demand("radio", **asked, device_factor=5.0), *cells)["q=1.0"].share == 0.0  # 50 + 55 ms
    (verdict,) = choices(run_of(*cells), Demand("radio", **asked, device_factor=4.0))
    assert verdict.title == "s: over radio, 90 % of the pictures of a device 4 times slower within 100 ms"
    with pytest.raises(NotMeasured, match="no encoding was timed"):
        judged(Demand("radio", **asked, device_factor=4.0), *cells[:-1])


def test_what_was_simulated_is_not_added_again() -> None:
    cells = [size(1.0), *delivered(1.0, 10, encode_ms="measured"), timed(1.0, 11.0)]
    assert judged(Demand("radio", deadline_ms=100), *cells)["q=1.0"].share == 1.0
    with pytest.raises(NotMeasured, match="the time of encoding was simulated with encode_ms"):
        judged(Demand("radio", deadline_ms=100, device_factor=4.0), *cells)


def test_sequences_come_together_first() -> None:
    cells = [size(1.0), size(1.0, "t"), *delivered(1.0, 10), *delivered(1.0, 3, sequence="t")]
    verdicts = choices(run_of(*cells), Demand("radio", deadline_ms=100))
    assert [verdict.title.split(":")[0] for verdict in verdicts] == ["all sequences together", "s", "t"]
    assert [verdict.rows[0][2] for verdict in verdicts] == ["65 % (5/10 runs)", "100 % (5/5 runs)", "30 % (0/5 runs)"]


def test_without_a_rate_nothing_is_called_the_least() -> None:
    (verdict,) = choices(run_of(*delivered(1.0, 10)), Demand("radio", deadline_ms=100))
    assert "No rate was measured" in verdict.sentences[1]
    assert np.array(verdict.rows).shape == (1, 5)


ERRORS = [0.10, 0.12, 0.09, 0.11, 0.10]
"""Of the setting q=2 on five runs; that of q=1 is ten times as much, that of q=4 a little more and a little less."""
BY_ERROR = [
    *(size(q) for q in (1.0, 2.0, 4.0)),
    *delivered(1.0, 3), *read(1.0, [10 * error * (1 + 0.1 * at) for at, error in enumerate(ERRORS)]),
    *delivered(2.0, 10), *read(2.0, ERRORS),
    *delivered(4.0, 10), *read(4.0, [0.11, 0.11, 0.10, 0.10, 0.12]),
]  # fmt: skip


def test_the_setting_of_the_least_error_stands_beside_those_that_may_be_as_good() -> None:
    (answer,) = least_errors(run_of(*BY_ERROR))
    assert (answer.link, answer.sequence, answer.runs) == ("radio", "s", 5)
    assert answer.best.name == "plain q=2.0"
    assert answer.error_m == pytest.approx(np.exp(np.mean(np.log(ERRORS))))
    assert [candidate.name for candidate in answer.worse] == ["plain q=1.0"]
    assert [candidate.name for candidate in answer.level] == ["plain q=4.0"]
    assert not answer.is_told


def test_a_single_run_tells_nothing_and_one_that_failed_is_the_worst() -> None:
    (answer,) = least_errors(run_of(*read(1.0, [1.0]), *read(2.0, [0.1])))
    assert (answer.best.name, len(answer.worse), len(answer.level)) == ("plain q=2.0", 0, 1)
    crashed = [replace(cell, status="crashed", measurements=()) for cell in read(1.0, [0.0] * 2)]
    (answer,) = least_errors(run_of(*crashed, *read(2.0, [0.1, 0.2])))
    assert answer.best.name == "plain q=2.0"


@pytest.mark.thorough
def test_settings_that_are_alike_are_seldom_told_apart() -> None:
    rng, found = np.random.default_rng(0), 0
    for _ in range(100):
        errors = np.exp(rng.normal(0, 0.3, (5, 6)))
        cells = [cell for q, row in enumerate(errors.tolist()) for cell in read(float(q), row)]
        (answer,) = least_errors(run_of(*cells))
        found += any(candidate.point == "q=0.0" for candidate in answer.worse)
    assert found <= 5, "the first, which is as good as any, is said to be worse in at most one of twenty"


def test_without_a_demand_the_least_error_is_named_over_each_link_with_what_limits_the_others() -> None:
    cells = [*BY_ERROR, *delivered(1.0, 10, "wire"), *read(1.0, [0.2] * 5, "wire")]
    (verdict,) = chosen(run_of(*cells), Demand(""))
    assert verdict.title == "least error over each link"
    assert verdict.heads == (
        "link", "take", "rate [bpp]", "error [m]", "how sure", "not told apart, at less rate", "limits of the others"
    )  # fmt: skip
    assert verdict.rows == (
        ("radio", "plain q=2.0", "2", "0.104", "better than 1 of 2 others", "–", "pictures gone astray: plain q=1.0"),
        ("wire", "plain q=1.0", "1", "0.2", "the only setting", "–", "–"),
    )
    assert "5 runs of each setting" in verdict.sentences[0]
    (alone,) = chosen(run_of(*cells), Demand("wire"))
    assert [row[0] for row in alone.rows] == ["wire"]


def test_a_demand_without_a_link_is_answered_for_each_after_a_table_of_all() -> None:
    cells = [*BY_ERROR, *delivered(1.0, 10, "wire"), *read(1.0, [0.9] * 5, "wire")]
    overview, *each = chosen(run_of(*cells), Demand("", error_m=0.5))
    assert overview.title == "s: over each link, an error of at most 0.5 m"
    assert overview.rows == (
        ("radio", "plain q=2.0", "2", "5/5 runs, at least 57 % at 95 %", "the error: plain q=1.0"),
        ("wire", "none is known to hold", "–", "–", "the error: plain q=1.0"),
    )
    assert [verdict.title.split(",")[0] for verdict in each] == ["s: over radio", "s: over wire"]


def test_sequences_weigh_the_same_in_the_answer_of_all() -> None:
    cells = [*read(1.0, [1.0] * 5), *read(1.0, [0.01], sequence="t"), *read(2.0, [0.5] * 5)]
    pooled, *single = least_errors(run_of(*cells, *read(2.0, [0.1], sequence="t")))
    assert (pooled.sequence, pooled.best.name, pooled.error_m) == ("", "plain q=1.0", pytest.approx(0.1))
    assert [(answer.sequence, answer.best.name) for answer in single] == [("s", "plain q=2.0"), ("t", "plain q=1.0")]


def test_where_nothing_was_measured_it_is_said_for_all_links() -> None:
    with pytest.raises(NotMeasured, match="no evaluator of it has a link"):
        chosen(run_of(size(1.0)), Demand("", error_m=0.1))
    with pytest.raises(NotMeasured, match="no error was measured over radio"):
        chosen(run_of(size(1.0), *delivered(1.0, 10)), Demand(""))
    with pytest.raises(NotMeasured, match="nothing was measured over link 'light'; it has radio"):
        chosen(run_of(*BY_ERROR), Demand("light"))


def test_the_report_begins_with_what_to_take_over_each_link() -> None:
    html = render(run_of(*BY_ERROR), lambda _: {"frames": [], "originals": []})
    answer = html[html.index('<section id="answer"') :]
    table = answer[answer.index('<div id="links">') : answer.index("</table>")]
    assert "<td" in table
    assert all(word in table for word in ("radio", "plain q=2.0", "better than 1 of 2 others"))
