"""What a run says about each codec, on tables whose answer is known in closed form."""

from __future__ import annotations

from collections.abc import Sequence

import bjontegaard
import numpy as np
import pandas as pd
import pytest
from measured_runs import ANCHORS, BLUR, DRIFT, METRICS, SCORE, Values, cell_result, run_of

from codecbench.core.analysis.bjontegaard import BdRate, bd_rate_with_interval
from codecbench.core.analysis.columns import Column
from codecbench.core.analysis.ranking import rankings
from codecbench.core.analysis.run_result import CurvePoint
from codecbench.core.analysis.verdicts import (
    anchors_of,
    bd_rates,
    bd_rates_by_anchor,
    bd_rates_over_repeats,
    frame_matrix,
    pareto_criteria,
    pareto_settings,
    spread,
    values_of_repeats,
)
from codecbench.core.contracts.metric import Metric
from codecbench.core.engine.planning.model import PluginSetting
from codecbench.core.report.page_data import verdict_tables

RATES = (0.25, 0.5, 1.0, 2.0)


def points(*codecs: str) -> dict[tuple[str, str], CurvePoint]:
    return {(codec, f"q={rate}"): CurvePoint(codec, f"q={rate}") for codec in codecs for rate in RATES}


def rates(factors: dict[str, float]) -> dict[tuple[str, str, str], float]:
    """Settings at RATES, times a factor for each codec."""
    return {("s", codec, f"q={rate}"): factor * rate for codec, factor in factors.items() for rate in RATES}


def per_row(values: dict[tuple[str, float], list[float]]) -> dict[tuple[str, str, str], list[float]]:
    return {("s", codec, f"q={rate}"): many for (codec, rate), many in values.items()}


def qualities(values: dict[tuple[str, float], list[float]]) -> dict[tuple[str, str, str], np.ndarray]:
    """Errors as qualities."""
    return {row: -np.log10(np.array(many)) for row, many in per_row(values).items()}


def errors(rate: float) -> list[float]:
    """Errors that fall with the rate, a little different at each start."""
    return [0.01 / rate * wobble for wobble in (0.9, 1.0, 1.2)]


def test_equal_errors_at_half_the_rate_save_half_the_rate() -> None:
    measured = qualities({(codec, rate): errors(rate) for codec in ("mine", "plain") for rate in RATES})
    found = bd_rates_over_repeats(rates({"plain": 1.0, "mine": 0.5}), measured, points("plain", "mine"), ANCHORS)
    assert set(found) == {("s", "mine")}
    assert found["s", "mine"].percent == pytest.approx(-50.0)
    assert found["s", "mine"].interval == pytest.approx((-50.0, -50.0))


def test_lost_runs_are_counted_and_a_setting_that_gains_nothing_is_left_out() -> None:
    values = {(codec, rate): errors(rate) for codec in ("plain", "mine") for rate in RATES}
    values["mine", 0.25] = [0.05, np.nan, 0.05]
    values["plain", 1.0] = errors(0.4)
    found = bd_rates_over_repeats(
        rates({"plain": 1.0, "mine": 1.0}), qualities(values), points("plain", "mine"), ANCHORS
    )
    assert found["s", "mine"].failures == (0, 1)
    assert found["s", "mine"].dropped == (1, 0)
    assert not found["s", "mine"].reason


def test_a_rate_that_is_not_known_gives_a_reason_and_no_number() -> None:
    measured = qualities({(codec, rate): errors(rate) for codec in ("plain", "mine") for rate in RATES})
    known = rates({"plain": 1.0, "mine": 0.5}) | {("s", "mine", "q=1.0"): np.nan}
    found = bd_rates_over_repeats(known, measured, points("plain", "mine"), ANCHORS)
    assert np.isnan(found["s", "mine"].percent)
    assert found["s", "mine"].reason == "the test curve has a setting whose rate is not known"


def test_the_anchor_is_the_one_that_is_declared_and_else_the_first_of_several_settings() -> None:
    curves = {"raw": [0], "mine a=1": [1, 2], "plain b=2": [3, 4]}
    assert anchors_of(curves, ANCHORS) == ("plain b=2",)
    assert anchors_of(curves, ()) == ("mine a=1",)
    assert anchors_of({"raw": [0], "plain": [1]}, ANCHORS) == ()


