"""The chain of levels: indices to ranks and tables, and back.

The scan `block` orders coefficients block after block, each in zigzag order; `coefficient` takes the DC of all blocks,
then the first AC of all blocks, and so on. Blocks of all planes follow one another.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.errors import ImageError, KeyCollision
from codecbench.core.counting.kernel import kernel
from codecbench.core.counting.trace import Trace
from codecbench.plugins.codecs.multilevel.header import MAX_SYMBOLS
from codecbench.plugins.codecs.multilevel.keys import Keys, is_super_increasing
from codecbench.plugins.codecs.multilevel.minimize import (
    expand,
    extremes,
    find_collision,
    find_distinct,
    gather_table,
    gather_tuples,
    minimise,
    replace_by_ranks,
    sort_order,
)

_FIRST_SLOTS = 1 << 16

KeyMaker = Callable[[int, int], Keys]
"""Returns the keys of a level, counted from 1, by its number of digits."""

Scan = Literal["block", "coefficient"]


@dataclass(frozen=True)
class LevelTable:
    """A level's distinct codes, sorted."""

    radix: int
    """Digits are 0..radix-1."""
    filler: int
    """Digit that pads the last group: that of a zero coefficient, or rank 0 above level 1."""
    keys: Keys
    codes: NDArray[np.int64]
    """(U,)."""
    counts: NDArray[np.int64]
    """(U,): occurrences of each code."""
    tuples: NDArray[np.int32]
    """(U, g): digits of each code."""


@dataclass(frozen=True)
class MinimizedIndices:
    """A sequence of indices as tables and ranks."""

    offset: int
    """Index of digit 0 at level 1."""
    tables: list[LevelTable]
    ranks: NDArray[np.int32]
    """(n,) of the last level."""


def minimize_levels(values: NDArray[np.int32], levels: int, make_keys: KeyMaker, trace: Trace) -> MinimizedIndices:
    """Minimize indices (n,) int32 level by level.

    Raises KeyCollision if two occurring tuples get the same code, ImageError for too many distinct ones.
    """
    with trace.stage("digits") as run:
        smallest, largest = (int(value) for value in run(extremes, values))
    _check_alphabet(largest - smallest + 1, "quantized values")
    tables: list[LevelTable] = []
    offset, radix = smallest, largest - smallest + 1
    for level in range(1, levels + 1):
        table, values = _minimize_level(values, offset, radix, make_keys(level, radix), level, trace)
        tables.append(table)
        offset, radix = 0, len(table.codes)
    return MinimizedIndices(smallest, tables, values)


def _check_alphabet(size: int, what: str) -> None:
    if size > MAX_SYMBOLS:
        raise ImageError(f"{size} different {what} are more than the {MAX_SYMBOLS} that fit: raise `qf`")


def _minimize_level(
    values: NDArray[np.int32], offset: int, radix: int, keys: Keys, level: int, trace: Trace
) -> tuple[LevelTable, NDArray[np.int32]]:
    group = len(keys)
    groups = -(-len(values) // group)
    filler = -offset
    codes = np.empty(groups, np.int64)
    with trace.stage("minimization") as run:
        run(minimise, values, offset, filler, keys, codes)
    numbers = np.empty(groups, np.int32)
    with trace.stage("table") as run:
        size, slots = -1, _FIRST_SLOTS
        while size < 0:
            distinct, counts = np.empty(slots // 2, np.int64), np.empty(slots // 2, np.int64)
            first = np.empty(slots // 2, np.int32)
            size = run(find_distinct, codes, np.zeros(slots, np.int32), distinct, counts, first, numbers)
            slots *= 4
        _check_alphabet(size, f"tuples at level {level}")
        order = np.empty(size, np.int32)
        run(sort_order, distinct[:size], order)
        table = LevelTable(
            radix,
            filler,
            keys,
            codes=np.empty(size, np.int64),
            counts=np.empty(size, np.int64),
            tuples=np.empty((size, group), np.int32),
        )
        rank_of = np.empty(size, np.int32)
        run(gather_table, order, distinct, counts, table.codes, table.counts, rank_of)
        run(gather_tuples, values, offset, filler, first, order, table.tuples)
        if not is_super_increasing(keys, radix):
            where = run(find_collision, values, offset, filler, group, first, numbers)
            if where >= 0:
                other = table.tuples[rank_of[numbers[where]]].tolist()
                _raise_collision(level, _group_at(values, offset, filler, group, where), other)
        run(replace_by_ranks, numbers, rank_of)
    return table, numbers


def _group_at(values: NDArray[np.int32], offset: int, filler: int, group: int, index: int) -> list[int]:
    digits = [int(value) - offset for value in values[index * group : (index + 1) * group]]
    return digits + [filler] * (group - len(digits))


def _raise_collision(level: int, first: list[int], second: list[int]) -> None:
    raise KeyCollision(
        f"level {level}: the digits {tuple(first)} and {tuple(second)} get the same code under these keys; "
        f"set other keys, or `keys: canonical`"
    )


def expand_levels(
    ranks: NDArray[np.int32], tuples: list[NDArray[np.int32]], offset: int, count: int, trace: Trace
) -> NDArray[np.int32]:
    """Expand ranks to (count,) int32 indices; `tuples` from level 1 up, every rank within its table."""
    group = tuples[0].shape[1]
    counts = [count]
    for _ in tuples[1:]:
        counts.append(-(-counts[-1] // group))
    for level in range(len(tuples) - 1, -1, -1):
        values = np.empty(counts[level], np.int32)
        with trace.stage("expansion") as run:
            run(expand, ranks, tuples[level], offset if level == 0 else 0, values)
        ranks = values
    return ranks


def scan_blocks(blocks: NDArray[np.int32], scan: Scan, trace: Trace) -> NDArray[np.int32]:
    """Order blocks (b, 64) of zigzag order as one sequence (64 b,); for `block` a view of them."""
    if scan == "block":
        return blocks.reshape(-1)
    values = np.empty((64, blocks.shape[0]), np.int32)
    with trace.stage("scan") as run:
        run(_transpose, blocks, values)
    return values.reshape(-1)


def unscan_blocks(values: NDArray[np.int32], scan: Scan, trace: Trace) -> NDArray[np.int32]:
    """Restore blocks (b, 64) in zigzag order from the sequence of `scan_blocks`."""
    if scan == "block":
        return values.reshape(-1, 64)
    blocks = np.empty((values.size // 64, 64), np.int32)
    with trace.stage("scan") as run:
        run(_transpose, values.reshape(64, -1), blocks)
    return blocks


@kernel
def _transpose(source: Any, target: Any) -> None:
    """Set target[j, i] = source[i, j], in tiles that fit the first-level cache."""
    rows, columns = source.shape
    for top in range(0, rows, 64):
        for left in range(0, columns, 64):
            for row in range(top, min(top + 64, rows)):
                for column in range(left, min(left + 64, columns)):
                    target[column, row] = source[row, column]
