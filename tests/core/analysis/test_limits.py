"""Where a sweep ends, by counts whose intervals are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats
from measured_runs import METRICS, cell_result, run_of
from told import numbers

from codecbench.core.analysis.evidence import Evidence
from codecbench.core.analysis.limits import Limit, joint_values, limits, limits_of
from codecbench.core.analysis.passing import Joint, Level, Standing, Test
from codecbench.core.analysis.run_result import Column, CurvePoint
from codecbench.core.analysis.table import CellResult
from codecbench.core.contracts.metric import Metric
from codecbench.core.engine.planning.model import PluginSetting


def sweep(**held: tuple[int, int]) -> Limit:
    """The limit of a codec of whose settings, from the most rate to the least, so many of so many runs succeeded."""
    standings = [Standing(name, float(len(held) - place), *runs) for place, (name, runs) in enumerate(held.items())]
    return limit_of(*standings)


def limit_of(*tests: Test) -> Limit:
    """The limit of a codec on a sequence by the tests of its settings."""
    rows = {("s", "mine", test.point): test for test in tests}
    return limits_of(rows, {row[1:]: CurvePoint("mine", row[2]) for row in rows})["s", "mine"]


@pytest.mark.parametrize(
    ("successes", "runs", "verdict", "low"),
    [
        # (p + z^2/2n - z sqrt(p(1-p)/n + z^2/4n^2)) / (1 + z^2/n) with z = 1.96
        (5, 5, "passes", 0.5655), (4, 4, "passes", 0.5101), (3, 3, "inconclusive", 0.4385),
        (2, 3, "inconclusive", 0.2077), (9, 10, "passes", 0.5958),
        (5, 10, "inconclusive", 0.2366),
        (0, 3, "inconclusive", 0.0), (0, 4, "fails", 0.0),
    ],
)  # fmt: skip
def test_a_setting_passes_if_the_interval_lies_above_one_half(
    successes: int, runs: int, verdict: str, low: float
) -> None:
    standing = Standing("q=1", 1.0, successes, runs)
    assert standing.verdict == verdict
    assert standing.interval[0] == pytest.approx(low, abs=1e-4)


@pytest.mark.parametrize(
    ("successes", "runs", "more"), [(3, 3, 1), (0, 3, 1), (1, 1, 3), (4, 5, 3), (1, 5, 3), (5, 5, 0)]
)
def test_more_runs_is_the_smallest_number_that_decides(successes: int, runs: int, more: int) -> None:
    standing = Standing("", 1.0, successes, runs)
    assert standing.more_runs == more
    many = more * (2 * successes >= runs)
    assert Standing("", 1.0, successes + many, runs + more).verdict != "inconclusive"
    if more:
        fewer = (more - 1) * (2 * successes >= runs)
        assert Standing("", 1.0, successes + fewer, runs + more - 1).verdict == "inconclusive"


def test_the_limit_is_the_last_setting_before_the_first_that_fails() -> None:
    limit = sweep(q9=(5, 5), q7=(5, 5), q5=(0, 5))
    assert limit.lowest == Standing("q7", 2.0, 5, 5)
    assert limit.next == Standing("q5", 1.0, 0, 5)
    assert limit.out_of_order == ()
    assert numbers(str(limit.lowest)) == [5.0, 5.0, 57.0, 95.0]
    assert limit.after_words().startswith("q5 fails")
    assert numbers(limit.after_words()) == [0.0, 5.0, 43.0, 95.0]


def test_a_limit_ends_where_the_sample_is_inconclusive() -> None:
    limit = sweep(q9=(5, 5), q7=(3, 5), q5=(5, 5))
    assert limit.lowest == Standing("q9", 3.0, 5, 5)
    assert limit.next == Standing("q7", 2.0, 3, 5)
    assert limit.after_words().startswith("q7 is inconclusive")
    assert numbers(limit.after_words())[:3] == [3.0, 5.0, 6.0]
    few = sweep(q9=(3, 3))
    assert few.lowest is None
    assert few.after_words().startswith("q9 is inconclusive")
    assert numbers(few.after_words()) == [3.0, 3.0, 1.0]


def test_a_setting_that_fails_between_two_that_hold_is_out_of_order() -> None:
    limit = sweep(q9=(5, 5), q7=(0, 5), q5=(5, 5), q3=(0, 5))
    assert limit.lowest is not None
    assert limit.lowest.point == "q9"
    assert [setting.point for setting in limit.out_of_order] == ["q7"]
    assert limit.after_words().startswith("q7 fails")
    assert "out of order: q5" in limit.after_words()


def test_a_codec_that_fails_at_its_best_has_no_limit() -> None:
    limit = sweep(q9=(0, 5), q7=(0, 5))
    assert limit.lowest is None
    assert limit.after_words().startswith("q9 fails")
    assert numbers(limit.after_words()) == [0.0, 5.0, 43.0, 95.0]


def test_a_sweep_that_never_fails_has_nothing_after_its_limit() -> None:
    limit = sweep(q9=(5, 5), q7=(9, 10))
    assert limit.next is None
    assert "nothing coarser" in limit.after_words()


def test_a_missing_value_is_a_run_without_success() -> None:
    held = [cell_result("plain", 1.0, "track", own={("held", ""): [value]}, repeat=repeat)
            for repeat, value in enumerate([1.0, 1.0, 1.0, 1.0, float("nan")])]  # fmt: skip
    raw = [cell_result("raw", 24.0, "track", own={("held", ""): [1.0]}, repeat=repeat) for repeat in range(5)]
    run = run_of(cell_result("plain", 1.0, "size", own={("bits", ""): [1.0]}), *held, *raw)
    limit = limits(run, [run.columns["track.held.mean"]])["s", "plain"]
    assert limit.settings == (Standing("q=1.0", 1.0, 4, 5),)


def test_a_limit_is_refused_where_a_rate_is_not_known() -> None:
    """Sorted by rates with a NaN among them, a sweep would say anything."""
    limit = limit_of(Standing("q", float("nan"), 1, 1))
    assert limit.reason.endswith("rate: q")
    assert limit.lowest is None
    assert limit_of(Standing("q", float("nan"), 0, 0, why="no map")).reason == "no map", "which no rate would mend"


def test_runs_succeed_that_succeed_in_every_column() -> None:
    raw = {("s", "raw", ""): {(2, 0): 1.0}}
    first = {("s", "mine", "q"): {(0, 0): 1.0, (1, 0): 1.0, (2, 0): 1.0}, **raw}
    second = {("s", "mine", "q"): {(0, 0): 1.0, (1, 0): 0.0}, **raw}
    assert joint_values([first, second])["s", "mine", "q"] == [1.0, 0.0, pytest.approx(float("nan"), nan_ok=True)]


def test_runs_of_which_nobody_can_be_judged_count_for_nobody() -> None:
    """As from a start from which the baseline fails too."""
    nan = float("nan")
    mine = {(0, 0): 1.0, (1, 0): nan, (2, 0): nan}
    raw = {(0, 0): 1.0, (1, 0): nan, (2, 0): 1.0}
    found = joint_values([{("s", "mine", "q"): mine, ("s", "raw", ""): raw}])
    assert found["s", "raw", ""] == [1.0, 1.0]
    assert found["s", "mine", "q"] == [1.0, pytest.approx(nan, nan_ok=True)]
    assert joint_values([{("s", "mine", "q"): {(0, 0): nan}}]) == {("s", "mine", "q"): []}
    assert limit_of(Standing("q", 1.0, 0, 0)).reason.endswith("cannot be judged here")


def test_a_run_that_crashed_did_not_succeed() -> None:
    """Also where there is no other codec to say that it could have been judged."""
    cells = [cell_result("plain", 1.0, "track", own={("held", ""): [1.0]}, repeat=repeat) for repeat in range(4)]
    cells.append(cell_result("plain", 1.0, "track", repeat=4, status="timed_out", reason="60 s"))
    run = run_of(cell_result("plain", 1.0, "size", own={("bits", ""): [1.0]}), *cells)
    (limit,) = limits(run, [run.columns["track.held.mean"]]).values()
    assert limit.settings == (Standing("q=1.0", 1.0, 4, 5),)


def test_limits_of_a_run_need_its_rate() -> None:
    rates = (0.5, 1.0)
    sizes = [cell_result("plain", rate, "size", own={("bits", ""): [rate]}) for rate in rates]
    held = [
        cell_result("plain", rate, "track", own={("held", ""): [float(rate > 0.5)]}, repeat=repeat)
        for rate in rates
        for repeat in range(5)
    ]
    run = run_of(*sizes, *held)
    (limit,) = limits(run, [run.columns["track.held.mean"]]).values()
    assert limit.settings == (Standing("q=1.0", 1.0, 5, 5), Standing("q=0.5", 0.5, 0, 5))
    (refused,) = limits(run_of(*held), [run.columns["track.held.mean"]]).values()
    assert refused.reason.startswith("no rate was measured")


def levels(values: dict[float, list[float]], raw: list[float], sequence: str = "s") -> list[CellResult]:
    """A codec of such rates and its drift in metres, once a repeat, beside that of the raw codec."""
    cells = []
    for codec, rate, drifts in [("raw", 24.0, raw), *(("plain", rate, own) for rate, own in values.items())]:
        cells.append(cell_result(codec, rate, "size", own={("bits", ""): [rate]}, sequence_name=sequence))
        cells += [cell_result(codec, rate, "track", own={("drift", ""): [drift]}, repeat=repeat, sequence_name=sequence)
                  for repeat, drift in enumerate(drifts)]  # fmt: skip
    return cells


def test_a_setting_passes_by_a_task_if_the_interval_of_its_mean_is_below_twice_the_raw_value() -> None:
    """The interval by scipy's t distribution of the mean."""
    drifts = {1.0: [1.0, 1.2, 1.1, 0.9], 0.5: [1.9, 2.3, 1.8, 2.1], 0.25: [4.0, 4.4, 3.9, 4.1]}
    run = run_of(*levels(drifts, [0.9, 1.1, 1.0, 1.0]))
    found = limits(run, [run.columns["track.drift.median"]])["s", "plain"]
    assert {test.point: test.verdict for test in found.settings} == {
        "q=1.0": "passes", "q=0.5": "inconclusive", "q=0.25": "fails",
    }  # fmt: skip
    for test, values in zip(found.settings, drifts.values(), strict=True):
        assert isinstance(test, Level)
        low, high = scipy.stats.t.interval(0.95, 3, np.mean(values), scipy.stats.sem(values))
        assert (test.value, test.bound) == pytest.approx((np.mean(values), 2.0))
        assert test.margin.reach(0.95) == pytest.approx((high - low) / 2.0)
    assert found.after_words() == "q=0.5 is inconclusive (2.02 m ± 0.35, ≤ 2 m required)"