def test_codecs_that_cannot_be_compared_have_no_bd_rate() -> None:
    """A single setting, and other numbers of repeats than the anchor's, say nothing; the others are compared still."""
    measured = qualities({(codec, rate): errors(rate) for codec in ("plain", "rare", "mine") for rate in RATES})
    for rate in RATES:
        measured["s", "rare", f"q={rate}"] = measured["s", "rare", f"q={rate}"][:2]
    measured["s", "alone", "q=1.0"] = -np.log10(errors(1.0))
    known = rates(dict.fromkeys(("plain", "rare", "alone", "mine"), 1.0))
    found = bd_rates_over_repeats(known, measured, points("plain", "rare", "alone", "mine"), ANCHORS)
    assert set(found) == {("s", "mine")}
    assert found["s", "mine"].percent == pytest.approx(0.0, abs=1e-9)
    assert bd_rates_over_repeats(known, {("s", "alone", "q=1.0"): np.ones(3)}, points("alone"), ANCHORS) == {}


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
    results = [cell_result("plain", 1.0, "look", values), cell_result("mine", 2.0, "look", {})]
    labels, matrix = frame_matrix(results, "bits")
    assert labels == ["q=1.0", "q=2.0"]
    np.testing.assert_array_equal(matrix, [[1, np.nan, 3, np.nan, 5], [np.nan] * 5])
    np.testing.assert_array_equal(frame_matrix(results[:1], "bits", "part")[1], [[6, 7, 8, 9, 10]])


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
def test_bd_rates_over_frames_are_those_of_the_means_of_measured_frames(metric: Metric, value, quality) -> None:  # type: ignore[no-untyped-def]
    """The last frame, of vast rate, is not measured; a setting whose rate was not measured has no place on a curve."""
    results = [cell_result("mine", 7.0, "look", {(metric.name, ""): [1.0] * 5})]
    for codec in ("mine", "plain"):
        for rate, blur in zip(RATES, blurs(codec), strict=True):
            results.append(cell_result(codec, rate, "size", {("bits", ""): [*(rate * WOBBLE), 1000 / rate]}))
            results.append(cell_result(codec, rate, "look", {(metric.name, ""): [*value(blur), np.nan]}))
    run = run_of(*results)
    found = bd_rates(run, run.columns[f"look.{metric.name}.{metric.aggregates[0]}"], resamples=30)
    rate_means = np.array(RATES) * WOBBLE.mean()
    anchor, test = (quality(value(blurs(codec))).mean(axis=1) for codec in ("plain", "mine"))
    expected = bjontegaard.bd_rate(
        rate_means, anchor, rate_means, test, method="pchip", require_matching_points=False, min_overlap=0
    )
    assert set(found) == {("s", "mine")}
    assert found["s", "mine"].percent == pytest.approx(expected, abs=1e-9)
    frames = (np.outer(RATES, WOBBLE), quality(value(blurs("plain"))), quality(value(blurs("mine"))))
    seeded = np.random.default_rng(0)
    assert found["s", "mine"] == bd_rate_with_interval(*frames[:2], frames[0], frames[2], rng=seeded, resamples=30)


def over_frames(**frames: Sequence[tuple[float, Sequence[float]]]) -> dict[tuple[str, str], BdRate]:
    """BD-rates of codecs of which each has settings of a rate and of drifts of five frames."""
    results = []
    for codec, members in frames.items():
        for rate, values in members:
            results.append(cell_result(codec, rate, "size", {("bits", ""): [rate] * 5}))
            results.append(cell_result(codec, rate, "look", {("drift", ""): values}))
    run = run_of(*results)
    return bd_rates(run, run.columns["look.drift.median"], resamples=10)


def test_over_frames_too_a_curve_has_several_settings() -> None:
    many: list[tuple[float, Sequence[float]]] = [(rate, errors(rate) + errors(rate)[:2]) for rate in RATES]
    found = over_frames(plain=many, alone=many[:1], pair=many[:2])
    assert list(found) == [("s", "pair")]
    assert found["s", "pair"].reason == "the test curve has 2 usable points; pchip needs 3"
    assert over_frames(plain=many[:1], alone=many[:1]) == {}


def test_a_frame_that_a_codec_never_gave_counts_for_neither() -> None:
    """The anchor's last frame is much better than its others, which is not to the other codec's harm."""
    anchor: list[tuple[float, Sequence[float]]] = [(rate, [0.01 / rate] * 4 + [1e-9]) for rate in RATES]
    lost: list[tuple[float, Sequence[float]]] = [(rate / 2, [0.01 / rate] * 4 + [np.nan]) for rate in RATES]
    assert over_frames(plain=anchor, mine=lost)["s", "mine"].percent == pytest.approx(-50.0)
    assert over_frames(plain=lost, mine=anchor)["s", "mine"].percent == pytest.approx(100.0)


def test_repeats_of_frames_are_one_setting_with_their_mean() -> None:
    results = []
    for codec, factor in (("plain", 1.0), ("mine", 0.5)):
        for rate in RATES:
            results.append(cell_result(codec, factor * rate, "size", {("bits", ""): [factor * rate] * 5}))
            for repeat, share in enumerate((0.8, 1.2)):
                drifts = [share * 0.01 / rate] * 5
                results.append(cell_result(codec, factor * rate, "look", {("drift", ""): drifts}, repeat=repeat))
    run = run_of(*results)
    found = bd_rates(run, run.columns["look.drift.median"], resamples=0)
    assert found["s", "mine"].percent == pytest.approx(-50.0)


