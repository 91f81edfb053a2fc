"""The settings that nobody beats, against the definition and by hand."""

from __future__ import annotations

import numpy as np
import pytest

from codecbench.core.analysis.verdicts import pareto_front


def test_pareto_front_agrees_with_the_definition(rng: np.random.Generator) -> None:
    values = rng.integers(0, 6, (60, 3)).astype(float)
    values[5, 1] = np.nan
    front = pareto_front(values, ["lower", "higher", "lower"])
    assert front.dtype == bool, "it is used as a mask"
    costs = values * [1, -1, 1]
    for index, row in enumerate(costs):
        beaten = any((other <= row).all() and (other < row).any() for other in costs if not np.isnan(other).any())
        assert front[index] == (not beaten and not np.isnan(row).any())


def test_pareto_front_refuses_what_it_cannot_read() -> None:
    with pytest.raises(ValueError, match="directions"):
        pareto_front([[1.0, 2.0]], ["lower"])
    with pytest.raises(ValueError, match="direction must"):
        pareto_front([[1.0]], ["best"])  # type: ignore[list-item]


def test_a_row_is_beaten_by_one_as_good_that_is_better_in_one_column() -> None:
    rows = [[1.0, 5.0], [1.0, 4.0], [2.0, 5.0], [2.0, 6.0], [1.0, 5.0], [np.nan, 9.0], [0.5, np.nan]]
    assert pareto_front(rows, ["lower", "higher"]).tolist() == [True, False, False, True, True, False, False]
    assert pareto_front(rows, ["higher", "higher"]).tolist() == [False, False, False, True, False, False, False]


def test_infinite_values_compare_as_numbers() -> None:
    rows = [[1.0, np.inf], [2.0, np.inf], [0.5, 30.0], [np.inf, np.inf]]
    assert pareto_front(rows, ["lower", "higher"]).tolist() == [True, False, True, False]


def test_a_single_row_is_a_front_unless_it_failed() -> None:
    assert pareto_front([3.0, 4.0], ["lower", "lower"]).tolist() == [True]
    assert pareto_front([np.nan, 4.0], ["lower", "lower"]).tolist() == [False]
    assert pareto_front(np.zeros((0, 2)), ["lower", "lower"]).tolist() == []
