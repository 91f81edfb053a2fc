"""How many values become one: against numpy, and at the edges where there are few, missing or infinite ones."""

from __future__ import annotations

import math

import numpy as np
import pytest

from codecbench.core.contracts.evaluator import Measurement
from codecbench.core.contracts.metric import Metric
from codecbench.core.engine.storage import aggregate as aggregate_module
from codecbench.core.engine.storage.aggregate import AGGREGATES, aggregate, median_interval, percentile, summarise


@pytest.mark.parametrize(
    ("name", "reference"),
    [
        ("mean", np.mean),
        ("std", lambda x: np.std(x, ddof=1)),
        ("median", np.median),
        ("p95", lambda x: np.percentile(x, 95)),
        ("iqr", lambda x: np.subtract(*np.percentile(x, [75, 25]))),
        ("min", np.min),
        ("max", np.max),
        ("sum", np.sum),
    ],
)
def test_aggregates_agree_with_numpy(name: str, reference, rng: np.random.Generator) -> None:  # type: ignore[no-untyped-def]
    values = rng.normal(10, 3, 37)
    assert aggregate(name, values) == pytest.approx(reference(values))
    assert aggregate(name, np.append(values, np.nan)) == pytest.approx(reference(values))


def test_aggregates_of_nothing_are_missing() -> None:
    for name in AGGREGATES:
        assert math.isnan(aggregate(name, np.array([])))
        assert math.isnan(aggregate(name, np.array([np.nan])))


def test_the_bootstrap_interval_covers_the_median_as_often_as_it_says(rng: np.random.Generator) -> None:
    covered = 0
    for _ in range(200):
        low, high = median_interval(rng.normal(0, 1, 25))
        covered += low <= 0 <= high
    assert 0.88 <= covered / 200 <= 0.995
    assert all(math.isnan(end) for end in median_interval(np.array([1.0, 2.0])))


def test_a_spread_of_one_value_is_missing_and_of_two_is_not() -> None:
    assert math.isnan(aggregate("std", np.array([3.0])))
    assert aggregate("std", np.array([3.0, 5.0])) == pytest.approx(math.sqrt(2))
    assert aggregate("iqr", np.array([3.0])) == 0.0


def test_infinite_values_are_left_out_of_means_and_stand_in_their_order() -> None:
    values = np.array([1.0, math.inf, 3.0, math.inf, 2.0])
    found = {
        name: aggregate(name, values) for name in ("mean", "std", "median", "min", "max", "sum", "infinite", "p95")
    }
    assert found == {
        "mean": 2.0, "std": 1.0, "median": 3.0, "min": 1.0, "max": math.inf, "sum": math.inf, "infinite": 2.0,
        "p95": math.inf,
    }  # fmt: skip
    assert aggregate("mean", np.array([-math.inf, -math.inf])) == -math.inf
    assert aggregate("iqr", np.full(4, math.inf)) == 0.0
    assert aggregate("infinite", np.array([-math.inf, 1.0, math.nan])) == 1.0


def test_between_an_infinite_value_and_a_finite_one_stands_the_infinite_one() -> None:
    for values in ([-math.inf, 5.0], [5.0, math.inf], [-math.inf, -math.inf, 5.0, 6.0]):
        assert aggregate("median", np.array(values)) == np.median(values)
    assert percentile(np.array([-math.inf, 5.0]), 100.0) == 5.0
    assert aggregate("iqr", np.array([-math.inf, 5.0, 6.0, 7.0])) == math.inf


@pytest.mark.parametrize("share", [0.0, 2.5, 25.0, 50.0, 97.5, 100.0])
@pytest.mark.parametrize("count", [1, 2, 5, 8])
def test_percentiles_agree_with_numpy(share: float, count: int, rng: np.random.Generator) -> None:
    values = rng.normal(0, 1, count)
    assert percentile(values, share) == pytest.approx(np.percentile(values, share))


def test_a_bootstrap_interval_is_the_same_every_time_and_in_blocks(
    monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator
) -> None:
    """Against all resamples at once, and against as many as fit in a block that divides nothing evenly."""
    values = rng.normal(5, 1, 200)
    medians = np.median(values[np.random.default_rng(0).integers(0, 200, (2000, 200))], axis=1)
    expected = tuple(np.percentile(medians, [2.5, 97.5]))
    assert median_interval(values) == pytest.approx(expected)
    assert (aggregate("ci95_low", values), aggregate("ci95_high", values)) == pytest.approx(expected)
    for picks in (1, 1_400, 120_200):
        monkeypatch.setattr(aggregate_module, "_MOST_PICKS", picks)
        assert median_interval(values) == pytest.approx(expected)
    low, high = median_interval(np.array([1.0, 2.0, 4.0]))
    assert (low, high) == (1.0, 4.0)


def test_frames_are_summarised_by_metric_and_stage() -> None:
    metrics = [Metric("size", "B", "lower", "", ("sum", "max")), Metric("psnr", "dB", "higher", "", ("mean",))]
    samples = [
        Measurement("size", 10.0, 0, "encode"),
        Measurement("size", 30.0, 1, "encode"),
        Measurement("size", 5.0, 0),
        Measurement("psnr", math.inf, 0),
        Measurement("psnr", 40.0, 1),
        Measurement("psnr", math.nan, 2, None, "black"),
    ]
    assert summarise(samples, metrics) == {
        ("size", "encode", "sum"): 40.0,
        ("size", "encode", "max"): 30.0,
        ("size", "", "sum"): 5.0,
        ("size", "", "max"): 5.0,
        ("psnr", "", "mean"): 40.0,
        ("psnr", "", "infinite"): 1.0,
    }


@pytest.mark.parametrize("how", ["mean", "sum", "std"])
def test_an_aggregate_that_overflows_is_an_error_and_not_infinite(how: str) -> None:
    samples = [Measurement("size", 1e308, 0), Measurement("size", 1e308 if how != "std" else -1e308, 1)]
    with pytest.raises(OverflowError, match=f"size: {how} of 2 finite values"):
        summarise(samples, [Metric("size", "B", "lower", "", (how,))])
