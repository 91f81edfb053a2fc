"""The order of codecs at one rate, where it is known."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from codecbench.core.contracts.metric import Metric
from codecbench.core.engine.planning.model import PluginSetting
from codecbench.core.results.columns import Column
from codecbench.core.results.matched_rates import at_rate, curves_of_frames, holm, order_at_rate, standings


def test_a_value_between_two_settings_is_interpolated_over_the_logarithm_of_the_rate() -> None:
    rates, values = np.array([4.0, 1.0]), np.array([[10.0, 30.0], [0.0, 10.0]])
    np.testing.assert_allclose(at_rate(rates, values, 2.0), [5.0, 20.0])
    np.testing.assert_allclose(at_rate(rates, values, 1.0), [0.0, 10.0])
    np.testing.assert_allclose(at_rate(rates, values, 4.0), [10.0, 30.0])
    assert at_rate(rates, values, 0.9) is None
    assert at_rate(rates, values, 4.1) is None
    assert at_rate(np.array([1.0, np.nan]), values, 1.0) is None
    assert at_rate(np.empty(0), np.empty((0, 2)), 1.0) is None


def test_settings_of_one_rate_are_no_reason_to_divide_by_nothing() -> None:
    values = np.array([[1.0], [2.0]])
    assert at_rate(np.array([3.0, 3.0]), values, 3.0) in (1.0, 2.0)


def test_p_values_are_corrected_for_their_number() -> None:
    """Holm's own way: the smallest times 4, the next times 3, and none below one before it."""
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.9, 0.8]) == [1.0, 1.0]
    assert holm([]) == []


def test_what_differs_is_told_apart_and_what_does_not_is_joined() -> None:
    rng = np.random.default_rng(1)  # with the usual seed the alike ones are the twentieth case of twenty
    scene = 5.0 * rng.normal(size=200)
    values = {
        "worst": scene - 1.0 + 0.5 * rng.normal(size=200),
        "best": scene + 1.0 + 0.5 * rng.normal(size=200),
        "good": scene + 0.5 * rng.normal(size=200),
        "alike": scene + 0.5 * rng.normal(size=200),
    }
    found = standings(values)
    assert [place.curve for place in found][::3] == ["best", "worst"]
    assert [place.group for place in found] == [0, 1, 1, 2]
    assert found[0].p_value < 1e-6
    assert found[1].p_value > 0.05
    assert found[-1].ahead is None
    assert [place.curve for place in standings(values, -1.0)] == [place.curve for place in found][::-1]
    assert standings({}) == []


def test_equal_codecs_under_other_names_are_never_ordered(rng: np.random.Generator) -> None:
    for _ in range(20):
        series = rng.normal(size=200)
        assert {place.group for place in standings({name: series.copy() for name in "abc"})} == {0}


def test_a_frame_that_one_codec_lacks_counts_for_none(rng: np.random.Generator) -> None:
    """A codec cannot gain by failing where it is hard."""
    easy = np.where(np.arange(100) < 50, 1.0, 0.0)
    picky = np.where(easy == 1.0, 1.0, np.nan)
    found = standings({"all": easy, "picky": picky})
    assert [place.mean for place in found] == [1.0, 1.0]
    assert {place.group for place in found} == {0}


def run_of(values: dict[tuple[str, float], np.ndarray]) -> SimpleNamespace:
    """A run with what the order asks of it: cells of codecs at rates, with a score a frame."""
    import pandas as pd

    def result(codec: str, rate: float, scores: np.ndarray) -> SimpleNamespace:
        label = f"q={rate}"
        sequence = SimpleNamespace(name="s", frames=len(scores))
        cell = SimpleNamespace(sequence=sequence, codec=SimpleNamespace(name=codec, label=label))
        table = pd.DataFrame({"metric": "score", "stage": None, "frame": range(len(scores)), "value": scores})
        return SimpleNamespace(cell=cell, frames=lambda: table)

    return SimpleNamespace(
        of=lambda title: [result(*key, scores) for key, scores in values.items()],
        curves={(codec, f"q={rate}"): SimpleNamespace(curve=codec) for codec, rate in values},
        rates={("s", codec, f"q={rate}"): rate for codec, rate in values},
    )


@pytest.mark.parametrize(("better", "first"), [("higher", "plain"), ("lower", "mine")])
def test_the_order_goes_by_the_direction_of_the_metric(rng: np.random.Generator, better: str, first: str) -> None:
    scene = rng.normal(size=60)
    values = {
        (codec, rate): scene + rate + lead + 0.01 * rng.normal(size=60)
        for codec, lead in (("plain", 1.0), ("mine", 0.0))
        for rate in (1.0, 2.0)
    }
    run = run_of(values | {("alone", 1.5): scene})
    column = Column(PluginSetting("evaluator", "test", "1"), Metric("score", "1", better, ""), "", "mean")  # type: ignore[arg-type]
    assert set(curves_of_frames(run, column, "s")) == {"plain", "mine"}  # type: ignore[arg-type]
    found = order_at_rate(run, column, "s", np.sqrt(2.0))  # type: ignore[arg-type]
    assert found[0].curve == first
    assert [place.group for place in found] == [0, 1]
    assert abs(found[0].mean - found[1].mean) == pytest.approx(1.0, abs=0.01)
    assert order_at_rate(run, column, "s", 3.0) == []  # type: ignore[arg-type]
