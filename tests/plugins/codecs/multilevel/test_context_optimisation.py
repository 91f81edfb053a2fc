"""Rate-distortion optimised quantisation: costs against entropies, and that it pays."""

from __future__ import annotations

import numpy as np
import pytest
from multilevel_pictures import textured

from codecbench.plugins.codecs.dct.tables import FLAT
from codecbench.plugins.codecs.multilevel.context import quantization
from codecbench.plugins.codecs.multilevel.context.quantization import (
    estimate_costs,
    optimise,
    quantise,
    steps_from_table,
)
from codecbench.plugins.codecs.multilevel.context.transform import forward_transform

COLUMNS = 16
STEPS = steps_from_table(FLAT, 2.0, lapped=True)


@pytest.fixture
def coefficients() -> np.ndarray:
    plane = textured(96, 8 * COLUMNS)
    out = np.empty((plane.size // 64, 64), np.int32)
    forward_transform(plane, 1, out)
    return out


def quantised(coefficients: np.ndarray) -> np.ndarray:
    indices = np.zeros((len(coefficients) + 1, 64), np.int32)
    quantise(coefficients, STEPS, indices)
    return indices


def costs_of(indices: np.ndarray) -> np.ndarray:
    costs = np.empty((66, 8, 2), np.int64)
    estimate_costs(indices, COLUMNS, costs)
    return costs


@pytest.mark.parametrize("number", [1, 2, 3, 100, 511, 512, 12_345, 10**9])
def test_logarithms(number: int) -> None:
    assert quantization._logarithm(number) / 256 == pytest.approx(np.log2(number), abs=2 / 256)


def test_costs_are_those_of_the_frequencies() -> None:
    """One index in four is not zero, whatever is around it: two bits for one, 0.415 for zero."""
    rng = np.random.default_rng(1)
    indices = np.zeros((40 * COLUMNS + 1, 64), np.int32)
    indices[:-1] = (rng.random((40 * COLUMNS, 64)) < 0.25) * rng.choice([-1, 1], (40 * COLUMNS, 64))
    costs = costs_of(indices)
    common = costs[1:64, 2] / 256
    assert np.abs(common.mean(axis=0) - [0.415, 2.0]).max() < 0.05
    assert (costs[64, :6, 0] < 10).all()  # it is always one, never more


def test_costs_are_positive_where_nothing_was_seen() -> None:
    assert costs_of(np.zeros((COLUMNS + 1, 64), np.int32)).min() >= 0


def test_indices_only_come_nearer_to_zero(coefficients: np.ndarray) -> None:
    indices = quantised(coefficients)
    before = indices.copy()
    optimise(coefficients, STEPS, COLUMNS, costs_of(indices), indices)
    nearest = np.rint(coefficients * 256 / STEPS)
    assert np.array_equal(indices[:, 0], before[:, 0])
    assert (np.abs(indices[:-1, 1:]) <= np.abs(nearest[:, 1:])).all()
    assert (np.abs(indices[:-1, 1:]) >= np.abs(nearest[:, 1:]) - 1)[indices[:-1, 1:] != 0].all()
    assert (indices[:-1] * coefficients >= 0)[:, 1:].all()
    assert not np.array_equal(indices, before)


def test_what_it_minimises_becomes_less(coefficients: np.ndarray) -> None:
    indices = quantised(coefficients)
    costs = costs_of(indices)
    before = lagrangian(coefficients, indices, costs)
    optimise(coefficients, STEPS, COLUMNS, costs, indices)
    assert lagrangian(coefficients, indices, costs) < before


def lagrangian(coefficients: np.ndarray, indices: np.ndarray, costs: np.ndarray) -> float:
    """Squared error in steps, and bits at their price, with contexts as they come out."""
    total = 0.0
    for block in range(len(coefficients)):
        for place in range(1, 64):
            context = quantization._context(indices, block, COLUMNS, place)
            magnitude = abs(int(indices[block, place]))
            bits = quantization._cost_of(costs, context, place, magnitude) if magnitude else costs[place, context, 0]
            error = abs(coefficients[block, place]) * 256 / STEPS[place] - magnitude
            total += error**2 + quantization.PRICE / 256 * bits / 256
    return total
