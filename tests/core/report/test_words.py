"""What a run decides, in words."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from measured_runs import cell_result, run_of
from told import numbers

from codecbench.cli.rank import print_in_format
from codecbench.core.analysis.evidence import Evidence, student_quantile
from codecbench.core.analysis.ranking import NO_COMMON_RATE, rankings
from codecbench.core.analysis.table import CellResult
from codecbench.core.report.formatting import (
    Verdict,
    less_rate,
    ranked_verdict,
    setting_words,
    signed_percent,
    verdicts,
    verdicts_at,
)


def tracked(codec: str, rate: float, held: list[float], drift: float, sequence: str = "s") -> list[CellResult]:
    """The cells of a setting whose runs hold or not, with such a drift."""
    cells = [cell_result(codec, rate, "size", own={("bits", ""): [rate]}, sequence_name=sequence)]
    rng = np.random.default_rng(round(1000 * rate + 1000 * drift))
    for repeat, value in enumerate(held):
        own = {("held", ""): [value], ("drift", ""): [drift * float(np.exp(rng.normal(0.0, 0.05)))]}
        cells.append(cell_result(codec, rate, "track", own=own, repeat=repeat, sequence_name=sequence))
    return cells


HOLDS, FAILS = [1.0] * 5, [0.0] * 5


def example(sequence: str = "s") -> list[CellResult]:
    cells = tracked("raw", 24.0, HOLDS, 1.0, sequence)
    for codec, factor in (("plain", 1.0), ("mine", 0.5)):
        for rate, held in ((0.25, FAILS), (0.5, HOLDS), (1.0, HOLDS)):
            cells += tracked(codec, rate * factor, held, factor / rate, sequence)
    return cells


def test_a_run_is_decided_in_a_table_and_a_sentence_for_each_codec() -> None:
    ranking, held = verdicts(run_of(*example()))
    assert ranking.title == "s: drift, 5 repeats"
    assert ranking.heads == ("codec", "rate vs. plain", "significantly better than")
    assert ranking.rows == (("mine", "-75 % ± 2", "plain (-75 % ± 2)"), ("plain", "–", "–"))
    (sentence,) = ranking.sentences
    assert "take mine (q 0.125–0.5): 75 % ± 2 less" in sentence
    assert held.title == "s: held"
    assert [(sentence.split()[0], numbers(sentence)) for sentence in held.sentences] == [
        ("mine", [0.25, 1.0, 96.0, 0.25, 5.0, 5.0, 57.0, 95.0, 0.125, 0.0, 5.0, 43.0, 95.0]),
        ("plain", [0.5, 1.0, 48.0, 0.5, 5.0, 5.0, 57.0, 95.0, 0.25, 0.0, 5.0, 43.0, 95.0]),
        ("raw", [5.0, 5.0, 57.0, 95.0]),
    ]


def test_programs_read_the_same_and_which_column_it_is_about(capsys: pytest.CaptureFixture[str]) -> None:
    run = run_of(*example())
    found = verdicts(run)
    print_in_format(run, found, "json")
    ranking, held = json.loads(capsys.readouterr().out)
    assert [ranking["title"], held["title"]] == [verdict.title for verdict in found]
    assert [tuple(row) for row in ranking["rows"]] == list(found[0].rows)
    assert ranking["about"] in run.wide
    assert held["about"] is None or held["about"] in run.wide


@pytest.mark.parametrize("form", ["text", "markdown"])
def test_people_read_what_is_noted_of_a_setting_below_verdicts(form: str, capsys: pytest.CaptureFixture[str]) -> None:
    note = "half the color"
    cells = [replace(cell, notes=(note,)) if cell.cell.codec.name == "mine" else cell for cell in example()]
    run = run_of(*cells)
    print_in_format(run, verdicts(run), form)
    assert capsys.readouterr().out.count(f"mine: {note}.") == 1


def test_missing_values_are_counted() -> None:
    crashed = cell_result("mine", 0.5, "track", repeat=4, status="crashed", reason="signal 11")
    cells = [cell for cell in example() if (cell.cell.codec.params["q"], cell.cell.repeat) != (0.5, 4)]
    others = [cell for cell in example() if cell.cell.codec.name == "plain" and cell.cell.repeat == 4]
    ranking, held = verdicts(run_of(*cells, crashed, *(cell for cell in others if cell.cell.codec.params["q"] == 0.5)))
    assert any("mine: 1 of 15 values" in sentence for sentence in ranking.sentences)
    assert any("mine" in sentence and "4/5 runs" in sentence for sentence in held.sentences)


def test_several_sequences_come_together_first_and_alone_in_brief() -> None:
    run = run_of(*example("one"), *example("two"))
    titles = [verdict.title for verdict in verdicts(run)]
    together = "all sequences together"
    assert titles == [
        f"{together}: drift, 10 repeats", "one: drift, 5 repeats", "two: drift, 5 repeats",
        f"{together}: held", "one: held", "two: held",
    ]  # fmt: skip
    brief = verdicts(run, brief=True)
    assert [verdict.title for verdict in brief] == [titles[0], titles[3]]
    assert "10/10 runs" in brief[1].sentences[0]


def test_codecs_without_a_significant_difference_are_named_with_what_would_decide() -> None:
    cells = [*tracked("plain", 1.0, [1.0, 1.0], 1.0), *tracked("mine", 1.0, [1.0, 1.0], 1.001)]
    ranking, held = verdicts(run_of(*cells))
    taken, undecided_pair = ranking.sentences
    assert "take mine (q 1.0), or plain: " in taken
    assert "no significant difference (99 %" in taken
    assert undecided_pair.startswith("plain: inconclusive (≥ 0 % vs. mine)")
    assert "about 2 more" in undecided_pair
    assert "not known to" in held.sentences[0]
    assert "q=1.0 is inconclusive" in held.sentences[0]
    assert numbers(held.sentences[0]) == [1.0, 2.0, 2.0, 2.0]


def test_which_codec_to_take_at_a_rate_is_a_sentence() -> None:
    run = run_of(*example("one"), *example("two"))
    together, one, _ = verdicts_at(run, 0.27)
    assert together.title.endswith("together: drift, 10 repeats, at 0.27 bpp")
    assert together.heads == ("codec", "drift [m]", "setting", "rate vs. plain", "significantly better than")
    assert one.rows == (
        ("mine", "0.9439", "q 0.25", "-76 % ± 2", "plain (-76 % ± 2)"), ("plain", "3.734", "q 0.25", "–", "–"),
    )  # fmt: skip
    (sentence,) = one.sentences
    assert "take mine" in sentence
    assert numbers(sentence) == [0.27, 0.25, 76.0, 2.0]
    assert [numbers(words) for words in together.sentences] == [[0.27, 0.25, 76.0, 1.0], [1.0, 1.0]]
    assert verdicts_at(run, 7.0) == []
    alike = run_of(*tracked("plain", 1.0, [1.0, 1.0], 1.0), *tracked("mine", 1.0, [1.0, 1.0], 1.001))
    (undecided,) = verdicts_at(alike, 1.0)
    assert "take mine (q 1.0), or plain" in undecided.sentences[0]
    assert numbers(undecided.sentences[0]) == [1.0, 1.0, 99.0]


def level_over(codec: str, rates: tuple[float, ...], gain: float, count: int) -> list[CellResult]:
    """Settings whose score in dB rises with the rate; of frames that vary a little."""
    found = []
    for rate in rates:
        noise = np.random.default_rng(round(100 * (rate + gain))).normal(0.0, 0.5, count)
        values = {("bits", ""): [rate] * count, ("score", ""): (30 + 6 * np.log2(rate) + gain + noise).tolist()}
        found.append(cell_result(codec, rate, "look", values, count=count))
    return found


def test_codecs_without_a_common_rate_are_compared_by_the_rate_that_equal_values_take() -> None:
    cells = level_over("plain", (4.0, 8.0, 16.0), 0.0, 64) + level_over("thrifty", (0.25, 0.5, 1.0), 24.0, 64)
    run = run_of(*cells, *level_over("between", (0.5, 2.0, 8.0), 12.0, 64))
    (ranking,) = verdicts(run)
    assert ranking.rows == (
        ("thrifty", "-93.80 % ± 0.06", "between (-74.8 % ± 0.4), plain (-93.80 % ± 0.06)"),
        ("between", "-75.4 % ± 0.4", "plain (-75.4 % ± 0.4)"),
        ("plain", "–", "–"),
    )
    (sentence,) = ranking.sentences
    assert "take thrifty (q 0.25–1.0)" in sentence
    assert "93.80 % ± 0.06 less" in sentence


def test_codecs_that_share_no_values_either_have_no_rate_to_be_explained() -> None:
    cells = level_over("plain", (4.0, 8.0, 16.0), 0.0, 64) + level_over("between", (0.5, 2.0, 8.0), 0.0, 64)
    (ranking,) = verdicts(run_of(*cells, *level_over("coarse", (0.25, 0.5, 1.0), 0.0, 64)))
    assert {row[0]: row[1] for row in ranking.rows}["coarse"] == "–"
    (apart,) = (words for words in ranking.sentences if NO_COMMON_RATE in words)
    assert apart.startswith("coarse was not compared with plain")


def evidence(less: float, half: float, **more: Any) -> Evidence:
    """Of a codec that takes such a share of the other's rate, with an interval of so many logs on both sides."""
    return Evidence(-float(np.log(less)), (half / student_quantile(0.975, 1e9)) ** 2, 1e9, **more)


