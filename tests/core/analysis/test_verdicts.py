"""What a run says about each codec, on tables whose answer is known in closed form."""

from __future__ import annotations

import bjontegaard
import numpy as np
import pandas as pd
import pytest
from measured_runs import ANCHORS, BLUR, DRIFT, METRICS, SCORE, Values, cell_result, run_of
from scipy.interpolate import PchipInterpolator

from codecbench.core.analysis.ranking import rankings, rankings_on
from codecbench.core.analysis.run_result import Column
from codecbench.core.analysis.table import CellResult
from codecbench.core.analysis.verdicts import (
    anchors_of,
    pareto_criteria,
    pareto_settings,
    spread,
    values_of_repeats,
)
from codecbench.core.contracts.metric import Metric
from codecbench.core.engine.planning.model import PluginSetting
from codecbench.core.report.formatting import signed_percent
from codecbench.core.report.page_data import verdict_tables

RATES = (0.25, 0.5, 1.0, 2.0)


def errors(rate: float) -> list[float]:
    """Errors that fall with the rate, a little different at each start."""
    return [0.01 / rate * wobble for wobble in (0.9, 1.0, 1.2)]


def test_the_anchor_is_the_one_that_is_declared_and_else_the_first_of_several_settings() -> None:
    curves = {"raw": [0], "mine a=1": [1, 2], "plain b=2": [3, 4]}
    assert anchors_of(curves, ANCHORS) == ("plain b=2",)
    assert anchors_of(curves, ()) == ("mine a=1",)
    assert anchors_of({"raw": [0], "plain": [1]}, ANCHORS) == ()


def column(name: str, better: str, role: str = "quality") -> Column:
    metric = Metric(name, "1", better, "", role=role)  # type: ignore[arg-type]
    return Column(PluginSetting("evaluator", "test", "1"), metric, "", "mean")


def test_what_is_missing_neither_wins_nor_removes_others_from_the_front() -> None:
    """The second has no count of its work and is on the front by its score; the third is beaten by the first."""
    criteria = [column("rate", "lower", "rate"), column("score", "higher"), column("work", "lower", "operations")]
    table = pd.DataFrame(
        {
            "test.rate.mean": [1.0, 2.0, 2.0, 3.0, 0.1, 2.0],
            "test.score.mean": [30.0, 35.0, 29.0, np.inf, np.nan, 35.0],
            "test.work.mean": [1e6, np.nan, 1e6, 1e6, 1.0, 9e9],
        }
    )
    names, front = pareto_settings(table, criteria)
    assert names == ["rate", "score", "work"]
    assert front.tolist() == [True, False, False, True, False, True]
    assert pareto_settings(table[:4], criteria)[1].tolist() == [True, True, False, True]
    assert pareto_settings(table.drop(columns=list(table.columns)), criteria)[0] == []


def test_the_front_says_which_settings_are_on_it_in_the_directions_of_the_columns() -> None:
    table = pd.DataFrame({"test.rate.mean": [1.0, 2.0], "test.score.mean": [30.0, 29.0]})
    assert pareto_settings(table, [column("rate", "lower"), column("score", "higher")])[1].tolist() == [True, False]
    assert pareto_settings(table, [column("rate", "higher"), column("score", "lower")])[1].tolist() == [False, True]
    names, front = pareto_settings(table, [column("missing", "lower")])
    assert (names, front.tolist(), front.dtype) == ([], [False, False], bool)


def test_values_of_frames_stand_in_their_places() -> None:
    values: Values = {
        ("bits", ""): [1, np.nan, 3, np.nan, 5],
        ("bits", "part"): [6, 7, 8, 9, 10],
        ("blur", ""): [0] * 5,
    }
    result = cell_result("plain", 1.0, "look", values)
    np.testing.assert_array_equal(result.values_of_frames("bits"), [1, np.nan, 3, np.nan, 5])
    np.testing.assert_array_equal(result.values_of_frames("bits", "part"), [6, 7, 8, 9, 10])
    np.testing.assert_array_equal(cell_result("mine", 2.0, "look", {}).values_of_frames("bits"), [np.nan] * 5)


WOBBLE = np.array([0.8, 0.9, 1.0, 1.3])
"""From frame to frame."""
BLURS = np.array([8.0, 3.0, 2.0, 0.5])
"""Of the settings at RATES."""


