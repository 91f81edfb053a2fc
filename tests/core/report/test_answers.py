"""What is said of codecs whose order and limits are known."""

from __future__ import annotations

import numpy as np
import pytest
from measured_runs import cell_result, run_of

from codecbench.core.analysis.run_result import judged_column
from codecbench.core.analysis.table import CellResult
from codecbench.core.report.answers import Answers, answers

RATES = (0.25, 0.5, 1.0)


def tracked(codec: str, rate: float, held: list[float], sequence: str = "s") -> list[CellResult]:
    """A setting of a rate, and its runs that hold or not."""
    sized = cell_result(codec, rate, "size", own={("bits", ""): [rate]}, sequence_name=sequence)
    runs = [
        cell_result(codec, rate, "track", own={("held", ""): [value]}, repeat=repeat, sequence_name=sequence)
        for repeat, value in enumerate(held)
    ]
    return [sized, *runs]


def scored(
    codec: str,
    factor: float,
    rng: np.random.Generator,
    metric: str = "score",
    rates: tuple[float, ...] = RATES,
    sequence: str = "s",
    count: int = 64,
) -> list[CellResult]:
    """A codec that needs `factor` times the rate for the same score in dB, or drift; of frames that vary little."""
    found = []
    for rate in rates:
        level = 30 + 6 * np.log2(rate / factor) if metric == "score" else factor / rate
        noise = rng.normal(0, 0.2, count) if metric == "score" else np.zeros(count)
        values = {("bits", ""): [rate] * count, (metric, ""): (level + noise).tolist()}
        found.append(cell_result(codec, rate, "look", values, count=count, sequence_name=sequence))
    return found


def sentences(found: Answers) -> dict[str, str]:
    return {answer.curve: answer.sentence for answer in found.answers}


def test_a_codec_that_holds_is_said_to_hold_like_raw_at_its_least_rate() -> None:
    raw = tracked("raw", 24.0, [1.0] * 5)
    cells = [*tracked("plain", 1.0, [1.0] * 5), *tracked("plain", 0.5, [1.0] * 5), *tracked("plain", 0.25, [0.0] * 5)]
    found = answers(run_of(*raw, *cells, *tracked("bad", 0.3, [0.0] * 5)))
    assert found.basis == "Judged by “held”, s, 5 runs a setting; raw itself: 5/5 runs, at least 57 % at 95 %."
    assert sentences(found) == {
        "plain": "plain q=0.5 holds like raw at 1/48 of raw's rate, 0.5 bpp (5/5 runs, at least 57 % at 95 %); "
        "q=0.25 fails (0/5 runs, at most 43 % at 95 %).",
        "bad": "bad is not known to hold at any setting: q=0.3 fails (0/5 runs, at most 43 % at 95 %).",
    }
    assert [answer.holds for answer in found.answers] == [True, False]
    assert found.lines == (found.basis, *sentences(found).values())


def test_a_single_run_proves_nothing_and_says_how_many_more_would() -> None:
    found = answers(run_of(*tracked("raw", 24.0, [1.0]), *tracked("plain", 0.5, [1.0]), *tracked("plain", 0.25, [0.0])))
    assert sentences(found)["plain"] == (
        "plain q=0.5 held in its only run at 1/48 of raw's rate, 0.5 bpp, too few to tell; at least 3 more would tell."
    )
    assert found.answers[0].holds is None


def test_nothing_holds_like_raw_where_raw_is_not_known_to_hold() -> None:
    found = answers(run_of(*tracked("raw", 24.0, [1.0, 0.0] * 3), *tracked("plain", 0.5, [1.0] * 5)))
    assert sentences(found)["plain"].startswith("plain q=0.5 holds at 1/48")


def test_a_codec_without_runs_that_can_be_judged_has_the_reason() -> None:
    unknown = [*tracked("plain", 0.5, [1.0] * 5)[1:], *tracked("raw", 24.0, [1.0] * 5)]
    assert sentences(answers(run_of(*unknown)))["plain"] == "plain: no rate is known of q=0.5."


