"""Quantisation on integers, against the real numbers that it stands for."""

from __future__ import annotations

import numpy as np
import pytest

from codecbench.plugins.codecs.dct.tables import FLAT, LUMINANCE
from codecbench.plugins.codecs.multilevel.context.quantization import (
    MAX_BIAS,
    MIN_BIAS,
    STEP_BITS,
    ZONES,
    biases_from_sums,
    dequantise,
    quantise,
    ratio,
    steps_from_table,
    sum_excesses,
)
from codecbench.plugins.codecs.multilevel.context.transform import FRACTION_BITS, MAX_COEFFICIENT, inverse_transform


def random_coefficients(blocks: int = 200) -> np.ndarray:
    return np.rint(np.random.default_rng(6).laplace(0, 400, (blocks, 64))).astype(np.int32)


def indices_of(coefficients: np.ndarray, steps: np.ndarray) -> np.ndarray:
    indices = np.empty_like(coefficients)
    quantise(coefficients, steps, indices)
    return indices


def test_steps_are_the_table_times_the_factor() -> None:
    steps = steps_from_table(LUMINANCE, 2.5, lapped=False) / (1 << STEP_BITS)
    assert np.array_equal(steps, 2.5 * LUMINANCE.reshape(64))


@pytest.mark.parametrize("qf", [1e-3, 1e6])
def test_steps_stay_in_bounds(qf: float) -> None:
    steps = steps_from_table(FLAT, qf, lapped=True)
    assert steps.min() >= 1 << 8
    assert steps.max() <= 1 << 32


def test_norms_are_those_of_the_lapped_basis() -> None:
    """A coefficient of the middle of nine blocks: the energy of its samples is the square of the norm."""
    steps = steps_from_table(FLAT, 1.0, lapped=True)
    for place in (0, 1, 8, 9, 27, 63):
        coefficients = np.zeros((25, 64), np.int32)
        coefficients[12, place] = 500 << FRACTION_BITS
        plane = np.empty((40, 40), np.uint8)
        inverse_transform(coefficients, 1, plane)
        norm = np.sqrt(((plane.astype(float) - 128) ** 2).sum()) / 500
        assert steps[place] / (16 << STEP_BITS) == pytest.approx(1 / norm, rel=0.02)


@pytest.mark.parametrize("qf", [0.05, 0.7, 3.3, 60])
def test_indices_have_a_dead_zone(qf: float) -> None:
    coefficients = random_coefficients()
    steps = steps_from_table(FLAT, qf, lapped=True)
    rounding = np.where(np.arange(64) > 0, 92 / 256, 0.5)
    sizes = np.abs(coefficients) / (1 << FRACTION_BITS) / (steps / (1 << STEP_BITS))
    expected = np.sign(coefficients) * np.floor(np.floor(256 * sizes) / 256 + rounding)
    assert np.array_equal(indices_of(coefficients, steps), expected)


def test_reconstruction_is_within_a_step() -> None:
    coefficients = random_coefficients()
    steps = steps_from_table(LUMINANCE, 1.0, lapped=False)
    indices = indices_of(coefficients, steps)
    sums = np.zeros((3, 3, 2), np.int64)
    sum_excesses(coefficients, steps, indices, sums)
    back = np.empty_like(coefficients)
    biases = biases_from_sums(sums)
    dequantise(indices, steps, biases, back)
    width = steps / (1 << (STEP_BITS - FRACTION_BITS))
    assert (np.abs(back - coefficients) <= (0.65 + biases.max() / 128) * width + 1).all()
    plain = np.empty_like(coefficients)
    dequantise(indices, steps, np.zeros((3, 3), np.int32), plain)
    inner = np.arange(64) > 0
    assert ((back - coefficients)[:, inner] ** 2).mean() < ((plain - coefficients)[:, inner] ** 2).mean()


def test_biases_are_means_and_bounded() -> None:
    sums = np.zeros((3, 3, 2), np.int64)
    sums[0, 0] = 64 * 10, 10  # a quarter of a step on average
    sums[1, 1] = 10_000, 10
    sums[2, 2] = -10_000, 10
    biases = biases_from_sums(sums)
    assert (biases[0, 0], biases[1, 1], biases[2, 2], biases[0, 1]) == (32, MAX_BIAS, MIN_BIAS, 0)


def test_dc_has_no_bias() -> None:
    indices = np.full((1, 64), 3, np.int32)
    back = np.empty_like(indices)
    dequantise(indices, steps_from_table(FLAT, 1.0, lapped=False), np.full((3, 3), 32, np.int32), back)
    assert back[0, 0] == 3 * 16 * 16
    assert (back[0, 1:] == 2.75 * 16 * 16).all()


def test_nothing_is_reconstructed_beyond_the_transform() -> None:
    indices = np.full((1, 64), -(1 << 17) + 1, np.int32)
    back = np.empty_like(indices)
    dequantise(indices, steps_from_table(FLAT, 1e6, lapped=False), np.zeros((3, 3), np.int32), back)
    assert (back == -MAX_COEFFICIENT).all()


def test_zones_and_ratio() -> None:
    assert ZONES.reshape(8, 8)[0].tolist() == [0, 0, 1, 1, 1, 2, 2, 2]
    assert ratio(16 * 40, 16 << STEP_BITS) == 640
