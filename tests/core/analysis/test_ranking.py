"""Rankings of codecs whose order is known, and of codecs that have none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from measured_runs import DRIFT, cell_result, run_of
from scipy.signal import lfilter

from codecbench.core.analysis.curve_values import SMALLEST
from codecbench.core.analysis.evidence import Evidence, student_quantile
from codecbench.core.analysis.ranking import Gap, Ranked, Ranking, _significance, holm, rankings
from codecbench.core.analysis.run_result import RunResult
from codecbench.core.analysis.table import CellResult

RATES = (0.25, 0.5, 1.0, 2.0)
STARTS = 12
Errors = Callable[[float], np.ndarray]


def sized(codec: str, rate: float, sequence: str = "s") -> CellResult:
    return cell_result(codec, rate, "size", own={("bits", ""): [rate]}, sequence_name=sequence)


def starts(codec: str, errors: Errors, rates: tuple[float, ...] = RATES, sequence: str = "s") -> list[CellResult]:
    """Cells of a codec whose runs from each start have such errors at a rate; a NaN is a run that failed."""
    results = []
    for rate in rates:
        results.append(sized(codec, rate, sequence))
        for repeat, error in enumerate(errors(rate)):
            lost = bool(np.isnan(error))
            own = None if lost else {("drift", ""): [float(error)]}
            status = "crashed" if lost else "ok"
            results.append(
                cell_result(codec, rate, "track", own=own, repeat=repeat, sequence_name=sequence, status=status)
            )
    return results


def frames(codec: str, errors: Errors, count: int, sequence: str = "s") -> list[CellResult]:
    """Cells of a codec that has such errors of frames at a rate."""
    results = []
    for rate in RATES:
        size = {("bits", ""): [rate] * count}
        results.append(cell_result(codec, rate, "size", size, sequence_name=sequence, count=count))
        values = {("drift", ""): errors(rate).tolist()}
        results.append(cell_result(codec, rate, "track", values, sequence_name=sequence, count=count))
    return results


def falling(factor: float, rng: np.random.Generator, spread: float = 0.1, count: int = STARTS) -> Errors:
    """Errors that fall with the rate, times a factor and noise."""
    return lambda rate: factor / rate * np.exp(rng.normal(0.0, spread, count))


def only(run: RunResult) -> Ranking:
    (found,) = rankings(run)
    return found


def places(ranking: Ranking) -> dict[str, tuple[int, int]]:
    return {ranked.curve: (ranked.first, ranked.last) for ranked in ranking.ranked}


def row(ranking: Ranking, curve: str) -> Ranked:
    return next(ranked for ranked in ranking.ranked if ranked.curve == curve)


def test_holm_is_the_textbook_s() -> None:
    """Four p-values times 4, 3, 2, 1 in order, and never less than one before."""
    found = holm(np.array([0.01, 0.04, 0.03, 0.005]))
    np.testing.assert_allclose(found, [0.03, 0.06, 0.06, 0.02])
    np.testing.assert_allclose(holm(np.array([0.6, np.nan, 0.7])), [1.0, np.nan, 1.0])


def test_codecs_that_differ_are_in_order(rng: np.random.Generator) -> None:
    cells = [cell for name, factor in (("plain", 1.0), ("good", 0.5), ("bad", 2.0)) for cell in
             starts(name, falling(factor, rng))]  # fmt: skip
    found = only(run_of(*cells))
    assert places(found) == {"good": (1, 1), "plain": (2, 2), "bad": (3, 3)}
    assert [ranked.curve for ranked in found.ranked] == ["good", "plain", "bad"]
    assert row(found, "good").ahead_of == ("plain", "bad")
    assert (found.anchors, found.units, found.of) == (("plain",), STARTS, ("repeats",))
    assert (found.recommended.curve, found.as_good) == ("good", ())
    assert row(found, "good").settings == {"s": ("q=0.25", "q=0.5", "q=1.0", "q=2.0")}
    evidence = found.evidence("good", "plain")
    assert evidence is not None
    assert evidence.mean == pytest.approx(np.log(2.0), abs=0.16)


def test_a_codec_in_between_may_be_the_best_and_the_worst(rng: np.random.Generator) -> None:
    shared = rng.normal(0.0, 0.1, STARTS)
    wobble = rng.normal(0.0, 1.0, STARTS)
    cells = starts("plain", lambda rate: np.exp(shared) / rate)
    cells += starts("better", lambda rate: 0.7 * np.exp(shared + 0.01 * wobble) / rate)
    cells += starts("between", lambda rate: 0.84 * np.exp(shared + wobble) / rate)
    found = only(run_of(*cells))
    assert row(found, "better").ahead_of == ("plain",)
    assert {found.recommended.curve, *found.as_good} == {"better", "between"}
    assert places(found) == {"better": (1, 2), "between": (1, 3), "plain": (2, 3)}


def test_rows_are_in_order_of_the_rate_that_they_show(rng: np.random.Generator) -> None:
    """Without a common rate with the anchor, the score stands in its place; at a rate the value decides."""
    cells = [cell for name, factor in (("plain", 1.0), ("alias", 1.0), ("late", 0.4)) for cell in
             starts(name, falling(factor, rng, 0.3))]  # fmt: skip
    cells += starts("costly", falling(30.0, rng), rates=(2.0, 32.0, 64.0))
    cells += starts("aside", falling(1.0, rng), rates=(32.0, 64.0, 128.0))
    run = run_of(*cells)
    found = only(run)
    beside = [found.evidence(ranked.curve, "plain") for ranked in found.ranked]
    shown = [evidence.mean for evidence in beside if evidence is not None]
    assert len(shown) == 3
    assert shown == sorted(shown, reverse=True)
    assert sorted(found.without_common_rate("aside")) == ["alias", "late", "plain"]
    assert found.without_common_rate("costly") == ()
    assert max(found.ranked, key=lambda ranked: ranked.score).curve == found.recommended.curve
    values = [ranked.value for ranked in rankings(run, at=1.0)[0].ranked]
    assert values == sorted(values, key=float), "an error is best first"


def ranking_of(rows: list[tuple[str, str, float, float]]) -> Ranking:
    """Of pairs with a difference and a two-sided p-value that it is no more than the smallest, known exactly."""
    names = list(dict.fromkeys(name for row in rows for name in row[:2]))
    pairs = []
    for first, second, mean, p_value in rows:
        error = (abs(mean) - SMALLEST) / student_quantile(1.0 - p_value / 2.0, 1e9)
        pairs.append((first, second, Evidence(mean, error**2, 1e9)))
    scores = np.arange(len(names), 0, -1)
    ranked = tuple(
        Ranked(name, 1, len(names), (), 0, 1, float(score), {}) for name, score in zip(names, scores, strict=True)
    )
    column = run_of(cell_result("a", 1.0, "track", own={("drift", ""): [1.0]})).columns["track.drift.median"]
    return Ranking(column, "s", 9, ("frames",), ranked, {}, ("s",), (), None, tuple(pairs), {})


@pytest.mark.parametrize(("p_value", "as_good"), [(0.0099, ("c",)), (0.0101, ("b", "c"))])
def test_a_codec_is_ruled_out_by_a_one_sided_test_at_its_share_of_the_level(
    p_value: float, as_good: tuple[str, ...]
) -> None:
    """Of three codecs each is compared with two: half of 1 % for each comparison, one-sided."""
    found = ranking_of([("a", "b", 0.3, p_value), ("a", "c", 0.3, 0.5), ("b", "c", 0.1, 0.5)])
    assert (found.recommended.curve, found.as_good) == ("a", as_good)


@pytest.mark.thorough
def test_the_best_of_equal_codecs_is_ruled_out_in_at_most_one_table_of_a_hundred(rng: np.random.Generator) -> None:
    """By both tests together; any of six equal codecs is a best one, and the first is watched."""
    names, ruled_out = "abcdef", 0
    for _ in range(2000):
        means = rng.normal(0.0, 0.3, 6)
        evidence = {(i, j): Evidence(float(means[i] - means[j]), 0.18, 1e9) for i, j in combinations(range(6), 2)}
        better = _significance(6, evidence)[0]
        found = ranking_of([(names[i], names[j], 0.3, 0.5) for i, j in evidence])
        ranked = tuple(replace(each, first=1 + int(better[:, place].sum())) for place, each in enumerate(found.ranked))
        pairs = tuple((names[i], names[j], each) for (i, j), each in evidence.items())
        candidates = replace(found, ranked=ranked, pairs=pairs).candidates
        ruled_out += "a" not in [each.curve for each in candidates]
    assert 2 <= ruled_out <= 30, "1 % of 2,000 are 20, known to 4.5"


def test_a_bound_counts_in_scores_only_where_nothing_else_is_known() -> None:
    """The first is known to take a tenth less rate than the second; bounds beside a third say something else."""
    pairs = {
        (0, 1): Evidence(0.1, 0.01, 9.0),
        (0, 2): Evidence(0.5, 0.01, 9.0, at_least=True),
        (1, 2): Evidence(2.0, 0.01, 9.0, at_least=True),
    }
    scores = _significance(3, pairs)[1]
    assert scores[0] - scores[1] == pytest.approx(0.1, abs=1e-4)
    assert 0.5 < scores[0] - scores[2] < 2.1


def test_in_a_circle_the_highest_score_is_taken() -> None:
    found = ranking_of([("a", "b", 0.3, 1e-6), ("b", "c", 0.3, 1e-6), ("a", "c", -0.3, 1e-6)])
    assert (found.recommended.curve, found.as_good) == ("a", ())


@pytest.mark.parametrize(
    "trial", [0, 1, 2, *(pytest.param(trial, marks=pytest.mark.thorough) for trial in range(3, 20))]
)
def test_equal_codecs_under_other_names_are_never_ordered(trial: int) -> None:
    """Runs that differ by chance alone, as from another machine."""
    rng = np.random.default_rng(trial)
    names = ("plain", "alias", "copy", "double", "echo", "twin")
    cells = [cell for name in names for cell in starts(name, falling(1.0, rng, 0.5))]
    found = only(run_of(*cells))
    assert set(places(found).values()) == {(1, 6)}
    assert len(found.as_good) == 5


def test_the_same_numbers_under_other_names_are_one_group(rng: np.random.Generator) -> None:
    errors = {rate: 1 / rate * np.exp(rng.normal(0.0, 0.5, STARTS)) for rate in RATES}
    cells = [cell for name in ("plain", "alias", "copy") for cell in starts(name, errors.__getitem__)]
    assert set(places(only(run_of(*cells))).values()) == {(1, 3)}


@pytest.mark.thorough
def test_neighbouring_frames_are_no_independent_evidence() -> None:
    """Equal codecs whose errors drift from frame to frame, with a correlation of 0.9, over 400 frames.

    A table orders two of them in 1 % of all cases, so that one of 20 may.
    """
    ordered = 0
    for trial in range(20):
        rng = np.random.default_rng(100 + trial)

        def drifting(rate: float, rng: np.random.Generator = rng) -> np.ndarray:
            path = lfilter([1.0], [1.0, -0.9], rng.normal(0.0, 1.0, 400))
            return np.asarray(np.exp(0.2 * path) / rate)

        cells = [cell for name in ("plain", "alias", "copy") for cell in frames(name, drifting, 400)]
        found = only(run_of(*cells))
        assert (found.units, found.of) == (400, ("frames",))
        ordered += set(places(found).values()) != {(1, 3)}
    assert ordered <= 1


def test_frames_tell_a_small_difference_that_is_always_there(rng: np.random.Generator) -> None:
    shared = {rate: np.exp(rng.normal(0.0, 1.0, 144)) / rate for rate in RATES}
    cells = frames("plain", shared.__getitem__, 144)
    cells += frames("mine", lambda rate: 0.98 * shared[rate] * np.exp(rng.normal(0.0, 0.02, 144)), 144)
    assert places(only(run_of(*cells))) == {"mine": (1, 1), "plain": (2, 2)}


def test_few_starts_that_scatter_order_nobody(rng: np.random.Generator) -> None:
    cells = starts("plain", falling(1.0, rng, 0.5, count=3)) + starts("mine", falling(0.7, rng, 0.5, count=3))
    assert set(places(only(run_of(*cells))).values()) == {(1, 2)}


def test_one_run_each_orders_nobody(rng: np.random.Generator) -> None:
    cells = starts("plain", falling(1.0, rng, count=1)) + starts("mine", falling(0.1, rng, count=1))
    assert set(places(only(run_of(*cells))).values()) == {(1, 2)}


def test_a_codec_that_loses_runs_does_not_win_by_the_rest(rng: np.random.Generator) -> None:
    """Of the runs that it finishes the errors are half the other's."""
    lost = np.where(np.arange(STARTS) % 2 == 0, np.nan, 1.0)
    cells = starts("plain", falling(1.0, rng)) + starts("mine", lambda rate: 0.5 / rate * lost)
    found = only(run_of(*cells))
    assert row(found, "mine").ahead_of == ()
    assert (row(found, "mine").missing, row(found, "mine").values) == (STARTS // 2 * 4, STARTS * 4)
    assert row(found, "plain").score > row(found, "mine").score
    assert found.recommended.curve == "plain"


def test_a_codec_that_gives_nothing_is_last(rng: np.random.Generator) -> None:
    cells = starts("plain", falling(1.0, rng)) + starts("none", lambda rate: np.full(STARTS, np.nan))
    found = only(run_of(*cells))
    assert places(found) == {"plain": (1, 1), "none": (2, 2)}


def test_frames_that_nobody_has_count_for_nobody(rng: np.random.Generator) -> None:
    gap = np.where(np.arange(144) < 44, np.nan, 1.0)
    cells = frames("plain", lambda rate: gap / rate, 144) + frames("mine", lambda rate: gap * 0.9 / rate, 144)
    found = only(run_of(*cells))
    assert found.units == 100
    assert all(ranked.missing == 0 for ranked in found.ranked)


def test_codecs_at_other_rates_have_no_place_and_a_reason(rng: np.random.Generator) -> None:
    cells = starts("plain", falling(1.0, rng)) + starts("mine", falling(0.5, rng))
    cells += starts("vast", falling(0.1, rng), rates=(20.0, 30.0)) + starts("raw", falling(0.1, rng), rates=(24.0,))
    found = only(run_of(*cells))
    assert set(places(found)) == {"plain", "mine"}
    assert list(found.left_out) == ["vast"]
    assert found.left_out["vast"].endswith("at its rates")


def test_single_settings_at_one_rate_are_compared_directly(rng: np.random.Generator) -> None:
    cells = starts("plain", falling(1.0, rng), rates=(1.0,)) + starts("mine", falling(0.5, rng), rates=(0.95,))
    assert places(only(run_of(*cells))) == {"mine": (1, 1), "plain": (2, 2)}


def test_a_codec_of_unknown_rate_is_not_ranked(rng: np.random.Generator) -> None:
    cells = starts("plain", falling(1.0, rng)) + starts("mine", falling(0.5, rng)) + starts("free", falling(0.1, rng))
    unknown = [cell for cell in cells if not (cell.cell.codec.name == "free" and cell.cell.evaluator.name == "size")]
    found = only(run_of(*unknown))
    assert set(places(found)) == {"plain", "mine"}
    assert list(found.left_out) == ["free"]
    assert found.left_out["free"].endswith(": q=0.25, q=0.5, q=1.0, q=2.0")


def test_sequences_together_come_first_and_tell_more_than_each(rng: np.random.Generator) -> None:
    cells = []
    for sequence in ("one", "two", "three", "four", "five", "six"):
        cells += starts("plain", falling(1.0, rng, 0.3, count=4), sequence=sequence)
        cells += starts("mine", falling(0.7, rng, 0.3, count=4), sequence=sequence)
    together, *each = rankings(run_of(*cells))
    assert (together.sequence, [ranking.sequence for ranking in each]) == (
        "",
        ["one", "two", "three", "four", "five", "six"],
    )
    assert places(together) == {"mine": (1, 1), "plain": (2, 2)}
    assert together.units == 24
    assert all(together.pairs[0][2].p_value < ranking.pairs[0][2].p_value for ranking in each)
    means = [ranking.pairs[0][2].mean for ranking in each]
    assert together.pairs[0][2].mean == pytest.approx(np.mean(means)), "the geometric mean of factors in rate"
    assert rankings(run_of(*cells), brief=True) == [together]


def test_a_codec_that_is_not_on_every_sequence_is_named(rng: np.random.Generator) -> None:
    cells = []
    for sequence in ("one", "two"):
        cells += starts("plain", falling(1.0, rng), sequence=sequence) + starts(
            "mine", falling(1, rng), sequence=sequence
        )
    cells += starts("gray", falling(0.5, rng), sequence="one")
    cells.append(cell_result("gray", 1.0, "track", sequence_name="two", status="unsupported", reason="color only"))
    together = rankings(run_of(*cells), brief=True)[0]
    assert together.left_out == {"gray": "unsupported: color only"}


def test_what_has_not_been_run_yet_is_not_held_against_anybody(rng: np.random.Generator) -> None:
    """The last codec has three starts of twelve so far, and nothing on the other sequence."""
    cells = starts("plain", falling(1.0, rng)) + starts("mine", falling(0.5, rng))
    cells += starts("late", falling(0.5, rng, count=3))
    found = only(run_of(*cells))
    assert found.units == 3
    assert all(ranked.missing == 0 for ranked in found.ranked)
    cells += starts("plain", falling(1.0, rng), sequence="t") + starts("mine", falling(0.5, rng), sequence="t")
    assert rankings(run_of(*cells), brief=True)[0].left_out["late"].endswith("yet on t")


def test_an_error_of_nothing_is_as_good_as_the_best(rng: np.random.Generator) -> None:
    cells = starts("plain", falling(1.0, rng)) + starts("zero", lambda rate: np.zeros(STARTS))
    with np.errstate(all="raise"):
        assert places(only(run_of(*cells))) == {"zero": (1, 1), "plain": (2, 2)}
        assert places(rankings(run_of(*cells), at=0.6)[0]) == {"zero": (1, 1), "plain": (2, 2)}


def test_without_a_rate_there_is_no_ranking(rng: np.random.Generator) -> None:
    cells = starts("plain", falling(1.0, rng)) + starts("mine", falling(0.5, rng))
    assert rankings(run_of(*(cell for cell in cells if cell.cell.evaluator.name == "track"))) == []
    assert DRIFT.role == "task"


def test_at_one_rate_codecs_are_compared_there_alone(rng: np.random.Generator) -> None:
    """Two curves that cross: which is ahead depends on the rate, and the value is the one between two settings."""

    def power(exponent: float) -> Errors:
        return lambda rate: rate**-exponent * np.exp(rng.normal(0.0, 0.02, STARTS))

    far = starts("far", falling(1.0, rng), rates=(8.0, 16.0))
    run = run_of(*starts("steep", power(2.0)), *starts("flat", power(0.5)), *far)
    low, high = (rankings(run, at=rate)[0] for rate in (0.35, 1.4))
    assert places(low) == {"flat": (1, 1), "steep": (2, 2)}
    assert places(high) == {"steep": (1, 1), "flat": (2, 2)}
    assert row(low, "flat").value == pytest.approx(0.35**-0.5, rel=0.03)
    assert row(low, "steep").value == pytest.approx(0.35**-2, rel=0.03)
    assert row(low, "flat").settings == {"s": ("q=0.25", "q=0.5")}
    assert row(rankings(run, at=1.04)[0], "flat").settings == {"s": ("q=1.0",)}
    assert list(low.left_out) == ["far"]
    assert low.left_out["far"].endswith("this rate on s")
    assert rankings(run, at=0.24) == [], "at a rate means at the rate"


def test_the_order_on_a_sequence_agrees_with_that_of_the_others(rng: np.random.Generator) -> None:
    factors = {"plain": 1.0, "good": 0.5, "bad": 2.0}
    turned = {"plain": 1.0, "good": 2.0, "bad": 0.5}
    cells = [
        cell
        for sequence, of_codecs in (("s", factors), ("t", factors), ("v", factors), ("u", turned))
        for name, factor in of_codecs.items()
        for cell in starts(name, falling(factor, rng, 0.01), sequence=sequence)
    ]
    together, *each = rankings(run_of(*cells))
    assert together.rank_correlation["u"] == pytest.approx(-1.0)
    assert [together.rank_correlation[name] for name in "stv"] == pytest.approx([1.0, 1.0, 1.0])
    assert all(ranking.rank_correlation == {} for ranking in each)


def test_rank_agreement_is_only_that_of_significant_orders(rng: np.random.Generator) -> None:
    """On one of three sequences the codecs differ by chance alone."""
    cells = [
        cell
        for sequence, gain, spread in (("s", 0.5, 0.01), ("t", 0.5, 0.01), ("v", 1.0, 0.1))
        for name, factor in (("plain", 1.0), ("good", gain))
        for cell in starts(name, falling(factor, rng, spread), sequence=sequence)
    ]
    assert rankings(run_of(*cells))[0].rank_correlation == pytest.approx({"s": 1.0, "t": 1.0})
    assert rankings(run_of(*(cell for cell in cells if cell.cell.sequence.name != "t")))[0].rank_correlation == {}


def test_sequences_that_disagree_and_the_widest_gap_are_named() -> None:
    """What one saves on a sequence the other saves on another; of its settings two are far apart in quality."""
    bent = {0.25: 1.0, 0.5: 2.0, 1.0: 9.0, 2.0: 10.0}
    rng = np.random.default_rng(3)
    cells = []
    for sequence, factor in (("s", 0.5), ("t", 2.0)):
        cells += starts("plain", falling(1.0, rng, 0.01), sequence=sequence)
        cells += starts("mine", falling(factor, rng, 0.01), sequence=sequence)
    together = rankings(run_of(*cells))[0]
    assert together.disputed == (("plain", "mine"),)
    cells = starts("plain", falling(1.0, rng, 0.01), rates=(0.25, 0.5, 0.75, 1.0, 1.5, 2.0))
    cells += starts("mine", lambda rate: 4.8 / bent[rate] * np.exp(rng.normal(0.0, 0.01, STARTS)))
    found = only(run_of(*cells))
    assert found.disputed == ()
    assert found.gaps == {("plain", "mine"): Gap("mine", ("q=0.5", "q=1.0"))}