def blurs(codec: str) -> np.ndarray:
    """(settings, frames); one codec is a third less blurred than the other."""
    return (2 / 3 if codec == "mine" else 1.0) * BLURS[:, None] / WOBBLE


@pytest.mark.parametrize(
    ("metric", "value", "quality"),
    [
        (SCORE, lambda blur: 50 - blur, lambda score: score),
        (BLUR, lambda blur: blur, lambda blur: -blur),
        (DRIFT, lambda blur: blur, lambda drift: -np.log10(drift)),
    ],
)
def test_the_rate_at_equal_quality_is_that_of_the_means_of_measured_frames(metric: Metric, value, quality) -> None:  # type: ignore[no-untyped-def]
    """The last frame is not measured; a setting whose rate was not measured has no place on a curve."""
    results = [cell_result("mine", 7.0, "look", {(metric.name, ""): [1.0] * 5})]
    for codec in ("mine", "plain"):
        for rate, blur in zip(RATES, blurs(codec), strict=True):
            results.append(cell_result(codec, rate, "size", {("bits", ""): [*(rate * WOBBLE), rate]}))
            results.append(cell_result(codec, rate, "look", {(metric.name, ""): [*value(blur), np.nan]}))
    run = run_of(*results)
    (ranking,) = rankings_on(run, run.columns[f"look.{metric.name}.{metric.aggregates[0]}"], [["s"]])
    anchor, test = (quality(value(blurs(codec))).mean(axis=1) for codec in ("plain", "mine"))
    expected = bjontegaard.bd_rate(
        RATES, anchor, RATES, test, method="pchip", require_matching_points=False, min_overlap=0
    )
    found = ranking.evidence("mine", "plain")
    assert found is not None
    assert 100.0 * np.expm1(-found.mean) == pytest.approx(expected, abs=0.6), "an average over 33 qualities"
    shared = np.linspace(max(anchor[0], test[0]), min(anchor[-1], test[-1]), 33)
    saved = PchipInterpolator(anchor, np.log(RATES))(shared) - PchipInterpolator(test, np.log(RATES))(shared)
    assert found.mean == pytest.approx(saved.mean(), abs=1e-9)


def tracked(factors: dict[str, float]) -> list[CellResult]:
    """Cells of codecs that take so many times the rate for the same errors of three starts."""
    results = []
    for codec, factor in factors.items():
        for rate in RATES:
            results.append(cell_result(codec, rate, "size", own={("bits", ""): [factor * rate]}))
            results += [
                cell_result(codec, rate, "track", own={("drift", ""): [error]}, repeat=repeat)
                for repeat, error in enumerate(errors(rate))
            ]
    return results


def test_the_table_of_codecs_has_the_differences_of_the_ranking() -> None:
    """`mine` needs half of plain's rate and twice that of `video`; raw, of one setting, shares no rate with them."""
    cells = tracked({"plain": 1.0, "mine": 0.5, "video": 0.25})
    raw = cell_result("raw", 9.0, "size", own={("bits", ""): [24.0]})
    run = run_of(*cells, raw, anchors=("video", "absent", "plain"))
    (table,) = verdict_tables(run)
    assert table["heads"] == ["curve", "settings", "Pareto front", "bits [bpp]"]
    assert table["beside"] == [
        {
            "title": "Rate vs. video",
            "heads": ["curve", "drift"],
            "rows": [["plain", "+300 % ± 0"], ["mine", "+100 % ± 0"]],
        },
        {
            "title": "Rate vs. plain",
            "heads": ["curve", "drift"],
            "rows": [["mine", "-50 % ± 0"], ["video", "-75 % ± 0"]],
        },
    ]
    assert table["missing"] == []
    (ranking,) = rankings(run)
    assert ranking.anchors == ("video", "plain")
    for anchor, shown in zip(ranking.anchors, table["beside"], strict=True):
        for curve, cell in shown["rows"]:
            found = ranking.evidence(curve, anchor)
            assert found is not None
            assert cell == signed_percent(found)


