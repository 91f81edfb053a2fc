"""BD-rate against the reference implementation on clean curves, and its refusals on others."""

from __future__ import annotations

import re

import bjontegaard
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from told import numbers

from codecbench.core.analysis.bjontegaard import BdRate, bd_rate

ANCHOR = ([9487.76, 4593.60, 2486.44, 1358.24], [40.037, 38.615, 36.845, 34.851])
TEST = ([9787.80, 4469.00, 2451.52, 1356.24], [40.121, 38.651, 36.970, 34.987])


def test_equals_the_reference_implementation() -> None:
    ours = bd_rate(*ANCHOR, *TEST)
    theirs = bjontegaard.bd_rate(*ANCHOR, *TEST, method="pchip")
    assert ours.percent == pytest.approx(theirs, abs=1e-9)
    assert ours.reason == ""
    assert ours.failures == (0, 0)


@settings(max_examples=50)
@given(st.integers(0, 2**32 - 1), st.integers(4, 9), st.integers(4, 9))
def test_equals_the_reference_on_random_clean_curves(seed: int, anchors: int, tests: int) -> None:
    rng = np.random.default_rng(seed)

    def curve(count: int) -> tuple[np.ndarray, np.ndarray]:
        return np.cumsum(rng.uniform(50, 900, count)), 28 + np.cumsum(rng.uniform(0.4, 2.5, count))

    anchor, test = curve(anchors), curve(tests)
    ours = bd_rate(*anchor, *test)
    if not ours.reason:
        theirs = bjontegaard.bd_rate(*anchor, *test, method="pchip", require_matching_points=False, min_overlap=0)
        assert ours.percent == pytest.approx(theirs, rel=1e-9, abs=1e-9)


def test_a_codec_that_needs_half_the_rate_is_at_minus_fifty_percent() -> None:
    rates, qualities = np.array([100.0, 200, 400, 800]), np.array([30.0, 33, 36, 39])
    assert bd_rate(rates, qualities, rates / 2, qualities).percent == pytest.approx(-50.0, abs=1e-9)


@pytest.mark.parametrize(
    ("test_curve", "words"),
    [
        (([100, 200, 400, 800], [40, 43, 46, 49]), "share no quality"),
        (([100, 200, 400, 800], [38.5, 43, 46, 49]), "share only"),
        (([100, 200, 400, 800], [30, 34, 33, 38]), "not monotone"),
        (([100, 200], [30, 34]), "2 usable points"),
        (([100, 200, 400, 800], [30, np.nan, np.nan, 38]), "2 usable points, 2 failed"),
        (([100, 200, 400, 800], [30, 33, 36, np.inf]), "infinite"),
        (([0, 200, 400, 800], [30, 33, 36, 38]), "not positive"),
        (([100, 100, 400, 800], [30, 33, 36, 38]), "not monotone"),
        (([100, 200, 400, 800], [30, 30, 36, 38]), "not monotone"),
        (([-1, 200, 400, 800], [30, 33, 36, 38]), "not positive"),
        (([100, 200, 400, np.inf], [30, 33, 36, 38]), "infinite"),
        (([100, 200, np.nan, 800], [30, 33, 36, 38]), "unknown rate"),
        (([100, 200, 400, 800], [39, 40, 41, 42]), "share no quality"),
        (([100, 200, 400, 800], [36.8, 38, 43, 46]), r"share only 24 %.*\b25 %"),
        (([], []), "0 usable points"),
    ],
)
def test_refuses_with_a_reason(test_curve: tuple[list[float], list[float]], words: str) -> None:
    result = bd_rate([100, 200, 400, 800], [30, 33, 36, 39], *test_curve)
    assert np.isnan(result.percent)
    assert re.search(words, result.reason)
    assert str(result).endswith(result.reason)


def test_a_quarter_of_the_shorter_range_is_enough_overlap() -> None:
    anchor = ([100, 200, 400, 800], [30, 32, 35, 38])
    result = bd_rate(*anchor, [100, 200, 400, 800], [36, 38, 40, 44])
    assert (result.overlap, result.reason) == (0.25, "")
    assert bd_rate(*anchor, [100, 200, 400], [31, 32, 33]).overlap == 1.0
    assert bd_rate(*anchor, [100, 200, 400], [40, 41, 42]).overlap == 0.0
    assert bd_rate(*anchor, [100], [33]).overlap == 0.0


def test_a_curve_needs_as_many_points_as_its_method() -> None:
    least = 3
    rates, qualities = np.array([100.0, 200, 400, 800]), np.array([30.0, 33, 36, 39])
    enough = bd_rate(rates, qualities, 2 * rates[:least], qualities[:least])
    assert enough.percent == pytest.approx(100.0)
    few = bd_rate(rates, qualities, rates[: least - 1], qualities[: least - 1])
    assert few.reason.startswith("the test curve")
    assert numbers(few.reason) == [least - 1, least]


def test_a_lossless_curve_is_refused_without_a_warning_of_numpy() -> None:
    lossless = ([100, 200, 400], [np.inf] * 3)
    with np.errstate(all="raise"):
        for anchor, test in ((ANCHOR, lossless), (lossless, TEST), (lossless, lossless)):
            result = bd_rate(*anchor, *test)
            assert "infinite" in result.reason
            assert result.overlap == 0.0


def test_units_do_not_matter() -> None:
    """Rates below one (bits a pixel) and qualities that differ by less (SSIM) are as good as others."""
    small = [np.array(values) / 20_000 for values in (*ANCHOR, *TEST)]
    result, again = bd_rate(*ANCHOR, *TEST), bd_rate(*small)
    assert again.percent == pytest.approx(result.percent, abs=1e-9)
    assert again.overlap == pytest.approx(result.overlap)
    assert result.overlap > 0.9


def test_settings_are_taken_in_any_order() -> None:
    given, order = [np.array(values) for values in TEST], [2, 0, 3, 1]
    assert bd_rate(*ANCHOR, *(values[order] for values in given)) == bd_rate(*ANCHOR, *given)


def test_a_result_as_text() -> None:
    assert str(BdRate(-12.34, 1.0)) == "-12.3 %"
    reason = "no rate is known"
    assert str(BdRate(float("nan"), 0.0, reason)) == f"no BD-rate: {reason}"


def test_a_setting_that_failed_is_counted_and_ends_its_curve() -> None:
    clean, more = ([100, 200, 400, 800], [30, 33, 36, 39]), ([100, 200, 400, 800, 900], [30, 33, 36, 39, np.nan])
    result = bd_rate(*clean, *more)
    assert (result.percent, result.failures) == (pytest.approx(0.0, abs=1e-9), (0, 1))


def test_a_reason_names_the_curve_at_fault() -> None:
    clean, falling = ([100, 200, 400], [30, 33, 36]), ([100, 200, 400], [30, 34, 33])
    rest = "curve is not monotone: from rate 200 to 400, quality goes from 34 to 33"
    assert bd_rate(*falling, *clean).reason == f"the anchor {rest}"
    assert bd_rate(*clean, *falling).reason == f"the test {rest}"


def test_mismatched_lists_are_refused() -> None:
    with pytest.raises(ValueError, match="one length"):
        bd_rate([1, 2, 3], [1, 2], [1, 2, 3], [1, 2, 3])
