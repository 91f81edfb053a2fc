"""A strip for each codec: where its settings lie, which pass, which is the pick, and what the page says of it."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import pytest
from measured_runs import METRICS, cell_result, run_of
from told import numbers

from codecbench.core.analysis.table import CellResult
from codecbench.core.contracts.metric import Metric
from codecbench.core.facade import Run
from codecbench.core.report.answers import answers
from codecbench.core.report.page import render
from codecbench.core.report.strips import Row, Strips, strips

KBPS = Metric("kbps", "kbit/s", "lower", "", role="rate")


def tracked(codec: str, rates: dict[float, list[float]], kbps: float = 0.0) -> list[CellResult]:
    """Settings by rate with their runs, which hold or not. kbps: for each bit a pixel; 0 if no bit rate is known."""
    cells = []
    for rate, runs in rates.items():
        size = {("bits", ""): [rate], **({("kbps", ""): [kbps * rate]} if kbps else {})}
        cells.append(replace(cell_result(codec, rate, "size", own=size), metrics={**METRICS, "kbps": KBPS}))
        cells += [cell_result(codec, rate, "track", own={("held", ""): [v]}, repeat=i) for i, v in enumerate(runs)]
    return cells


GOOD, BAD = [1.0] * 5, [0.0] * 5
RAW = tracked("raw", {24.0: GOOD})


PLAIN = {2.0: GOOD, 1.0: BAD}


def no_frames(_: int) -> dict[str, Any]:
    return {"frames": [], "originals": []}


def drawn(*cells: CellResult) -> Strips:
    run = run_of(*cells)
    found = strips(run, answers(run))
    assert found is not None
    return found


def picks(found: Strips) -> list[tuple[str, str, str, str]]:
    return [(row.curve, row.pick, row.cost, row.saved) for row in found.rows]


def several() -> Run:
    good = {1.0: GOOD, 0.5: GOOD, 0.25: [1.0], 0.2: BAD}
    return run_of(*RAW, *tracked("plain", PLAIN), *tracked("good", good), *tracked("bad", {0.3: BAD}))


def test_strips_are_in_the_order_of_the_answer_on_one_logarithmic_axis() -> None:
    found = strips(several(), answers(several()))
    assert found is not None
    assert (found.about, found.unit) == ("held", "bpp")
    assert found.ticks == ((4.55, "0.2"), (40.72, "0.5"), (68.09, "1"), (95.45, "2"))
    assert picks(found) == [
        ("good", "q=0.5", "0.5 bpp", "75 % less than plain"),
        ("plain", "q=2.0", "2 bpp", "the anchor"),
        ("bad", "", "passes nowhere", ""),
    ]
    assert [(mark.setting, mark.verdict, mark.place, mark.is_pick) for mark in found.rows[0].marks] == [
        ("q=1.0", "passes", 68.09, False),
        ("q=0.5", "passes", 40.72, True),
        ("q=0.25", "inconclusive", 13.36, False),
        ("q=0.2", "fails", 4.55, False),
    ]
    assert [mark.place for row in found.rows[1:] for mark in row.marks] == [95.45, 68.09, 20.55]


def test_a_row_says_what_comes_after_its_pick_and_a_mark_what_was_found_of_it() -> None:
    found = strips(several(), answers(several()))
    assert found is not None
    assert [(row.after.partition(" (")[0], numbers(row.after)[1:]) for row in found.rows] == [
        ("q=0.25 is inconclusive", [1.0, 1.0, 3.0]),
        ("q=1.0 fails", [0.0, 5.0, 43.0, 95.0]),
        ("q=0.3 fails", [0.0, 5.0, 43.0, 95.0]),
    ]
    assert found.rows[0].words == "q=1.0, q=0.5: passes; q=0.25: inconclusive; q=0.2: fails"
    assert [(mark.words.partition(" (")[0], numbers(mark.words)[2:]) for mark in found.rows[1].marks] == [
        ("q=2.0, 2 bpp: passes", [5.0, 5.0, 57.0, 95.0]),
        ("q=1.0, 1 bpp: fails", [0.0, 5.0, 43.0, 95.0]),
    ]


def test_the_axis_is_in_mbit_a_second_where_the_bit_rate_of_all_settings_is_known() -> None:
    plain = tracked("plain", PLAIN, 1500.0)
    found = drawn(*RAW, *plain, *tracked("good", {1.5: GOOD}, 1000.0))
    assert found.unit == "Mbit/s"
    assert picks(found) == [
        ("good", "q=1.5", "1.5 Mbit/s", "50 % less than plain"),
        ("plain", "q=2.0", "3 Mbit/s", "the anchor"),
    ]
    assert drawn(*RAW, *plain, *tracked("good", {1.5: GOOD})).unit == "bpp"


def test_where_times_decide_the_axis_is_in_milliseconds() -> None:
    cells = []
    for codec, rate, ms in (("raw", 24.0, 0.1), ("plain", 0.5, 8.0), ("quick", 2.0, 1.5)):
        scores = {("bits", ""): [rate] * 5, ("score", ""): [40.0, 40.2, 39.8, 40.1, 39.9]}
        timed = {("encoding", ""): [2.0 * ms / 3.0], ("decoding", ""): [ms / 3.0], ("speed", ""): [ms]}
        cells += [cell_result(codec, rate, "look", scores), cell_result(codec, rate, "clock", own=timed)]
    untimed = cell_result("untimed", 1.0, "look", {("bits", ""): [1.0] * 5, ("score", ""): [40.0] * 5})
    found = drawn(*cells, untimed)
    assert found.unit == "ms"
    assert [(row.curve, row.pick, row.cost) for row in found.rows] == [
        ("quick", "q=2.0", "1.5 ms"),
        ("plain", "q=0.5", "8 ms"),
        ("untimed", "q=1.0", ""),
    ]
    assert [row.saved.partition(" than ")[0] for row in found.rows] == ["81 % less time", "the anchor", ""]
    assert found.rows[2].marks[0].place is None
    assert found.rows[2].marks[0].words.startswith("q=1.0: passes (40 dB ± 0.16")
    assert numbers(found.rows[2].marks[0].words) == [1.0, 40.0, 0.16, 32.0]


def test_a_codec_without_a_pick_says_why_and_nothing_is_saved_beside_an_anchor_without_one() -> None:
    found = drawn(*RAW, *tracked("plain", {1.0: [1.0]}), *tracked("good", {0.5: GOOD}))
    assert picks(found) == [("good", "q=0.5", "0.5 bpp", ""), ("plain", "", "no pick", "")]
    assert "coarser" in found.rows[0].after
    unknown = drawn(*RAW, *tracked("plain", {0.5: GOOD})[1:])
    why = unknown.rows[0].after
    assert unknown.rows == (Row("plain", "", "no pick", "", why, ()),)
    assert why.endswith("rate: q=0.5")


def test_without_an_answer_by_settings_there_are_no_strips() -> None:
    run = run_of(*tracked("plain", PLAIN)[:1])
    assert strips(run, answers(run)) is None


@pytest.mark.parametrize(
    ("rates", "numbers"),
    [
        ((1.0,), ["0.5", "1", "2"]),
        ((3.0, 7.0), ["3", "5", "7", "9"]),
        ((0.05, 5.0), ["0.1", "0.3", "1", "3"]),
        ((0.001, 900.0), ["0.001", "0.1", "10", "1000"]),
    ],
)
def test_the_axis_has_three_to_six_numbers(rates: tuple[float, ...], numbers: list[str]) -> None:
    found = drawn(*RAW, *tracked("plain", dict.fromkeys(rates, GOOD)))
    assert [text for _, text in found.ticks] == numbers
    assert all(place is not None and 0.0 <= place <= 100.0 for place, _ in found.ticks)


def test_the_page_draws_a_strip_without_a_script_and_has_the_sentences_folded() -> None:
    html = render(several(), no_frames)
    assert html.index('<p class="answer">') < html.index('<ol class="strips">') < html.index('<div id="curve"')
    found = strips(several(), answers(several()))
    assert found is not None
    good = found.rows[0]
    assert f'<div data-curve="good"><b>good</b> q=0.5 <span class="cost"><b>0.5 bpp</b>, {good.saved}</span>' in html
    assert f'role="img" aria-label="good: {good.words}"' in html
    assert (
        f'<g class="passes"><title>{good.marks[1].words}</title>'
        '<circle class="ring" cx="40.72%" cy="12" r="10"/><use href="#mark-passes" x="40.72%" y="12"/></g>'
    ) in html
    words = re.search(r"<summary>In words</summary>.*?</details>", html)
    assert words is not None
    bad = answers(several()).answers[2]
    assert bad.curve == "bad"
    assert f"<li>{bad.sentence}</li>" in words[0]


def test_the_answer_is_bold_up_to_a_semicolon_outside_brackets() -> None:
    runs = [run_of(*RAW, *tracked("plain", {0.5: held})) for held in (GOOD, [1.0])]
    shown = [re.findall('<p class="answer">(.*?)</p>', render(run, no_frames)) for run in runs]
    (first, rest), nothing = str(answers(runs[0])).split("; ", 1), str(answers(runs[1]))
    assert shown == [[f"<b>{first}</b>; {rest}"], [f"<b>{nothing}</b>"]]
    assert first.endswith("0.5 bpp")
    assert "; at least 3" in nothing


def test_more_than_eight_codecs_are_folded() -> None:
    many = [cell for number in range(10) for cell in tracked(f"codec{number}", {1.0 + number: GOOD})]
    html = render(run_of(*RAW, *many), no_frames)
    first, _, rest = html.partition("<summary>2 more</summary>")
    assert [part.count('<div data-curve="') for part in (first, rest)] == [8, 2]
