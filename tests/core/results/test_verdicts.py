"""What a run says about each codec, on tables whose answer is known in closed form."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from codecbench.core.results.curves import CurvePoint
from codecbench.core.results.verdicts import pareto_settings, trajectory_bd_rates, trajectory_limits

RATES = (0.25, 0.5, 1.0, 2.0)


def points(*codecs: str) -> dict[tuple[str, str], CurvePoint]:
    return {(codec, f"q={rate}"): CurvePoint(codec, f"q={rate}") for codec in codecs for rate in RATES}


def wide(factors: dict[str, float]) -> pd.DataFrame:
    """Settings at RATES, times a factor for each codec."""
    rows = [("s", codec, f"q={rate}", factor * rate) for codec, factor in factors.items() for rate in RATES]
    return pd.DataFrame(rows, columns=["sequence", "codec", "setting", "quality.rate_bpp.mean"])


def per_repeat(values: dict[tuple[str, float], list[float]]) -> pd.DataFrame:
    rows = [
        ("s", codec, f"q={rate}", repeat, value)
        for (codec, rate), many in values.items()
        for repeat, value in enumerate(many)
    ]
    return pd.DataFrame(rows, columns=["sequence", "codec", "setting", "repeat", "value"])


def errors(rate: float) -> list[float]:
    """Errors that fall with the rate, a little different at each start."""
    return [0.01 / rate * wobble for wobble in (0.9, 1.0, 1.2)]


def test_equal_errors_at_half_the_rate_save_half_the_rate() -> None:
    measured = per_repeat({(codec, rate): errors(rate) for codec in ("jpeg", "mine") for rate in RATES})
    found = trajectory_bd_rates(wide({"jpeg": 1.0, "mine": 0.5}), measured, points("jpeg", "mine"))
    assert set(found) == {("s", "mine")}
    assert found["s", "mine"].percent == pytest.approx(-50.0)
    assert found["s", "mine"].interval == pytest.approx((-50.0, -50.0))


def test_lost_runs_are_counted_and_a_setting_that_gains_nothing_is_left_out() -> None:
    values = {(codec, rate): errors(rate) for codec in ("jpeg", "mine") for rate in RATES}
    values["mine", 0.25] = [0.05, np.nan, 0.05]
    values["jpeg", 1.0] = errors(0.4)
    found = trajectory_bd_rates(wide({"jpeg": 1.0, "mine": 1.0}), per_repeat(values), points("jpeg", "mine"))
    assert found["s", "mine"].failures == (0, 1)
    assert found["s", "mine"].dropped == (1, 0)
    assert not found["s", "mine"].reason


def test_the_limit_is_the_last_setting_before_the_first_that_fails() -> None:
    success = {("jpeg", 2.0): [1, 1, 1], ("jpeg", 1.0): [1, 0, 1], ("jpeg", 0.5): [0, 0, 1], ("jpeg", 0.25): [1, 1, 1]}
    limits = trajectory_limits(wide({"jpeg": 1.0}), per_repeat(success), points("jpeg"))
    limit = limits["s", "jpeg"]
    assert limit is not None
    assert (limit.point, limit.successes, limit.runs, limit.next_failing) == ("q=1.0", 2, 3, "q=0.5")
    assert limit.low == pytest.approx(0.2077, abs=1e-4)  # Wilson 95 % of 2 in 3


def test_the_front_is_over_the_criteria_that_all_settings_have() -> None:
    table = pd.DataFrame(
        {
            "quality.rate_bpp.mean": [1.0, 2.0, 2.0, 3.0],
            "quality.psnr_gray_db.mean": [30.0, 35.0, 34.0, np.inf],
            "operations.source_total.encode.mean": [1e6, np.nan, 1e6, 1e6],
        }
    )
    criteria, front = pareto_settings(table)
    assert criteria == ["rate", "PSNR"]
    assert front.tolist() == [True, True, False, True]
    assert pareto_settings(table.drop(columns=list(table.columns)))[0] == []