def test_without_a_task_codecs_are_compared_by_quality_and_that_is_said(rng: np.random.Generator) -> None:
    cells = [*scored("plain", 1.0, rng), *scored("good", 0.5, rng), *scored("bad", 2.0, rng)]
    raw = cell_result("raw", 24.0, "look", {("bits", ""): [24.0] * 64, ("score", ""): [np.inf] * 64}, count=64)
    found = answers(run_of(raw, *cells))
    assert found.basis == (
        "Judged by score alone, as no task was measured, s, 64 frames; "
        "better and worse are significant at 99 % confidence."
    )
    said = sentences(found)
    assert list(said) == ["good", "plain", "bad"]
    assert said["good"].startswith("good: better than plain, bad; 50.2 % ± 0.4 less rate than plain; ")
    assert said["good"].endswith("24.0 to 36.0 dB at 1/96 to 1/24 of raw's rate.".replace(".0", ""))
    assert said["plain"].startswith("plain: better than bad; worse than good; ")
    assert said["bad"].startswith("bad: worse than good, plain; 99 % ± 1 more rate than plain; ")


def test_the_rate_for_the_same_is_said_also_where_there_is_no_common_rate(rng: np.random.Generator) -> None:
    """One codec reaches the scores of another at rates that this one never has."""
    far = scored("far", 0.1, rng, rates=(0.03, 0.06, 0.12))
    between = scored("between", 0.5, rng, rates=(0.06, 0.12, 0.25, 0.5))
    said = sentences(answers(run_of(*scored("plain", 1.0, rng), *between, *far)))["far"]
    assert "better than between, plain; 89.93 % ± 0.06 less rate than plain; " in said


def test_a_sequence_too_short_makes_sequences_the_samples_and_each_is_spoken_of(rng: np.random.Generator) -> None:
    """Two sequences are two samples, which tell nobody apart; on the long one the better codec is known."""
    long = [*scored("plain", 1.0, rng), *scored("good", 0.5, rng)]
    short = [*scored("plain", 1.0, rng, sequence="few", count=6), *scored("good", 0.6, rng, sequence="few", count=6)]
    found = answers(run_of(*long, *short))
    assert found.basis.endswith(
        "at 99 % confidence. The sequences are the samples, as few has too few frames for an error of its own."
    )
    assert sentences(found)["good"].startswith(
        "good: better than all others on s alone; not significantly different from plain; "
    )
    assert sentences(found)["plain"].startswith("plain: not significantly different from good; ")


def test_codecs_that_are_the_same_are_not_told_apart(rng: np.random.Generator) -> None:
    found = answers(run_of(*scored("plain", 1.0, rng), *scored("twin", 1.0, rng)))
    assert "not significantly different from twin" in sentences(found)["plain"]
    assert sentences(found)["twin"] == "twin: not significantly different from plain; 18 to 30 dB at 0.25 to 1 bpp."


def test_a_codec_alone_is_described_and_compared_with_nothing(rng: np.random.Generator) -> None:
    said = sentences(answers(run_of(*scored("plain", 1.0, rng))))
    assert said["plain"].startswith("plain: nothing to compare it with; ")
    assert said["plain"].endswith("at 0.25 to 1 bpp.")


def test_without_a_rate_or_anything_to_judge_by_nothing_is_claimed() -> None:
    assert answers(run_of(cell_result("plain", 1.0, "look", own={("score", ""): [30.0]}))).answers == ()
    spent = answers(run_of(cell_result("plain", 1.0, "look", own={("bits", ""): [1.0]})))
    assert spent.answers == ()
    assert spent.basis == "Neither a task nor quality was measured, so that codecs cannot be judged."


@pytest.mark.parametrize(
    ("own", "metric"),
    [({"score": 1.0, "drift": 1.0, "held": 1.0}, "drift"), ({"score": 1.0, "blur": 1.0}, "score"), ({}, None)],
)
def test_the_column_that_is_judged_is_a_task_before_quality(own: dict[str, float], metric: str | None) -> None:
    values = {(name, ""): [value] for name, value in own.items()} | {("bits", ""): [1.0]}
    found = judged_column(run_of(cell_result("plain", 1.0, "look", own=values)))
    assert (found and found.metric.name) == metric
