"""What is said of codecs whose order and limits are known, and the pick of each in one table."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from measured_runs import HELD, SCORE, cell_result, run_of
from told import numbers

from codecbench.core.analysis.run_result import RunResult, judged_column
from codecbench.core.analysis.table import CellResult
from codecbench.core.contracts.evaluator import Measurement
from codecbench.core.engine.planning.model import SearchFinding
from codecbench.core.report.answers import Answers, answers
from codecbench.core.report.picks import answer_tables, picks, text_to_paste


def tracked(codec: str, rate: float, held: list[float], sequence: str = "s") -> list[CellResult]:
    """A setting of a rate, and its runs that hold or not."""
    sized = cell_result(codec, rate, "size", own={("bits", ""): [rate]}, sequence_name=sequence)
    runs = [
        cell_result(codec, rate, "track", own={("held", ""): [value]}, repeat=repeat, sequence_name=sequence)
        for repeat, value in enumerate(held)
    ]
    return [sized, *runs]


def scored(codec: str, levels: dict[float, float], count: int = 64, sequence: str = "s") -> list[CellResult]:
    """A codec of such rates and mean scores in dB, of frames that vary evenly by 0.2 dB."""
    wave = 0.2 * np.resize([1.0, -1.0, -1.0, 1.0], count)
    return [
        cell_result(
            codec, rate, "look", {("bits", ""): [rate] * count, ("score", ""): (level + wave).tolist()},
            count=count, sequence_name=sequence,
        )
        for rate, level in levels.items()
    ]  # fmt: skip


def sentences(found: Answers) -> dict[str, str]:
    return {answer.curve: answer.sentence for answer in found.answers}


def test_the_answer_is_the_setting_of_least_rate_that_passes_and_what_it_saves() -> None:
    raw = tracked("raw", 24.0, [1.0] * 5)
    plain = [*tracked("plain", 2.0, [1.0] * 5), *tracked("plain", 1.0, [0.0] * 5)]
    good = [*tracked("good", 1.0, [1.0] * 5), *tracked("good", 0.5, [1.0] * 5), *tracked("good", 0.25, [0.0] * 5)]
    found = answers(run_of(*raw, *plain, *good, *tracked("bad", 0.3, [0.0] * 5)))
    assert "“held”, s" in found.basis
    assert numbers(found.basis) == [5.0, 5.0, 5.0, 5.0, 57.0, 95.0]
    passing, failing = [5.0, 5.0, 57.0, 95.0], [0.0, 5.0, 43.0, 95.0]
    assert {curve: numbers(sentence) for curve, sentence in sentences(found).items()} == {
        "good": [0.5, 1.0, 48.0, 0.5, *passing, 0.25, *failing],
        "plain": [2.0, 1.0, 12.0, 2.0, *passing, 1.0, *failing],
        "bad": [0.3, *failing],
    }
    assert [answer.passes for answer in found.answers] == [True, True, False]
    assert str(found).startswith("Use good q=0.5: 0.5 bpp, 75 % less")
    assert "smallest plain" in str(found)
    assert numbers(str(found))[3:] == [2.0, 2.0, *passing, 5.0]


NAN = float("nan")
WHY = "raw is no reference"


def unjudged(codec: str, rate: float, sequence: str = "s") -> list[CellResult]:
    """Runs that are tracked in time (`kept`), and of which nobody can say whether they hold."""
    cells = tracked(codec, rate, [NAN] * 5, sequence)
    kept = replace(HELD, name="kept", label="kept")
    return [
        replace(cell, metrics={**cell.metrics, "kept": kept},
                measurements=(Measurement("held", NAN, reason=WHY), Measurement("kept", 1.0)))
        if cell.cell.evaluator.name == "track" else cell
        for cell in cells
    ]  # fmt: skip


def test_a_success_that_no_run_has_is_not_left_out_of_what_is_asked() -> None:
    """The other one alone would pass every codec. Without raw's runs there is nothing that it could be beside."""
    codecs = [*unjudged("plain", 2.0), *unjudged("plain", 1.0)]
    neither = answers(run_of(*unjudged("raw", 24.0), *codecs))
    assert [answer.passes for answer in neither.answers] == [None]
    assert str(neither).endswith(f": {WHY}.")
    told = str(answers(run_of(*codecs)))
    assert told.startswith("Use plain q=1.0")
    assert "kept in 5 of 5" in told