@pytest.mark.parametrize(
    ("found", "words", "less"),
    [
        (evidence(0.72, 0.0417), "-28 % ± 3", "28 % ± 3 less"),
        (evidence(1.31, 0.00412), "+31.0 % ± 0.5", "31.0 % ± 0.5 more"),
        (evidence(0.5, 0.0), "-50 % ± 0", "50 % ± 0 less"),
        (evidence(0.5, 1.5), "-50 %, -89 to +124 %", "50 % less (-89 to +124 %)"),
        (evidence(0.5, 5.0), "-50 %, no interval", "50 % less (no interval)"),
        (evidence(0.94, 0.01, at_least=True), "≤ -6 %", "at least 6 % less"),
        (evidence(1.06, 0.01, at_least=True), "≥ +6 %", "at least 6 % more"),
        (Evidence(np.log(2.0), math.nan, 0.0), "-50 %, no interval", "50 % less (no interval)"),
    ],
)
def test_a_difference_is_a_signed_percent_of_rate_with_its_interval(found: Evidence, words: str, less: str) -> None:
    assert (signed_percent(found), less_rate(found, "jpeg").replace(" rate than jpeg", "")) == (words, less)


@pytest.mark.parametrize(
    ("by_sequence", "words"),
    [
        ([("quality=40",)], "quality 40"),
        ([("quality=55", "quality=40")], "quality 40–55"),
        ([("bias=-5", "bias=5")], "bias -5–5"),
        ([("quality=9", "quality=10"), ("quality=10",)], "quality 9–10, depending on"),
        ([("mode=a", "mode=b")], "mode a to mode b"),
        ([("levels=2 qf=5", "levels=2 qf=20")], "levels 2 qf 5–20"),
        ([("",)], ""),
    ],
)
def test_settings_are_named_in_short(by_sequence: list[tuple[str, ...]], words: str) -> None:
    told = setting_words({str(place): points for place, points in enumerate(by_sequence)})
    assert told.removesuffix(" the sequence") == words


