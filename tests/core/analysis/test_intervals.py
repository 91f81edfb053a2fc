"""Intervals of rows whose spread is known."""

from __future__ import annotations

import numpy as np
import pytest
from measured_runs import cell_result, run_of
from scipy.stats import t as student

from codecbench.core.analysis.verdicts import intervals


def test_of_repeats_that_are_averaged_it_is_students() -> None:
    values = [30.0, 31.0, 33.0, 34.0]
    cells = [
        cell_result("plain", 1.0, "look", own={("score", ""): [value]}, repeat=i) for i, value in enumerate(values)
    ]
    run = run_of(*cells)
    (found,) = intervals(run, run.columns["look.score.mean"]).values()
    low, high = student.interval(0.95, 3, np.mean(values), np.std(values, ddof=1) / 2)
    assert found == pytest.approx((low, high))


def test_of_repeats_whose_median_is_shown_it_is_between_the_least_and_the_most() -> None:
    values = [1.0, 2.0, 3.0, 4.0, 50.0]
    cells = [
        cell_result("plain", 1.0, "track", own={("drift", ""): [value]}, repeat=i) for i, value in enumerate(values)
    ]
    run = run_of(*cells)
    (found,) = intervals(run, run.columns["track.drift.median"]).values()
    assert found[0] < 3.0 < found[1]
    assert min(values) <= found[0]
    assert found[1] <= max(values)


def test_of_a_single_repeat_it_is_over_its_frames(rng: np.random.Generator) -> None:
    """For independent frames about mean plus and minus t times the standard error, with fewer degrees of freedom."""
    values = rng.normal(30.0, 1.0, 400)
    run = run_of(cell_result("plain", 1.0, "look", {("score", ""): values.tolist()}, count=400))
    (found,) = intervals(run, run.columns["look.score.mean"]).values()
    assert sum(found) / 2 == pytest.approx(values.mean())
    assert 0.5 * 1.96 / 20 < (found[1] - found[0]) / 2 < 2.0 * 1.96 / 20


@pytest.mark.parametrize("values", [[np.inf] * 64, [30.0] * 4, []])
def test_infinite_and_too_few_values_have_none(values: list[float]) -> None:
    run = run_of(cell_result("plain", 1.0, "look", {("score", ""): values, ("bits", ""): [1.0] * 64}, count=64))
    columns = [column for name, column in run.columns.items() if name == "look.score.mean"]
    assert [intervals(run, column) for column in columns] in ([{}], [])


def test_two_repeats_say_nothing() -> None:
    cells = [
        cell_result("plain", 1.0, "track", own={("drift", ""): [value]}, repeat=i) for i, value in enumerate((1, 2))
    ]
    run = run_of(*cells)
    assert intervals(run, run.columns["track.drift.median"]) == {}