def test_a_task_that_says_what_is_enough_decides_if_no_success_can() -> None:
    task = replace(SCORE, role="task", enough=0.9)
    own = [cell_result(codec, rate, "find", {("score", ""): [value] * 16}, count=16)
           for codec, rate, value in (("raw", 24.0, 1.0), ("plain", 2.0, 0.95), ("plain", 1.0, 0.5))]  # fmt: skip
    frames = [replace(cell, metrics={"score": task}) for cell in own]
    run = run_of(*unjudged("raw", 24.0), *unjudged("plain", 2.0), *unjudged("plain", 1.0), *frames)
    assert str(answers(run)).startswith("Use plain q=2.0: 2 bpp; score:")


def test_the_answer_says_on_which_sequences_nothing_can_be_judged() -> None:
    there = [*tracked("raw", 24.0, [1.0] * 5), *tracked("plain", 1.0, [1.0] * 5)]
    silent = [*tracked("raw", 24.0, [NAN] * 5, "t"), *tracked("plain", 1.0, [NAN] * 5, "t")]
    found = answers(run_of(*there, *silent))
    assert "2 sequences together" in str(found)
    assert "judged on t)" in str(found)
    assert "judged" not in str(answers(run_of(*there)))


def test_the_anchor_is_compared_with_the_next_codec_and_what_never_failed_has_a_lower_limit() -> None:
    plain = [*tracked("plain", 1.0, [1.0] * 5), *tracked("plain", 0.5, [1.0] * 5)]
    found = answers(run_of(*tracked("raw", 24.0, [1.0] * 5), *plain, *tracked("good", 2.0, [1.0] * 5)))
    for part in (
        "Use plain q=0.5 or coarser: 0.5 bpp, 75 % less",
        "next codec",
        "(good q=2.0)",
        ": try coarser plain.",
    ):
        assert part in str(found)


def test_codecs_whose_search_was_stopped_are_named() -> None:
    plain, good = tracked("plain", 1.0, [1.0] * 5), tracked("good", 0.5, [0.0] * 5)
    run = run_of(*tracked("raw", 24.0, [1.0] * 5), *plain, *good)
    search = SearchFinding("s", "good", "passes", "stopped", "", None, 1, "no time left to try q=1.0")
    stopped = replace(run, plan=replace(run.plan, searches=(search,)))
    assert "unfinished" not in str(answers(run))
    assert str(answers(stopped)).endswith("unfinished: good.")
    nothing = replace(run_of(*tracked("raw", 24.0, [1.0] * 5), *good), plan=stopped.plan)
    assert str(answers(nothing)).startswith("Nothing is known to pass")
    assert str(answers(nothing)).endswith(f": good: {search.words}.")


def test_a_single_run_is_inconclusive_and_the_missing_number_is_named() -> None:
    found = answers(run_of(*tracked("raw", 24.0, [1.0]), *tracked("plain", 0.5, [1.0]), *tracked("plain", 0.25, [0.0])))
    assert found.answers[0].passes is None
    assert str(found).startswith("Nothing is known to pass")
    assert "plain q=0.5 (" in str(found)
    assert numbers(str(found)) == [0.5, 1.0, 1.0, 3.0]


def test_nothing_passes_where_nothing_does() -> None:
    found = answers(run_of(*tracked("raw", 24.0, [1.0] * 5), *tracked("plain", 2.0, [0.0] * 5)))
    assert str(found).startswith("Nothing passes")
    assert "plain q=2.0 (" in str(found)
    assert numbers(str(found)) == [2.0, 0.0, 5.0, 43.0, 95.0]


