"""What a run says about each codec, on tables whose answer is known in closed form."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from codecbench.core.contracts.metric import Metric
from codecbench.core.engine.planning.model import PluginSetting
from codecbench.core.results.columns import Column
from codecbench.core.results.curves import CurvePoint
from codecbench.core.results.verdicts import anchor_of, bd_rates_over_repeats, limits_of, pareto_settings

RATES = (0.25, 0.5, 1.0, 2.0)
ANCHORS = ("plain",)


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
    assert anchor_of(curves, ANCHORS) == "plain b=2"
    assert anchor_of(curves, ()) == "mine a=1"
    assert anchor_of({"raw": [0], "plain": [1]}, ANCHORS) is None


SUCCESS = {("plain", 2.0): [1, 1, 1], ("plain", 1.0): [1, 0, 1], ("plain", 0.5): [0, 0, 1], ("plain", 0.25): [1, 1, 1]}


def test_the_limit_is_the_last_setting_before_the_first_that_fails() -> None:
    limit = limits_of(rates({"plain": 1.0}), per_row(SUCCESS), points("plain"))["s", "plain"]
    assert (limit.point, limit.rate, limit.reason) == ("q=1.0", 1.0, "")
    assert (limit.successes, limit.runs, limit.next_failing) == (2, 3, "q=0.5")
    # 2 of 3 by Wilson's formula: (p + z^2/2n - z sqrt(p(1-p)/n + z^2/4n^2)) / (1 + z^2/n) with z = 1.96
    assert limit.low == pytest.approx(0.2077, abs=1e-4)


def test_a_codec_that_fails_at_its_best_has_no_limit() -> None:
    failing = {key: [0.0, 0.0, 1.0] for key in SUCCESS}
    assert limits_of(rates({"plain": 1.0}), per_row(failing), points("plain"))["s", "plain"].reason == (
        "fails at every setting"
    )


def test_a_missing_value_is_a_run_without_success() -> None:
    values = {("plain", 2.0): [1.0, np.nan]}
    assert limits_of(rates({"plain": 1.0}), per_row(values), points("plain"))["s", "plain"].reason


@pytest.mark.parametrize("unknown", RATES)
def test_a_limit_is_refused_where_a_rate_is_not_known(unknown: float) -> None:
    """Sorted by rates with a NaN among them, a sweep would say anything."""
    for known in (
        rates({"plain": 1.0}) | {("s", "plain", f"q={unknown}"): np.nan},
        {row: rate for row, rate in rates({"plain": 1.0}).items() if rate != unknown},
    ):
        limit = limits_of(known, per_row(SUCCESS), points("plain"))["s", "plain"]
        assert limit.reason == f"no rate is known of q={unknown}"
        assert np.isnan(limit.rate)


def column(name: str, better: str) -> Column:
    return Column(PluginSetting("evaluator", "test", "1"), Metric(name, "1", better, ""), "", "mean")  # type: ignore[arg-type]


def test_the_front_is_over_the_criteria_that_all_settings_have() -> None:
    criteria = [column("rate", "lower"), column("score", "higher"), column("work", "lower")]
    table = pd.DataFrame(
        {
            "test.rate.mean": [1.0, 2.0, 2.0, 3.0],
            "test.score.mean": [30.0, 35.0, 34.0, np.inf],
            "test.work.mean": [1e6, np.nan, 1e6, 1e6],
        }
    )
    names, front = pareto_settings(table, criteria)
    assert names == ["rate", "score"]
    assert front.tolist() == [True, True, False, True]
    assert pareto_settings(table.drop(columns=list(table.columns)), criteria)[0] == []