def undecided(**more: Any) -> Verdict:
    """The verdict on frames of two alike codecs, with more known of their difference."""
    run = run_of(*(cell for name in ("plain", "mine") for cell in level_over(name, (0.25, 0.5, 1.0), 0.2, 64)))
    (ranking,) = rankings(run)
    ((first, second, found),) = ranking.pairs
    return ranked_verdict(run, replace(ranking, pairs=((first, second, replace(found, **more)),)))


def test_how_many_frames_count_as_independent_and_drift_are_noted() -> None:
    assert [64.0, 13.0] in [numbers(words) for words in undecided(worth=12.7).sentences]
    (drift,) = (words for words in undecided(drifts=True).sentences if "drift" in words)
    assert drift.endswith(": plain and mine.")
    assert [words for words in undecided().sentences if "independent" in words or "drift" in words] == []


def test_of_too_few_frames_no_test_is_made() -> None:
    cells = [cell for name, gain in (("plain", 0.0), ("mine", 6.0)) for cell in
             level_over(name, (0.25, 0.5, 1.0), gain, 4)]  # fmt: skip
    (ranking,) = verdicts(run_of(*cells))
    (sentence,) = ranking.sentences
    assert "mine (q 0.25–1.0), or plain" in sentence
    assert "too few frames" in sentence


def test_pairs_that_do_not_bear_on_the_best_are_counted() -> None:
    cells = [cell for name, factor in (("plain", 1.0), ("alias", 1.01), ("best", 0.3)) for cell in
             (cell for rate in (0.25, 0.5, 1.0) for cell in tracked(name, rate, HOLDS, factor / rate))]  # fmt: skip
    ranking = verdicts(run_of(*cells))[0]
    assert ranking.sentences[1].startswith("1 other pair is inconclusive")
