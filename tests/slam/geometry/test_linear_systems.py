from __future__ import annotations

import numpy as np
import pytest

from codecbench.slam.geometry.linear_systems import (
    envelope_offsets,
    envelope_order,
    factorize_envelope,
    first_neighbors,
    solve_envelope,
    solve_symmetric,
)

pytestmark = pytest.mark.thorough


def packed(matrix: np.ndarray, first: np.ndarray, block: int) -> np.ndarray:
    """The envelope of a matrix, as the solver stores it."""
    rows = [matrix[block * i : block * (i + 1), block * f : block * (i + 1)].ravel() for i, f in enumerate(first)]
    return np.concatenate(rows)


def sparse_system(rng: np.random.Generator, adjacency: np.ndarray, block: int) -> np.ndarray:
    """A positive definite matrix with blocks only where the graph has an edge."""
    n = len(adjacency)
    matrix = rng.normal(size=(n * block, n * block))
    matrix = (matrix + matrix.T) * np.kron(adjacency | np.eye(n, dtype=bool), np.ones((block, block)))
    return matrix + np.eye(n * block) * (np.abs(matrix).sum(axis=1).max() + 1.0)


@pytest.mark.parametrize("block", [1, 2, 3, 6, 7, 8])
@pytest.mark.parametrize("density", [0.05, 0.3, 1.0])
def test_envelope_solution_agrees_with_numpy(block: int, density: float, rng: np.random.Generator) -> None:
    adjacency = rng.random((25, 25)) < density
    adjacency |= adjacency.T
    matrix, right_side = sparse_system(rng, adjacency, block), rng.normal(size=25 * block)
    first = first_neighbors(adjacency)
    offsets = envelope_offsets(first, block)
    values, x = packed(matrix, first, block), right_side.copy()
    assert len(values) == offsets[-1]
    assert factorize_envelope(values, first, offsets, block)
    solve_envelope(values, first, offsets, block, x)
    np.testing.assert_allclose(x, np.linalg.solve(matrix, right_side), rtol=1e-10, atol=1e-14)


def test_an_indefinite_matrix_is_reported(rng: np.random.Generator) -> None:
    matrix = sparse_system(rng, np.ones((4, 4), dtype=bool), 6)
    matrix[20, 20] = -1.0
    first = np.zeros(4, dtype=np.int64)
    assert not factorize_envelope(packed(matrix, first, 6), first, envelope_offsets(first, 6), 6)
    matrix[20, 20] = np.nan
    assert not factorize_envelope(packed(matrix, first, 6), first, envelope_offsets(first, 6), 6)


def test_a_ring_gets_a_narrow_band_and_a_chain_keeps_its_order() -> None:
    chain = np.eye(60, k=1, dtype=bool) | np.eye(60, k=-1, dtype=bool)
    np.testing.assert_array_equal(envelope_order(chain), np.arange(60))
    laps = chain.copy()
    for k in range(30):  # a second lap past the same places
        laps[k, k + 30] = laps[k + 30, k] = True
    order = envelope_order(laps)
    assert sorted(order) == list(range(60))
    widths = np.arange(60) - first_neighbors(laps[np.ix_(order, order)])
    assert widths.sum() < 0.3 * (np.arange(60) - first_neighbors(laps)).sum()


def test_small_systems_agree_with_numpy(rng: np.random.Generator) -> None:
    for n in (1, 3, 6, 7):
        matrix = rng.normal(size=(n, n))
        matrix, right_side = matrix @ matrix.T, rng.normal(size=n)
        x, solved = solve_symmetric(matrix, right_side, 0.01)
        assert solved
        np.testing.assert_allclose(x, np.linalg.solve(matrix + 0.01 * np.diag(np.diag(matrix)), right_side), rtol=1e-8)
        assert not solve_symmetric(np.zeros((n, n)), right_side, 0.01)[1]
