"""BD-rate against the reference implementation on clean curves, and its refusals on others."""

from __future__ import annotations

import bjontegaard
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codecbench.core.analysis.bjontegaard import BdRate, bd_rate, bd_rate_with_interval

ANCHOR = ([9487.76, 4593.60, 2486.44, 1358.24], [40.037, 38.615, 36.845, 34.851])
TEST = ([9787.80, 4469.00, 2451.52, 1356.24], [40.121, 38.651, 36.970, 34.987])


def test_equals_the_reference_implementation() -> None:
    ours = bd_rate(*ANCHOR, *TEST)
    theirs = bjontegaard.bd_rate(*ANCHOR, *TEST, method="pchip")
    assert ours.percent == pytest.approx(theirs, abs=1e-9)
    assert ours.reason == ""
    assert (ours.dropped, ours.failures, ours.interval) == ((0, 0), (0, 0), None)


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
        (([100, 200, 400, 800], [30, 30, 36, 38]), "not monotone"),
        (([-1, 200, 400, 800], [30, 33, 36, 38]), "not positive"),
        (([100, 200, 400, np.inf], [30, 33, 36, 38]), "infinite"),
        (([100, 200, np.nan, 800], [30, 33, 36, 38]), "rate is not known"),
        (([100, 200, 400, 800], [39, 40, 41, 42]), "share no quality"),
        (([100, 200, 400, 800], [36.8, 38, 43, 46]), "share only 24 % of the smaller quality range; at least 25 %"),
        (([], []), "0 usable points"),
    ],
)
def test_refuses_with_a_reason(test_curve: tuple[list[float], list[float]], words: str) -> None:
    result = bd_rate([100, 200, 400, 800], [30, 33, 36, 39], *test_curve)
    assert np.isnan(result.percent)
    assert words in result.reason
    assert words in str(result)


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
    assert few.reason == f"the test curve has {least - 1} usable points; pchip needs {least}"


def test_a_lossless_curve_is_refused_without_a_warning_of_numpy() -> None:
    lossless = ([100, 200, 400], [np.inf] * 3)
    with np.errstate(all="raise"):
        for anchor, test in ((ANCHOR, lossless), (lossless, TEST), (lossless, lossless)):
            result = bd_rate(*anchor, *test)
            assert "has an infinite value" in result.reason
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


def test_it_is_said_in_words() -> None:
    assert str(BdRate(-12.34, 1.0)) == "-12.3 %"
    assert str(BdRate(5.0, 1.0, interval=(-1.0, 10.06))) == "+5.0 % [-1.0, +10.1]"
    assert str(BdRate(float("nan"), 0.0, "why")) == "no BD-rate: why"


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


def test_the_hull_leaves_out_equal_qualities_and_counts_for_each_curve() -> None:
    clean = ([100, 200, 400, 800], [30, 33, 36, 39])
    level = ([100, 150, 200, 300, 400, 800], [30, 30, 33, 33, 36, 39])
    result = bd_rate(*level, [50, 60, *clean[0]], [30, 29, 30, 33, 36, 39], hull=True)
    assert result.dropped == (2, 2)
    assert bd_rate(*level, *clean, hull=True).dropped == (2, 0)
    assert bd_rate(*level, [100, 200, 800], [30, 33, 39], hull=True).dropped == (2, 0)
    assert bd_rate(*clean, *level, hull=True).percent == pytest.approx(0.0, abs=1e-9)


def test_a_reason_names_the_curve_at_fault() -> None:
    clean, falling = ([100, 200, 400], [30, 33, 36]), ([100, 200, 400], [30, 34, 33])
    rest = "curve is not monotone: rate 200 -> 400 takes quality from 34 to 33"
    assert bd_rate(*falling, *clean).reason == f"the anchor {rest}"
    assert bd_rate(*clean, *falling).reason == f"the test {rest}"


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


