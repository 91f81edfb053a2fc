"""What a run decides, in words."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from measured_runs import cell_result, run_of

from codecbench.cli.rank import show_found
from codecbench.core.analysis.table import CellResult
from codecbench.core.report.formatting import verdicts, verdicts_at
from codecbench.core.report.page_data import verdict_tables


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
    assert ranking.heads == ("place", "codec", "group", "rate beside plain", "better than")
    assert [row[:3] for row in ranking.rows] == [("1", "mine", "a"), ("2", "plain", "b")]
    assert ranking.rows[0][4] == "plain (75 % less rate, 73 to 77)"
    assert ranking.sentences == ("Codecs that share a letter cannot be told apart.",)
    assert held.title == "s: held"
    assert held.sentences == (
        "mine q=0.25 holds at 1/96 of raw's rate, 0.25 bpp (5/5 runs, at least 57 % at 95 %); "
        "q=0.125 fails (0/5 runs, at most 43 % at 95 %).",
        "plain q=0.5 holds at 1/48 of raw's rate, 0.5 bpp (5/5 runs, at least 57 % at 95 %); "
        "q=0.25 fails (0/5 runs, at most 43 % at 95 %).",
        "raw itself: 5/5 runs, at least 57 % at 95 %.",
    )


def test_programs_read_the_same_and_which_column_it_is_about(capsys: pytest.CaptureFixture[str]) -> None:
    run = run_of(*example())
    found = verdicts(run)
    show_found(run, found, "json")
    ranking, held = json.loads(capsys.readouterr().out)
    assert [ranking["title"], held["title"]] == [verdict.title for verdict in found]
    assert [tuple(row) for row in ranking["rows"]] == list(found[0].rows)
    assert ranking["about"] in run.wide
    assert held["about"] is None or held["about"] in run.wide


@pytest.mark.parametrize("form", ["text", "markdown"])
def test_people_read_what_is_noted_of_a_setting_below_verdicts(form: str, capsys: pytest.CaptureFixture[str]) -> None:
    cells = [
        replace(cell, notes=("half the colour",)) if cell.cell.codec.name == "mine" else cell for cell in example()
    ]
    run = run_of(*cells)
    show_found(run, verdicts(run), form)
    assert capsys.readouterr().out.count("mine: half the colour.") == 1


def test_what_is_missing_is_said() -> None:
    crashed = cell_result("mine", 0.5, "track", repeat=4, status="crashed", reason="signal 11")
    cells = [cell for cell in example() if (cell.cell.codec.params["q"], cell.cell.repeat) != (0.5, 4)]
    others = [cell for cell in example() if cell.cell.codec.name == "plain" and cell.cell.repeat == 4]
    ranking, held = verdicts(run_of(*cells, crashed, *(cell for cell in others if cell.cell.codec.params["q"] == 0.5)))
    assert "mine: 1 of 15 values are missing; each counts as the worst." in ranking.sentences
    assert any("mine" in sentence and "4/5 runs" in sentence for sentence in held.sentences)


def test_several_sequences_come_together_first_and_alone_in_brief() -> None:
    run = run_of(*example("one"), *example("two"))
    titles = [verdict.title for verdict in verdicts(run)]
    assert titles == [
        "all sequences together: drift, 10 repeats", "one: drift, 5 repeats", "two: drift, 5 repeats",
        "all sequences together: held", "one: held", "two: held",
    ]  # fmt: skip
    brief = verdicts(run, brief=True)
    assert [verdict.title for verdict in brief] == [titles[0], titles[3]]
    assert "10/10 runs" in brief[1].sentences[0]


def test_codecs_that_cannot_be_told_apart_are_said_to_be_so() -> None:
    cells = [*tracked("plain", 1.0, [1.0, 1.0], 1.0), *tracked("mine", 1.0, [1.0, 1.0], 1.001)]
    ranking, held = verdicts(run_of(*cells))
    assert ranking.sentences == ("No two of these codecs can be told apart with 99 % confidence.",)
    assert held.sentences[0].startswith("plain: cannot tell of q=1.0 (2/2 runs; at least 2 more would tell)")


def test_which_codec_to_take_at_a_rate_is_a_sentence() -> None:
    run = run_of(*example("one"), *example("two"))
    together, one, _ = verdicts_at(run, 0.27)
    assert together.title == "all sequences together: drift, 10 repeats, at 0.27 bpp"
    assert together.heads == ("place", "codec", "group", "drift [m]", "setting", "better than")
    assert [row[:3] for row in one.rows] == [("1", "mine", "a"), ("2", "plain", "b")]
    assert one.sentences[0] == "At 0.27 bpp take mine q=0.25; it is better than every other: plain."
    assert together.sentences[0] == one.sentences[0]
    assert (
        "The order on a sequence is foretold by the others' with Kendall's tau 1.00 on average" in together.sentences[2]
    )
    assert verdicts_at(run, 7.0) == []
    alike = run_of(*tracked("plain", 1.0, [1.0, 1.0], 1.0), *tracked("mine", 1.0, [1.0, 1.0], 1.001))
    (undecided,) = verdicts_at(alike, 1.0)
    assert undecided.sentences[0] == "At 1 bpp take mine q=1.0, or plain, which cannot be told from it."


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
    assert ranking.rows[0][1:4] == ("thrifty", "a", "-94 %")
    assert ranking.rows[0][4].startswith("between (75 % less rate")
    assert "plain (94 % less rate" in ranking.rows[0][4]
    assert ranking.sentences == ("Codecs that share a letter cannot be told apart.",)


def test_codecs_that_share_no_values_either_have_no_rate_to_be_explained() -> None:
    cells = level_over("plain", (4.0, 8.0, 16.0), 0.0, 64) + level_over("between", (0.5, 2.0, 8.0), 0.0, 64)
    (ranking,) = verdicts(run_of(*cells, *level_over("coarse", (0.25, 0.5, 1.0), 0.0, 64)))
    assert {row[1]: row[3] for row in ranking.rows}["coarse"] == "–"
    assert any("was not compared with" in sentence for sentence in ranking.sentences)
    assert not any(sentence.startswith("The rate beside") for sentence in ranking.sentences)


@pytest.mark.parametrize(
    ("count", "gain", "sentence", "doubt"),
    [
        (4, 6.0, "confidence: so few frames cannot tell.", "so few frames cannot tell them apart in the ranking"),
        (
            64,
            0.2,
            "confidence.",
            "not told apart in the ranking, which asks for 99 % confidence over all pairs together",
        ),
    ],
)
def test_a_saving_that_the_ranking_does_not_stand_by_says_so(
    count: int, gain: float, sentence: str, doubt: str
) -> None:
    run = run_of(*(cell for name, more in (("plain", 0.0), ("mine", gain)) for cell in
                   level_over(name, (0.25, 0.5, 1.0), more, count)))  # fmt: skip
    (ranking,) = verdicts(run)
    assert ranking.sentences == (f"No two of these codecs can be told apart with 99 % {sentence}",)
    (table,), _ = verdict_tables(run)
    assert table["words"][0].endswith(f"({doubt}).")
