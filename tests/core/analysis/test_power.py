"""What a run could decide: differences of known size are found as often as is said, and no more runs than that tell."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from measured_runs import cell_result, run_of
from scipy.stats import binom, ttest_1samp

from codecbench.core.analysis.curve_values import SMALLEST
from codecbench.core.analysis.evidence import Evidence, evidence_of_repeats
from codecbench.core.analysis.passing import Standing
from codecbench.core.analysis.power import LimitPower, Remedy, pair_powers, scale_evidence, smallest_difference
from codecbench.core.analysis.ranking import Gap
from codecbench.core.analysis.run_result import RunResult
from codecbench.core.analysis.table import CellResult
from codecbench.core.report.formatting import power_verdicts, remedy_words

RATES = (0.25, 0.5, 1.0)


def cells(codec: str, errors: list[np.ndarray]) -> list[CellResult]:
    """Cells of a codec with the errors of its repeats at each rate."""
    found = []
    for rate, of_rate in zip(RATES, errors, strict=True):
        found.append(cell_result(codec, rate, "size", own={("bits", ""): [rate]}))
        for repeat, error in enumerate(of_rate):
            found.append(cell_result(codec, rate, "track", own={("drift", ""): [float(error)]}, repeat=repeat))
    return found


def run_with(better_by: float, spread: float, count: int, rng: np.random.Generator) -> RunResult:
    """Two codecs, of which b has so much less error (in base-10 logarithms) with a scatter over repeats."""
    noise = rng.normal(0.0, spread, count)
    first = [np.full(count, 1.0 / rate) for rate in RATES]
    second = [np.full(count, 1.0 / rate) * 10.0 ** (noise - better_by) for rate in RATES]
    return run_of(*cells("a", first), *cells("b", second))


@pytest.mark.parametrize(("count", "level", "power"), [(8, 0.05, 0.8), (12, 0.01, 0.8), (40, 0.01, 0.5)])
def test_the_smallest_difference_is_found_as_often_as_is_said(
    count: int, level: float, power: float, rng: np.random.Generator
) -> None:
    samples = rng.normal(0.0, 1.0, (4000, count))
    smallest = smallest_difference(Evidence(0.0, 1.0 / count, count - 1), level, power)
    found = float(np.mean(ttest_1samp(samples + smallest, 0.0, axis=1).pvalue < level))
    assert found == pytest.approx(power, abs=0.05)


def test_more_of_the_same_is_what_is_said_of_it(rng: np.random.Generator) -> None:
    values = rng.normal(1.0, 2.0, 20)
    more = scale_evidence(evidence_of_repeats(values), 3.0)
    assert more.freedom == 59
    assert more.variance == pytest.approx(np.var(values, ddof=1) / 60)


def test_a_clear_difference_stands_and_a_small_one_says_what_would_tell(rng: np.random.Generator) -> None:
    (clear,) = pair_powers(run_with(0.3, 0.05, 12, rng))
    assert clear.stands
    assert clear.more_units == 0
    assert abs(clear.difference) == pytest.approx(0.3 * np.log(10), rel=0.15), "the rate that takes is as much more"
    assert clear.difference < 0, "the second is better"
    (small,) = pair_powers(run_with(0.02, 0.1, 12, rng))
    assert not small.stands
    assert small.smallest > abs(small.difference)
    more = small.more_units
    assert more is not None
    assert more > 0
    enough = scale_evidence(small.evidence, (12 + more) / 12)
    least = SMALLEST + small.evidence.doubt
    assert least + smallest_difference(enough, small.level, 0.8) <= abs(small.difference) * 1.0001
    short = scale_evidence(small.evidence, (12 + more - 1) / 12)
    assert least + smallest_difference(short, small.level, 0.8) > abs(small.difference)


EVEN = [np.full(5, 1.0 / rate) for rate in RATES]


def test_equal_codecs_differ_by_nothing_that_any_number_of_runs_would_show() -> None:
    (pair,) = pair_powers(run_of(*cells("a", EVEN), *cells("b", EVEN)))
    assert (pair.difference, pair.stands, pair.more_units) == (0.0, False, None)
    assert pair.remedy == Remedy("equal")
    assert math.isnan(pair.smallest)


def test_levels_are_shared_among_pairs(rng: np.random.Generator) -> None:
    members = [cell for name in "abc" for cell in cells(name, [rng.lognormal(0, 0.2, 9) / rate for rate in RATES])]
    pairs = pair_powers(run_of(*members))
    assert len(pairs) == 3
    assert {pair.level for pair in pairs} == {0.01 / 3}
    assert all(0.0 < pair.p_value <= 1.0 for pair in pairs)


ONE = 0.01  # about the smallest difference worth knowing, as the log of a rate
GAP = Gap("a", ("q=30", "q=55"))


@pytest.mark.parametrize(
    ("mean", "error", "doubt", "given", "kind", "words"),
    [
        (0.3, 0.01, 0.0, {}, "decided", "–"),
        (0.1 * ONE, 0.1 * ONE, 0.0, {}, "equal", "nothing"),
        (0.5 * ONE, 0.9 * ONE, 0.0, {}, "small", "less than 1 %"),
        (0.1, 0.01, 0.2, {"gap": GAP}, "settings", "settings of a between q 30 and 55"),
        (0.4, 0.3, 0.3, {"gap": GAP}, "settings", "between q 30 and 55"),
        (0.4, 0.1, 0.2, {"gap": GAP}, "samples", "about 220 more frames"),
        (0.1, 0.1, 0.0, {}, "samples", "about 1300 more frames"),
        (0.1, 0.1, 0.0, {"of": ("repeats",)}, "samples", "about 1300 more repeats"),
        (0.1, math.nan, 0.0, {"units": 6}, "samples", "about 2 more frames"),
        (0.1, math.nan, 0.0, {"of": ("sequences",)}, "samples", "more sequences"),
        (0.02, 0.1, 0.0, {}, "beyond", "hundred times the frames"),
        (0.02, 0.1, 0.0, {"disputed": True}, "sequences", "because these disagree"),
    ],
)
def test_what_would_decide_is_one_thing(
    mean: float, error: float, doubt: float, given: dict[str, Any], kind: str, words: str
) -> None:
    """At 1 % a difference beyond 1 % shows in four of five cases from 3.42 errors: 0.1 takes 100 (0.342 / 0.09)^2."""
    evidence = Evidence(mean, error**2, 1e6, doubt)
    (values,) = pair_powers(run_of(*cells("a", EVEN), *cells("b", EVEN)))
    pair = replace(values, **{"evidence": evidence, "p_value": evidence.p_beyond(SMALLEST), "level": 0.01,
                              "units": 100, "of": ("frames",), **given})  # fmt: skip
    assert pair.remedy.kind == kind
    assert words in remedy_words(pair)


@pytest.mark.parametrize("runs", [4, 5, 10, 30])
def test_the_detectable_rate_is_detected_with_the_power(runs: int) -> None:
    limit = LimitPower((), "s", "jpeg", Standing("q", 1.0, 0, runs), 0.8)
    found = sum(
        binom.pmf(successes, runs, limit.detectable_rate)
        for successes in range(runs + 1)
        if Standing("", 1.0, successes, runs).verdict == "passes"
    )
    assert found == pytest.approx(0.8, abs=1e-6)


def test_three_runs_decide_nothing() -> None:
    limit = LimitPower((), "s", "jpeg", Standing("q", 1.0, 3, 3), 0.8)
    assert math.isnan(limit.detectable_rate)
    assert limit.more_runs == 1


def test_tables_say_it(rng: np.random.Generator) -> None:
    (verdict,) = power_verdicts(run_with(0.3, 0.05, 12, rng))
    assert verdict.title.startswith("s: drift, 12 repeats")
    assert "80 %" in verdict.title
    ((codecs, difference, smallest, says, more),) = verdict.rows
    assert (codecs, says, more) == ("a vs. b", "b is significantly better", "–")
    assert 80 < float(difference.partition(" % ± ")[0]) < 120, "a takes twice the rate"
    assert 1 < float(smallest.removesuffix(" %")) < 25
    assert verdict.sentences[0].startswith("1 of 1")
    assert "significant at 0.01" in verdict.sentences[0]
