"""Minimisation against plain Python and numpy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from codecbench.core.contracts.errors import ImageError, KeyCollision
from codecbench.core.counting.trace import NULL_TRACE
from codecbench.plugins.codecs.multilevel import levels as levels_module
from codecbench.plugins.codecs.multilevel.keys import canonical_keys, check_keys, manual_keys, random_keys
from codecbench.plugins.codecs.multilevel.levels import expand_levels, minimize_levels, scan_blocks, unscan_blocks
from codecbench.plugins.codecs.multilevel.minimize import extremes, find_distinct, minimise, sort_order


def canonical(group: int):  # type: ignore[no-untyped-def]
    return lambda level, radix: check_keys(canonical_keys(radix, group), radix, level)


@given(st.lists(st.integers(-60, 60), min_size=1, max_size=200), st.integers(2, 5), st.integers(1, 4))
@settings(max_examples=150)
def test_levels_come_back(values: list[int], group: int, levels: int) -> None:
    indices = np.array(values, np.int32)
    result = minimize_levels(indices, levels, canonical(group), NULL_TRACE)
    tuples = [table.tuples for table in result.tables]
    assert np.array_equal(expand_levels(result.ranks, tuples, result.offset, len(indices), NULL_TRACE), indices)
    count = len(values)
    for _ in range(levels):
        count = -(-count // group)
    assert len(result.ranks) == count
    assert result.tables[-1].counts.sum() == len(result.ranks)
    for table in result.tables:
        assert np.all(np.diff(table.codes) > 0)
        assert np.array_equal(table.tuples.astype(np.int64) @ table.keys, table.codes)


@pytest.mark.parametrize("group", [2, 3, 4])
def test_codes_are_sums_of_key_times_digit(rng: np.random.Generator, group: int) -> None:
    values = rng.integers(-9, 12, 100, dtype=np.int32)
    smallest, largest = extremes(values)
    assert (smallest, largest) == (values.min(), values.max())
    keys = np.array(random_keys(21, group, rng), np.int64)
    codes = np.empty(-(-100 // group), np.int64)
    minimise(values, smallest, -smallest, keys, codes)
    filled = np.concatenate([values, np.zeros(-100 % group, np.int32)])
    assert np.array_equal(codes, (filled - smallest).reshape(-1, group) @ keys)


def test_zero_is_always_a_digit() -> None:
    assert extremes(np.array([4, 7], np.int32)) == (0, 7)
    assert extremes(np.array([-4, -7], np.int32)) == (-7, 0)


def test_distinct_codes_are_numpys(rng: np.random.Generator) -> None:
    codes = (rng.integers(0, 900, 5000) ** 3).astype(np.int64) * 1_000_003
    distinct, counts = np.empty(2048, np.int64), np.empty(2048, np.int64)
    first, numbers = np.empty(2048, np.int32), np.empty(5000, np.int32)
    found = find_distinct(codes, np.zeros(4096, np.int32), distinct, counts, first, numbers)
    order = np.empty(found, np.int32)
    sort_order(distinct[:found], order)
    expected, places, sums = np.unique(codes, return_index=True, return_counts=True)
    assert np.array_equal(distinct[order], expected)
    assert np.array_equal(counts[order], sums)
    assert np.array_equal(first[order], places)
    assert np.array_equal(distinct[numbers], codes)


def test_a_full_hash_table_is_made_larger(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    values = rng.integers(-500, 500, 3000, dtype=np.int32)
    expected = minimize_levels(values, 2, canonical(3), NULL_TRACE)
    monkeypatch.setattr(levels_module, "_FIRST_SLOTS", 4)
    result = minimize_levels(values, 2, canonical(3), NULL_TRACE)
    assert np.array_equal(result.ranks, expected.ranks)
    assert np.array_equal(result.tables[0].codes, expected.tables[0].codes)


def test_colliding_keys_are_refused_with_the_tuples() -> None:
    def make(level: int, radix: int) -> np.ndarray:
        return check_keys(manual_keys([0.25, 0.5, 0.75]), radix, level)

    values = np.array([2, 1, 0, 0, 2, 0, 1, 0, 1], np.int32)  # 1.0, 1.0 and 1.0 quarters of four
    with pytest.raises(KeyCollision, match=r"^level 1: .*\(0, 2, 0\) and \(2, 1, 0\)"):
        minimize_levels(values, 1, make, NULL_TRACE)


def test_too_many_tuples_are_refused(rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(levels_module, "MAX_SYMBOLS", 100)
    with pytest.raises(ImageError, match="tuples at level 1"):
        minimize_levels(rng.integers(-40, 40, 3000, dtype=np.int32), 1, canonical(3), NULL_TRACE)


@pytest.mark.parametrize("scan", ["block", "coefficient"])
def test_scans_come_back(rng: np.random.Generator, scan) -> None:  # type: ignore[no-untyped-def]
    blocks = rng.integers(-9, 9, (131, 64), dtype=np.int32)
    values = scan_blocks(blocks, scan, NULL_TRACE)
    assert np.array_equal(values, (blocks if scan == "block" else blocks.T).reshape(-1))
    assert np.array_equal(unscan_blocks(values, scan, NULL_TRACE), blocks)