def test_an_error_of_nothing_has_no_logarithm_and_a_reason() -> None:
    perfect: list[tuple[float, Sequence[float]]] = [(rate, [0.01 / rate] * 4 + [0.0]) for rate in RATES]
    with np.errstate(all="raise"):
        assert "has an infinite value" in over_frames(plain=perfect, mine=perfect)["s", "mine"].reason


def test_bd_rates_go_by_repeats_where_a_metric_is_measured_once_a_repeat() -> None:
    results = []
    for codec, factor in (("plain", 1.0), ("mine", 0.5)):
        for rate in RATES:
            results.append(cell_result(codec, rate, "size", own={("bits", ""): [factor * rate]}))
            for repeat, error in enumerate(errors(rate)):
                results.append(cell_result(codec, rate, "track", own={("drift", ""): [error]}, repeat=repeat))
    run = run_of(*results)
    column = run.columns["track.drift.median"]
    found = bd_rates(run, column)
    assert set(found) == {("s", "mine")}
    assert found["s", "mine"].percent == pytest.approx(-50.0)
    measured = values_of_repeats(run, column)
    values = {row: -np.log10(np.array(list(many.values()))) for row, many in measured.items()}
    again = bd_rates_over_repeats(run.rates, values, run.curves, ANCHORS, resamples=20)
    assert bd_rates(run, column, resamples=20) == again
    without = run_of(*(result for result in results if result.cell.evaluator.name == "track"))
    assert bd_rates(without, column) == {}


def test_several_anchors_have_bd_rates_each() -> None:
    """`mine` needs half of plain's rate and twice that of `video`."""
    results = []
    for codec, factor in (("plain", 1.0), ("mine", 0.5), ("video", 0.25)):
        for rate in RATES:
            results.append(cell_result(codec, rate, "size", own={("bits", ""): [factor * rate]}))
            results += [
                cell_result(codec, rate, "track", own={("drift", ""): [error]}, repeat=repeat)
                for repeat, error in enumerate(errors(rate))
            ]
    run = run_of(*results, anchors=("video", "absent", "plain"))
    column = run.columns["track.drift.median"]
    found = bd_rates_by_anchor(run, column)
    percents = {(anchor, curve): rate.percent for anchor, of in found.items() for (_, curve), rate in of.items()}
    assert percents == {
        ("plain", "mine"): pytest.approx(-50.0),
        ("plain", "video"): pytest.approx(-75.0),
        ("video", "mine"): pytest.approx(100.0),
        ("video", "plain"): pytest.approx(300.0),
    }
    assert bd_rates(run, column, anchor="raw") == {}
    (table,), anchors = verdict_tables(run)
    assert anchors == "video and plain"
    heads = ["BD-rate vs. video, drift", "BD-rate vs. plain, drift"]
    places = [table["heads"].index(head) for head in heads]
    cells = {row[0]: [row[place] for place in places] for row in table["rows"]}
    assert cells["mine"][0].startswith("+100.0 %")
    assert cells["mine"][1].startswith("-50.0 %")
    assert (cells["video"][0], cells["plain"][1]) == ("anchor", "anchor")
    (ranking,) = rankings(run)
    assert ranking.anchors == ("video", "plain")
    saved = {curve: ranking.evidence("mine", curve) for curve in ("video", "plain")}
    assert {curve: round(100 * np.expm1(-found.mean)) for curve, found in saved.items() if found} == {
        "video": 100, "plain": -50,
    }  # fmt: skip


def test_bd_rates_over_repeats_are_those_of_hulls_with_seeded_resamples() -> None:
    wobbly = {("mine", rate): list(np.array(errors(rate)) * [1.1, 0.7, 1.0]) for rate in RATES}
    values = qualities({("plain", rate): errors(rate) for rate in RATES} | wobbly)
    found = bd_rates_over_repeats(
        rates({"plain": 1.0, "mine": 0.8}), values, points("plain", "mine"), ANCHORS, resamples=25
    )
    base, test = (np.array([values["s", codec, f"q={rate}"] for rate in RATES]) for codec in ("plain", "mine"))
    spent = np.repeat(np.array(RATES)[:, None], 3, axis=1)
    seeded = np.random.default_rng(0)
    assert found["s", "mine"] == bd_rate_with_interval(
        spent, base, 0.8 * spent, test, rng=seeded, hull=True, resamples=25
    )


def test_two_settings_are_a_curve_with_a_reason_over_repeats_too() -> None:
    measured = qualities(
        {("plain", rate): errors(rate) for rate in RATES} | {("pair", r): errors(r) for r in (1.0, 2.0)}
    )
    found = bd_rates_over_repeats(rates({"plain": 1.0, "pair": 1.0}), measured, points("plain", "pair"), ANCHORS)
    assert found["s", "pair"].reason == "the test curve has 2 usable points; pchip needs 3"


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
