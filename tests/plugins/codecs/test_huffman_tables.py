"""Huffman tables made for an image against the textbook's algorithm."""

from __future__ import annotations

import heapq
import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codecbench import BitstreamError
from codecbench.plugins.codecs.jpeg_qf.huffman_tables import (
    STANDARD_TABLES,
    HuffmanTable,
    encoding_tables,
    optimal_code,
    optimal_table,
)


def _run(kernel, *arguments):
    return kernel(*arguments)


def _textbook_cost(frequencies: list[int]) -> int:
    """Bits of Huffman's code, one symbol of frequency 1 reserved."""
    heap = [*(f for f in frequencies if f), 1]
    heapq.heapify(heap)
    cost = 0
    while len(heap) > 1:
        merged = heapq.heappop(heap) + heapq.heappop(heap)
        cost += merged
        heapq.heappush(heap, merged)
    return cost


def _lengths_by_symbol(table: HuffmanTable) -> dict[int, int]:
    lengths = [length for length, count in enumerate(table.lengths, 1) for _ in range(count)]
    return dict(zip(table.symbols, lengths, strict=True))


@settings(max_examples=60)
@given(st.dictionaries(st.integers(0, 255), st.integers(1, 10_000), min_size=1, max_size=60))
def test_cost_is_that_of_the_textbook(frequencies: dict[int, int]) -> None:
    counts = np.zeros(256, np.int64)
    counts[list(frequencies)] = list(frequencies.values())
    lengths = _lengths_by_symbol(optimal_table(counts, _run))
    assert set(lengths) == set(frequencies)
    cost = sum(counts[symbol] * length for symbol, length in lengths.items())
    longest = max(lengths.values())
    assert cost <= _textbook_cost(list(frequencies.values()))  # the reserved code takes the rest
    assert cost >= _textbook_cost(list(frequencies.values())) - longest or longest == 16


def test_codes_are_limited_to_16_bits_and_none_is_all_ones() -> None:
    counts = np.zeros(256, np.int64)
    counts[:40] = [int(1.6**k) + 1 for k in range(40)]
    table = optimal_table(counts, _run)
    assert sum(table.lengths) == 40
    kraft = sum(count / 2**length for length, count in enumerate(table.lengths, 1))
    assert kraft < 1
    codes = encoding_tables({(1, 0): table})
    for symbol, length in _lengths_by_symbol(table).items():
        assert codes.lengths[1, 0, symbol] == length
        assert codes.codes[1, 0, symbol] != (1 << length) - 1


def test_the_fast_build_is_the_python_source() -> None:
    rng = np.random.default_rng(3)
    frequencies = np.append(rng.integers(0, 50, 256), 1)
    results = []
    for function in (optimal_code, optimal_code.py_func):
        lengths, symbols = np.zeros(16, np.uint8), np.zeros(256, np.uint8)
        count = function(frequencies.copy(), lengths, symbols)
        results.append((count, lengths.tobytes(), symbols.tobytes()))
    assert results[0] == results[1]


@pytest.mark.parametrize("key", STANDARD_TABLES)
def test_codes_are_prefix_free(key: tuple[int, int]) -> None:
    tables = encoding_tables({key: STANDARD_TABLES[key]})
    lengths = _lengths_by_symbol(STANDARD_TABLES[key])
    words = sorted(f"{tables.codes[*key, symbol]:0{length}b}" for symbol, length in lengths.items())
    assert all(not longer.startswith(shorter) for shorter, longer in itertools.pairwise(words))


@pytest.mark.parametrize(
    ("lengths", "symbols"),
    [
        (bytes([3] + [0] * 15), b"abc"),
        (bytes([1] + [0] * 15), b"ab"),
        (bytes([1] * 15), b"a" * 15),
        (bytes([0, 2] + [0] * 14), b"aa"),
    ],
)
def test_impossible_tables_are_refused(lengths: bytes, symbols: bytes) -> None:
    with pytest.raises(BitstreamError):
        HuffmanTable(lengths, symbols)