def noisy_curves(rng: np.random.Generator, samples: int) -> tuple[np.ndarray, np.ndarray]:
    """Rates and qualities of four settings, (4, samples)."""
    rates = np.array([100.0, 200, 400, 800])[:, None] * np.ones((1, samples))
    return rates, np.array([30.0, 33, 36, 39])[:, None] + rng.normal(0, 0.2, (4, samples))


def test_the_number_beside_an_interval_is_that_of_the_mean_curves(rng: np.random.Generator) -> None:
    anchor, test = noisy_curves(rng, 12), noisy_curves(rng, 12)
    result = bd_rate_with_interval(*anchor, *test, rng=rng, resamples=40)
    means = [array.mean(axis=1) for array in (*anchor, *test)]
    assert result.percent == pytest.approx(bjontegaard.bd_rate(*means, method="pchip"), abs=1e-9)


def test_an_interval_holds_the_percentiles_of_resamples_of_the_samples(rng: np.random.Generator) -> None:
    four = (*noisy_curves(rng, 6), *noisy_curves(rng, 6))
    result = bd_rate_with_interval(*four, rng=np.random.default_rng(3), resamples=50)
    again, values = np.random.default_rng(3), []
    for _ in range(50):
        picks = again.integers(0, 6, 6)
        values.append(bjontegaard.bd_rate(*(array[:, picks].mean(axis=1) for array in four), method="pchip"))
    assert result.interval == pytest.approx(np.percentile(values, [2.5, 97.5]), abs=1e-9)


def test_two_samples_give_no_interval_and_three_do(rng: np.random.Generator) -> None:
    for samples in (1, 2, 3):
        curves = noisy_curves(rng, samples)
        result = bd_rate_with_interval(*curves, *curves, rng=rng, resamples=20)
        assert result.percent == pytest.approx(0.0, abs=1e-9)
        assert (result.interval is None) == (samples < 3)


def test_no_interval_is_given_where_resamples_often_give_no_number(rng: np.random.Generator) -> None:
    """Drawn twice, the sample that swings lifts the mean of the second setting above that of the third."""
    rates, qualities = noisy_curves(rng, 9)
    swinging = qualities.copy()
    swinging[1, 0] += 18
    result = bd_rate_with_interval(rates, qualities, rates, swinging, rng=rng, resamples=60)
    assert np.isfinite(result.percent)
    assert result.interval is None


def test_a_falling_curve_is_refused_unless_its_hull_is_asked_for(rng: np.random.Generator) -> None:
    rates, qualities = noisy_curves(rng, 5)
    falling = np.insert(qualities, 2, 31, axis=0)
    more_rates = np.insert(rates, 2, 300, axis=0)
    refused = bd_rate_with_interval(rates, qualities, more_rates, falling, rng=rng, resamples=20)
    assert "not monotone" in refused.reason
    assert refused.interval is None
    reduced = bd_rate_with_interval(rates, qualities, more_rates, falling, rng=rng, hull=True, resamples=20)
    assert reduced.percent == pytest.approx(0.0, abs=1e-9)
    assert reduced.dropped == (0, 1)
    assert reduced.interval == pytest.approx((0.0, 0.0), abs=1e-9)


def test_samples_that_resemble_their_neighbours_are_drawn_together() -> None:
    """Forty frames of five scenes: resampled one by one they would seem to know eight times as much as they do."""
    rng = np.random.default_rng(3)
    scenes = np.repeat(rng.normal(0.0, 1.0, (4, 5)), 8, axis=1)
    rates = np.tile(np.array([[100.0], [200.0], [400.0], [800.0]]), (1, 40))
    qualities = np.array([[30.0], [36.0], [42.0], [48.0]]) + np.zeros((4, 40))
    widths = []
    for block in (1, 8):
        found = bd_rate_with_interval(
            rates, qualities, rates, qualities + scenes, rng=np.random.default_rng(0), resamples=300, block=block
        )
        assert found.interval is not None
        assert found.interval[0] <= found.percent <= found.interval[1]
        widths.append(found.interval[1] - found.interval[0])
    assert 1.5 < widths[1] / widths[0] < 4.0
