"""BD-rate against the reference implementation on clean curves, and its refusals on others."""

from __future__ import annotations

import bjontegaard
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codecbench.core.results.bjontegaard import bd_rate, bd_rate_with_interval
from codecbench.core.results.pareto import pareto_front

ANCHOR = ([9487.76, 4593.60, 2486.44, 1358.24], [40.037, 38.615, 36.845, 34.851])
TEST = ([9787.80, 4469.00, 2451.52, 1356.24], [40.121, 38.651, 36.970, 34.987])


@pytest.mark.parametrize("method", ["pchip", "akima"])
def test_equals_the_reference_implementation(method: str) -> None:
    ours = bd_rate(*ANCHOR, *TEST, method=method)
    theirs = bjontegaard.bd_rate(*ANCHOR, *TEST, method=method)
    assert ours.percent == pytest.approx(theirs, abs=1e-9)
    assert ours.reason == ""


@settings(max_examples=50, deadline=None)
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
    ],
)
def test_refuses_with_a_reason(test_curve: tuple[list[float], list[float]], words: str) -> None:
    result = bd_rate([100, 200, 400, 800], [30, 33, 36, 39], *test_curve)
    assert np.isnan(result.percent)
    assert words in result.reason
    assert words in str(result)


def test_the_hull_drops_and_counts_points_that_a_cheaper_one_beats() -> None:
    clean = bd_rate([100, 200, 400, 800], [30, 33, 36, 39], [100, 200, 400, 800], [31, 34, 37, 39.5])
    noisy = bd_rate(
        [100, 200, 400, 800],
        [30, 33, 36, 39],
        [100, 150, 200, 400, 800, 900],
        [31, 30.5, 34, 37, 39.5, np.nan],
        hull=True,
    )
    assert noisy.percent == pytest.approx(clean.percent, abs=1e-9)
    assert noisy.dropped == (0, 1)
    assert noisy.failures == (0, 1)


def test_the_interval_covers_a_known_difference(rng: np.random.Generator) -> None:
    rates = np.array([100.0, 200, 400, 800])[:, None] * rng.lognormal(0, 0.2, (1, 40))
    qualities = np.array([30.0, 33, 36, 39])[:, None] + rng.normal(0, 0.8, (1, 40))
    result = bd_rate_with_interval(rates, qualities, 0.8 * rates, qualities, rng=rng, resamples=200)
    assert result.interval is not None
    assert result.interval[0] <= -20.0 + 1e-6
    assert result.interval[1] >= -20.0 - 1e-6


def test_intervals_widen_with_independent_noise(rng: np.random.Generator) -> None:
    rates = np.array([100.0, 200, 400, 800])[:, None] * np.ones((1, 30))
    qualities = np.array([30.0, 33, 36, 39])[:, None] + rng.normal(0, 0.1, (4, 30))
    noisy = qualities + rng.normal(0, 1.0, (4, 30))
    narrow = bd_rate_with_interval(rates, qualities, rates, qualities, rng=rng, resamples=200).interval
    wide = bd_rate_with_interval(rates, qualities, rates, noisy, rng=rng, resamples=200).interval
    assert narrow == pytest.approx((0.0, 0.0), abs=1e-9)
    assert wide is not None
    assert wide[1] - wide[0] > 1.0


def test_mismatched_lists_are_refused() -> None:
    with pytest.raises(ValueError, match="one length"):
        bd_rate([1, 2, 3], [1, 2], [1, 2, 3], [1, 2, 3])
    with pytest.raises(ValueError, match="same samples"):
        bd_rate_with_interval(
            np.ones((4, 3)), np.ones((4, 3)), np.ones((4, 2)), np.ones((4, 2)), rng=np.random.default_rng(0)
        )


def test_pareto_front_agrees_with_the_definition(rng: np.random.Generator) -> None:
    values = rng.integers(0, 6, (60, 3)).astype(float)
    values[5, 1] = np.nan
    front = pareto_front(values, ["lower", "higher", "lower"])
    costs = values * [1, -1, 1]
    for index, row in enumerate(costs):
        beaten = any((other <= row).all() and (other < row).any() for other in costs if not np.isnan(other).any())
        assert front[index] == (not beaten and not np.isnan(row).any())


def test_pareto_front_refuses_what_it_cannot_read() -> None:
    with pytest.raises(ValueError, match="directions"):
        pareto_front([[1.0, 2.0]], ["lower"])
    with pytest.raises(ValueError, match="direction must"):
        pareto_front([[1.0]], ["best"])  # type: ignore[list-item]
