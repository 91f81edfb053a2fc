"""The range coder: round trips, and how close to the entropy it comes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codecbench.plugins.codecs.multilevel.arithmetic import UNWRITTEN, decode_symbols, encode_symbols


def coded(symbols: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    counts = np.bincount(symbols).astype(np.int64)
    out = np.empty(4 * len(symbols) + 16, np.uint8)
    size = encode_symbols(symbols, counts, np.empty(len(counts) + 1, np.int64), out)
    return out[:size].copy(), counts


def decoded(data: np.ndarray, counts: np.ndarray) -> tuple[int, np.ndarray]:
    symbols = np.empty(int(counts.sum()), np.int32)
    return decode_symbols(data, counts, np.empty(len(counts) + 1, np.int64), symbols), symbols


def packed(symbols: np.ndarray) -> np.ndarray:
    """The same with every symbol up to the largest in use."""
    return np.unique(symbols, return_inverse=True)[1].astype(np.int32)


@given(st.lists(st.integers(0, 40), min_size=1, max_size=300))
@settings(max_examples=150)
def test_symbols_come_back(values: list[int]) -> None:
    symbols = packed(np.array(values))
    data, counts = coded(symbols)
    read, back = decoded(data, counts)
    assert np.array_equal(back, symbols)
    assert read == len(data) + UNWRITTEN


@pytest.mark.parametrize("spread", [0.3, 3, 40, 4000])
@pytest.mark.parametrize("count", [102400, 307200])
def test_within_a_thousandth_of_the_entropy(rng: np.random.Generator, count: int, spread: float) -> None:
    symbols = packed(np.abs(rng.laplace(0, spread, count)).astype(np.int32))
    data, counts = coded(symbols)
    entropy = -(counts * np.log2(counts / count)).sum() / 8
    assert entropy - 1 < len(data) < entropy * 1.0005
    assert np.array_equal(decoded(data, counts)[1], symbols)


def test_carries_run_through_long_rows_of_ones(rng: np.random.Generator) -> None:
    # The last of two symbols, nearly always: the range creeps up to its top, where carries come from.
    for seed in range(40):
        symbols = (np.random.default_rng(seed).random(5000) > 0.0004).astype(np.int32)
        if symbols.min() == symbols.max():
            continue
        data, counts = coded(symbols)
        assert np.array_equal(decoded(data, counts)[1], symbols)


def test_one_symbol_takes_two_bytes() -> None:
    data, counts = coded(np.zeros(1000, np.int32))
    assert len(data) == 2
    assert np.array_equal(decoded(data, counts)[1], np.zeros(1000))


def test_more_symbols_than_the_lookup_has_places(rng: np.random.Generator) -> None:
    symbols = packed(rng.integers(0, 300_000, 400_000))
    data, counts = coded(symbols)
    assert np.array_equal(decoded(data, counts)[1], symbols)


def test_other_counts_are_noticed(rng: np.random.Generator) -> None:
    symbols = packed(rng.integers(0, 9, 3000))
    data, counts = coded(symbols)
    counts[0] += 5
    counts[1] -= 5
    assert decoded(data, counts)[0] < 0


def test_any_bytes_decode_or_are_refused(rng: np.random.Generator) -> None:
    for _ in range(300):
        counts = rng.integers(1, 50, rng.integers(1, 30)).astype(np.int64)
        read, symbols = decoded(rng.integers(0, 256, rng.integers(0, 200)).astype(np.uint8), counts)
        assert read < 0 or np.array_equal(np.bincount(symbols, minlength=len(counts)), counts)