def test_a_codec_without_runs_that_can_be_judged_has_the_reason() -> None:
    unknown = [*tracked("plain", 0.5, [1.0] * 5)[1:], *tracked("raw", 24.0, [1.0] * 5)]
    found = answers(run_of(*unknown))
    assert found.answers[0].passes is None
    assert sentences(found)["plain"].endswith("unknown rate: q=0.5.")
    assert str(found).endswith("unknown rate: q=0.5.")


def test_without_a_task_a_setting_passes_by_quality_beside_raw() -> None:
    """Raw has 40 dB, of which four fifths are enough."""
    plain, good = scored("plain", {1.0: 36.0, 0.5: 33.0, 0.25: 30.0}), scored("good", {0.5: 36.0, 0.25: 33.0})
    found = answers(run_of(*scored("raw", {24.0: 40.0}), *plain, *good))
    assert str(found).startswith("Use good q=0.25")
    assert "score: 33 dB, ≥ 32 dB" in str(found)
    assert numbers(str(found)) == [0.25, 0.25, 50.0, 0.5, 0.5, 33.0, 32.0, 64.0]


def test_without_raw_nothing_passes_or_fails_and_the_ranking_answers() -> None:
    plain, good = scored("plain", {1.0: 36.0, 0.5: 33.0, 0.25: 30.0}), scored("good", {0.5: 36.0, 0.25: 33.0})
    found = answers(run_of(*plain, *good))
    assert found.basis.startswith("Judged by score, s; add codec raw")
    assert "take good (q 0.25–0.5)" in str(found)


def test_where_times_and_no_task_were_measured_milliseconds_decide() -> None:
    cells = []
    for codec, rate, ms in (("raw", 24.0, 0.1), ("plain", 0.5, 8.0), ("quick", 2.0, 1.5)):
        cells += scored(codec, {rate: 40.0})
        timed = {("encoding", ""): [2.0 * ms / 3.0], ("decoding", ""): [ms / 3.0], ("speed", ""): [ms]}
        cells.append(cell_result(codec, rate, "clock", own=timed))
    told = str(answers(run_of(*cells)))
    assert told.startswith("Use quick q=2.0: 1 ms to encode and 0.5 ms to decode")
    for part in ("2 bpp, 81 % less time", "coarsest plain", "(q=0.5, 8 ms)", "score: 40 dB, ≥ 32 dB"):
        assert part in told


def test_a_delay_without_the_time_of_coding_decides_nothing() -> None:
    cells = []
    for codec, rate in (("raw", 24.0), ("plain", 0.5), ("good", 0.25)):
        cells += [*scored(codec, {rate: 40.0}), cell_result(codec, rate, "clock", own={("speed", ""): [1.0]})]
    told = str(answers(run_of(*cells)))
    assert told.startswith("Use good q=0.25")
    assert "50 % less" in told


def test_without_a_rate_or_anything_to_judge_by_nothing_is_claimed() -> None:
    assert answers(run_of(cell_result("plain", 1.0, "look", own={("score", ""): [30.0]}))).answers == ()
    spent = answers(run_of(cell_result("plain", 1.0, "look", own={("bits", ""): [1.0]})))
    assert spent.answers == ()
    assert str(spent).startswith("Nothing can be recommended")
    assert "nor quality" in str(spent)


@pytest.mark.parametrize(
    ("own", "metric"),
    [({"score": 1.0, "drift": 1.0, "held": 1.0}, "drift"), ({"score": 1.0, "blur": 1.0}, "score"), ({}, None)],
)
def test_the_column_that_is_judged_is_a_task_before_quality(own: dict[str, float], metric: str | None) -> None:
    values = {(name, ""): [value] for name, value in own.items()} | {("bits", ""): [1.0]}
    found = judged_column(run_of(cell_result("plain", 1.0, "look", own=values)))
    assert (found and found.metric.name) == metric


def judged() -> RunResult:
    """`good` takes half the rate of the anchor `plain`, and `bad` passes nowhere."""
    raw = tracked("raw", 24.0, [1.0] * 5)
    plain = [*tracked("plain", 2.0, [1.0] * 5), *tracked("plain", 1.0, [0.0] * 5)]
    good = [*tracked("good", 1.0, [1.0] * 5), *tracked("good", 0.5, [1.0, 1.0, 1.0, 1.0, 0.0])]
    return run_of(*raw, *plain, *good, *tracked("bad", 0.3, [0.0] * 5))