def test_what_a_setting_did_not_measure_is_not_shown_beside_its_level(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(METRICS, "drift", replace(METRICS["drift"], shown_with="held"))
    cells = [cell_result(codec, 1.0, "size", own={("bits", ""): [1.0]}) for codec in ("raw", "plain", "other")]
    for codec in ("raw", "plain", "other"):
        held = {} if codec == "other" else {("held", ""): [1.0]}
        cells += [cell_result(codec, 1.0, "track", own={("drift", ""): [1.0], **held}, repeat=i) for i in range(4)]
    run = run_of(*cells)
    found = limits(run, [run.columns["track.drift.median"]])
    assert ["held" in str(found["s", codec].settings[0]) for codec in ("plain", "other")] == [True, False]


def test_a_setting_fails_over_all_sequences_that_fails_on_one() -> None:
    good, near, bad = [1.0, 1.2, 1.1, 0.9], [1.3, 1.2, 1.4, 1.2], [2.4, 2.6, 2.5, 2.5]
    cells = [*levels({1.0: good, 0.5: near}, good, "s"), *levels({1.0: good, 0.5: bad}, good, "t")]
    run = run_of(*cells, *levels({1.0: good, 0.5: near}, good, "u"))
    found = limits(run, [run.columns["track.drift.median"]])["", "plain"]
    assert [test.verdict for test in found.settings] == ["passes", "fails"]
    assert str(found.settings[1]) == "t 2.5 m ± 0.13, ≤ 2.1 m required"


def test_a_task_is_not_asked_for_where_raw_frames_are_no_better_than_the_coarsest() -> None:
    run = run_of(*levels({1.0: [1.0] * 4, 0.5: [2.0] * 4}, [9.0] * 4))
    found = limits(run, [run.columns["track.drift.median"]])["s", "plain"]
    assert found.reason.startswith("drift is uninformative on s: ")
    assert numbers(found.reason) == [9.0, 2.0]


@pytest.mark.parametrize(
    ("first", "second", "verdict", "told"),
    [
        ((5, 5), (5, 5), "passes", ("runs", "others")),
        ((5, 5), (0, 5), "fails", ("others",)),
        ((2, 2), (5, 5), "inconclusive", ("runs",)),
    ],
)
def test_a_setting_has_to_pass_every_test(
    first: tuple[int, int], second: tuple[int, int], verdict: str, told: tuple[str, ...]
) -> None:
    """Of those that it does not pass, or of all that it does, the standing is told."""
    standings = {"runs": Standing("q", 1.0, *first), "others": Standing("q", 1.0, *second)}
    joint = Joint(standings)
    assert (joint.verdict, str(joint)) == (verdict, "; ".join(f"{name} {standings[name]}" for name in told))


def test_a_level_that_people_see_with_the_other_sign_asks_for_the_other_side() -> None:
    """95 % saved, of which 90 % are asked, is shown as a size of -95 %, at most -90 %."""
    metric = Metric("saved", "percent", "higher", "", display_unit="%", display_factor=-1.0, enough=90.0)
    column = Column(PluginSetting("evaluator", "size", "1"), metric, "", "mean")
    level = Level("q", 1.0, column, 95.0, 90.0, Evidence(5.0, 0.25, 3.0))
    assert level.verdict == "passes"
    assert level.reach == pytest.approx(0.5 * scipy.stats.t.ppf(0.975, 3))
    assert str(level) == "-95 % ± 1.6, ≤ -90 % required"
    error = Column(
        column.evaluator, Metric("error_m", "m", "lower", "", display_unit="mm", display_factor=1e3), "", "mean"
    )
    beside = replace(level, beside=(error, 0.00213))
    assert str(beside) == "-95 % ± 1.6 (error 2.13 mm), ≤ -90 % required"
