"""Blocks of neighbours: how long, and what is drawn."""

from __future__ import annotations

import numpy as np
import pytest

from codecbench.core.analysis.evidence import block_length, drawn_blocks, longest_block


def autoregressive(rng: np.random.Generator, count: int, memory: float) -> np.ndarray:
    """Values of variance 1 / (1 - memory^2) of which each keeps a share of the one before."""
    series = np.zeros(count + 100)
    for index, shock in enumerate(rng.normal(size=count + 100)[1:], start=1):
        series[index] = memory * series[index - 1] + shock
    return series[100:]


def test_what_resembles_its_neighbours_is_drawn_in_longer_blocks(rng: np.random.Generator) -> None:
    white, slow = rng.normal(size=400), autoregressive(rng, 400, 0.9)
    assert block_length(white) == 8  # the cube root of 400, rounded up
    assert 20 < block_length(slow) <= 60
    assert longest_block(np.array([white, slow])) == block_length(slow)
    assert [block_length(np.ones(count)) for count in (3, 7, 8, 27)] == [1, 1, 2, 3]
    assert longest_block(np.empty((0, 9))) == 1


@pytest.mark.parametrize(("count", "block"), [(10, 3), (9, 3), (4, 9), (5, 1)])
def test_blocks_are_runs_of_neighbours(rng: np.random.Generator, count: int, block: int) -> None:
    picks = drawn_blocks(rng, count, block)
    assert len(picks) == count
    assert 0 <= picks.min() <= picks.max() < count
    starts = np.arange(count) % min(block, count) == 0
    assert (np.diff(picks)[~starts[1:]] == 1).all()


def test_blocks_of_one_are_plain_draws() -> None:
    plain = np.random.default_rng(5).integers(0, 30, 30)
    np.testing.assert_array_equal(drawn_blocks(np.random.default_rng(5), 30, 1), plain)