def test_a_row_a_codec_in_the_order_of_the_answer() -> None:
    run = judged()
    (table,) = picks(run, answers(run))
    assert table.title.endswith("codec, s, 5 frames, 5 runs per setting")
    assert table.heads == ("codec", "setting", "bpp", "vs. plain", "next coarser")
    assert table.rows == (
        ("good", "q=1.0", "1.00", "-50 %", "q=0.5 inconclusive"),
        ("plain", "q=2.0", "2.00", "–", "q=1.0 fails"),
    )
    same, without = table.sentences
    assert "runs 5/5" in same
    assert without.endswith("passes: bad.")
    assert [row[0] for row in table.rows] == [answer.curve for answer in answers(run).answers[:2]]


def test_if_nothing_passes_there_is_a_row_for_what_comes_nearest_of_each_codec() -> None:
    """Of `near` both settings may pass, of `plain` none does."""
    near = [*tracked("near", 1.0, [1.0] * 3), *tracked("near", 0.5, [1.0] * 3)]
    plain = [*tracked("plain", 2.0, [0.0] * 5), *tracked("plain", 1.0, [0.0] * 5)]
    run = run_of(*tracked("raw", 24.0, [1.0] * 5), *plain, *near)
    (table,) = picks(run, answers(run))
    assert table.heads == ("codec", "setting", "bpp", "runs", "verdict")
    assert table.rows == (
        ("near", "q=0.5", "0.500", "3/3", "inconclusive"),
        ("plain", "q=2.0", "2.00", "0/5", "fails"),
    )


def test_what_is_the_same_in_all_rows_stands_below() -> None:
    """Raw has 40 dB, of which four fifths are enough."""
    plain, good = scored("plain", {1.0: 36.0, 0.5: 33.0}), scored("good", {0.5: 36.0, 0.25: 33.0})
    run = run_of(*scored("raw", {24.0: 40.0}), *plain, *good)
    (table,) = picks(run, answers(run))
    assert table.heads == ("codec", "setting", "bpp", "vs. plain")
    assert table.rows == (("good", "q=0.25", "0.250", "-50 %"), ("plain", "q=0.5", "0.500", "–"))
    (same,) = table.sentences
    assert "score 33.0" in same
    assert numbers(same) == [33.0]


def test_without_criteria_every_setting_is_shown() -> None:
    run = run_of(*(cell_result("plain", rate, "size", own={("bits", ""): [rate]}) for rate in (2.0, 0.123456)))
    (table,) = picks(run, answers(run))
    assert table.title.endswith("setting of p")
    assert table.heads == ("setting", "bits")
    assert table.rows == (("q=2.0", "2.00"), ("q=0.123456", "0.123"))
    (same,) = table.sentences
    for part in ("sequence s", "codec plain", "status ok"):
        assert part in same


@pytest.mark.parametrize("form", ["markdown", "latex"])
def test_a_pasted_table_brings_what_is_noted_and_the_answer(form: str) -> None:
    run = judged()
    noted = replace(run, results=[replace(run.results[0], notes=("half the color",)), *run.results[1:]])
    text = text_to_paste(noted, answer_tables(noted), form)
    title = answer_tables(noted)[0].title
    wanted = {
        "markdown": (
            "### notes\n\n- raw: half the color.\n\n"
            f"### {title}\n\n"
            "| codec | setting | bpp | vs. plain | next coarser |\n",
            "| good | q=1.0 | 1.00 | -50 % | q=0.5 inconclusive |\n",
            "### answer\n\n- Use good q=1.0: 1 bpp, 50 % less",
        ),
        "latex": (
            f"% notes\n% raw: half the color.\n\n% {title}\n\\begin{{tabular}}{{lllll}}\n",
            "good & q=1.0 & 1.00 & -50 \\% & q=0.5 inconclusive \\\\\n",
            "% answer\n% Use good q=1.0: 1 bpp, 50 % less",
        ),
    }
    for part in wanted[form]:
        assert part in text