def test_what_has_no_difference_is_named_below_the_table_with_the_reason_of_the_ranking() -> None:
    """`far` has other qualities at other rates, `lost` nothing; drifts, one for all settings, rank nobody."""
    results = []
    for codec, factor, level in (("plain", 1.0, 30.0), ("mine", 0.5, 30.0), ("far", 100.0, 60.0)):
        for rate in RATES:
            scores = [level + 5 * np.log2(rate) + wobble for wobble in WOBBLE]
            values: Values = {("bits", ""): [factor * rate] * 4, ("score", ""): scores, ("drift", ""): [1.0] * 4}
            results.append(cell_result(codec, rate, "look", values, count=4))
    results.append(cell_result("lost", 1.0, "look", status="crashed", reason="signal 11", count=4))
    (table,) = verdict_tables(run_of(*results))
    assert [row[0] for row in table["rows"]] == ["plain", "mine", "far", "lost"]
    assert table["beside"] == [
        {"title": "Rate vs. plain", "heads": ["curve", "score"], "rows": [["mine", "-50 %, no interval"]]}
    ]
    silent, lost, far = table["missing"]
    assert "drift is uninformative" in silent
    assert lost.startswith("score: lost ")
    assert lost.endswith(": unknown rate: q=1.0.")
    assert far.startswith("score: far ")
    assert "no other codec" in far


def test_without_a_rate_nothing_is_compared() -> None:
    cells = [cell for cell in tracked({"plain": 1.0, "mine": 0.5}) if cell.cell.evaluator.name == "track"]
    (table,) = verdict_tables(run_of(*cells))
    assert table["heads"] == ["curve", "settings", "Pareto front"]
    assert (table["beside"], table["missing"]) == ([], [])


def test_values_of_repeats_are_in_order_and_of_the_stage() -> None:
    results = [
        cell_result("plain", 1.0, "track", own={("drift", ""): [value], ("drift", "late"): [10 * value]}, repeat=repeat)
        for repeat, value in ((2, 0.2), (0, 0.9), (1, 0.4))
    ]
    results.append(cell_result("mine", 1.0, "track", {("drift", ""): [1, 2, 3, 4, 9]}))
    results.append(cell_result("none", 1.0, "track", own={("bits", ""): [1.0]}))
    results.append(cell_result("twice", 1.0, "track", own={("drift", ""): [0.8, 0.1]}))
    run = run_of(*results)
    usual, late = (Column(PluginSetting("evaluator", "track", "1"), DRIFT, stage, "median") for stage in ("", "late"))
    assert values_of_repeats(run, usual) == {
        ("s", "plain", "q=1.0"): {(0, 0): 0.9, (1, 0): 0.4, (2, 0): 0.2},
        ("s", "mine", "q=1.0"): {(0, 0): 3.0},
        ("s", "twice", "q=1.0"): {(0, 0): 0.8, (0, 1): 0.1},
    }
    assert values_of_repeats(run, late) == {("s", "plain", "q=1.0"): {(0, 0): 9.0, (1, 0): 4.0, (2, 0): 2.0}}


def test_a_repeat_that_failed_has_a_value_that_is_missing() -> None:
    """Left out, a codec that crashes at the hard starts would do better than one that does not."""
    results = [
        cell_result("plain", 1.0, "track", own={("drift", ""): [0.5]}),
        cell_result("plain", 1.0, "track", repeat=1, status="crashed", reason="signal 11"),
        cell_result("plain", 1.0, "track", repeat=2, status="unsupported", reason="no camera"),
    ]
    run = run_of(*results)
    found = values_of_repeats(run, run.columns["track.drift.median"])["s", "plain", "q=1.0"]
    assert found == {(0, 0): 0.5, (1, 0): pytest.approx(np.nan, nan_ok=True)}


def test_settings_are_compared_in_rate_and_headlines_that_have_a_direction() -> None:
    own: Values = {(name, ""): [1.0] for name in METRICS}
    names = [column.metric.name for column in pareto_criteria(run_of(cell_result("plain", 1.0, "all", own=own)))]
    assert names == ["bits", "score", "blur", "drift", "work", "speed"]
    del own["bits", ""]
    names = [column.metric.name for column in pareto_criteria(run_of(cell_result("plain", 1.0, "all", own=own)))]
    assert names == ["score", "blur", "drift", "work", "speed"]


@pytest.mark.parametrize(
    ("values", "text"),
    [([1, 2, np.nan, 3, 4], "2.5 [1.75, 3.25]"), ([2, 2, 2], "2"), ([1234.5], "1.23e+03"), ([np.nan], "–"), ([], "–")],
)
def test_a_spread_is_median_and_quartiles(values: list[float], text: str) -> None:
    assert spread(np.array(values, float)) == text
