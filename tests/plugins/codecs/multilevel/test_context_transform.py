"""The integer transform: close to the real one, its own inverse, and never beyond 32 bits."""

from __future__ import annotations

import numpy as np
import pytest

from codecbench.plugins.codecs.multilevel.context import transform
from codecbench.plugins.codecs.multilevel.context.transform import (
    FRACTION_BITS,
    MAX_COEFFICIENT,
    POST,
    PRE,
    forward_transform,
    inverse_transform,
)


def cosines(size: int, half: float = 0.0) -> np.ndarray:
    """Rows of the orthonormal DCT-II, or of the DCT-IV where `half` is one half."""
    k, n = np.mgrid[:size, :size]
    matrix = np.sqrt(2 / size) * np.cos(np.pi * (n + 0.5) * (k + half) / size)
    if not half:
        matrix[0] /= np.sqrt(2)
    return matrix


def real_filter() -> np.ndarray:
    """What Tran, Liang & Tu apply to differences across a border, nearest samples first."""
    flipped = np.eye(4)[::-1]
    return flipped @ cosines(4).T @ np.diag([1.6, 1, 1, 1]) @ cosines(4, 0.5) @ flipped


def filtered(plane: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """A plane with the 8 rows around each border filtered, then the columns."""
    for _ in range(2):
        plane = plane.copy()
        for border in range(8, len(plane), 8):
            above, below = plane[border - 4 : border][::-1], plane[border : border + 4]
            total, spread = above + below, matrix @ (above - below)
            plane[border - 4 : border], plane[border : border + 4] = ((total + spread) / 2)[::-1], (total - spread) / 2
        plane = plane.T
    return plane


def real_coefficients(plane: np.ndarray, lapped: bool) -> np.ndarray:
    centred = plane.astype(float) - 128
    blocks = filtered(centred, real_filter()) if lapped else centred
    height, width = plane.shape
    blocks = blocks.reshape(height // 8, 8, width // 8, 8).transpose(0, 2, 1, 3)
    return (cosines(8) @ blocks @ cosines(8).T).reshape(-1, 64)


def transformed(plane: np.ndarray, lapped: bool) -> np.ndarray:
    coefficients = np.empty((plane.size // 64, 64), np.int32)
    forward_transform(plane, int(lapped), coefficients)
    return coefficients


def planes() -> list[np.ndarray]:
    rng = np.random.default_rng(5)
    rows, columns = np.mgrid[:32, :48]
    return [
        rng.integers(0, 256, (32, 48)).astype(np.uint8),
        (255 * ((rows + columns) % 2)).astype(np.uint8),
        (255 * ((rows // 8 + columns // 8) % 2)).astype(np.uint8),
        rng.integers(0, 256, (8, 8)).astype(np.uint8),
    ]


@pytest.mark.parametrize("lapped", [False, True])
def test_coefficients_are_those_of_the_real_transform(lapped: bool) -> None:
    for plane in planes():
        expected = real_coefficients(plane, lapped)
        assert np.abs(transformed(plane, lapped) / (1 << FRACTION_BITS) - expected).max() < 0.75


@pytest.mark.parametrize("lapped", [False, True])
def test_every_picture_comes_back(lapped: bool) -> None:
    for plane in planes():
        back = np.empty_like(plane)
        inverse_transform(transformed(plane, lapped), int(lapped), back)
        assert np.array_equal(back, plane)


def test_the_filters_undo_each_other() -> None:
    assert np.allclose(PRE / 4096, real_filter(), atol=2e-4)
    assert np.allclose(PRE @ POST / 4096**2, np.eye(4), atol=1e-3)


@pytest.mark.parametrize("step", ["_forward_down", "_inverse_down"])
def test_no_sum_leaves_32_bits(step: str) -> None:
    """numpy's scalars say where they overflow; compiled code would not."""
    rng = np.random.default_rng(2)
    # The second pass of the inverse sees what the first makes of the largest coefficients.
    largest = 2.83 * MAX_COEFFICIENT if step == "_inverse_down" else 8 * 2048
    rows = (largest * rng.choice([-1, 1], (8, 64))).astype(np.int32)
    rows[:, :8] = largest * np.sign(cosines(8)).T
    out = np.empty_like(rows)
    with np.errstate(over="raise"):
        if step == "_forward_down":
            transform._forward_down.python(rows, 0, out)
        else:
            transform._inverse_down.python(rows, out, 0)
