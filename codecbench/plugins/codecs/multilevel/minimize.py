"""Minimization: groups of digits become codes, codes become ranks in the table of distinct codes.

y = K_1 v_1 + ... + K_g v_g over consecutive groups of g digits (Salih & Vasarhelyi, figures 3 and 4); the last group is
padded. The table lists every y that occurs, once and sorted; the stream becomes ranks in it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from codecbench.core.counting.kernel import kernel

_RADIX_BITS = 11
_RADIX = 1 << _RADIX_BITS


@kernel
def extremes(values: Any) -> Any:
    """Return the smallest and largest of 0 and all values (n,) int32."""
    smallest = np.int32(0)
    largest = np.int32(0)
    for i in range(values.shape[0]):
        smallest = min(smallest, values[i])
        largest = max(largest, values[i])
    return smallest, largest


@kernel
def minimise(values: Any, offset: Any, filler: Any, keys: Any, codes: Any) -> None:
    """Compute the code of each group: the sum of key times digit, with digit = value - offset.

    values: (n,) int32. filler: digit that pads the last group. keys: (g,) int64. codes: (ceil n/g,) int64, filled. The
    caller ensures that no code exceeds 62 bits.
    """
    group = keys.shape[0]
    start = np.int64(0)
    for j in range(group):
        start -= keys[j] * offset
    full = values.shape[0] // group
    if group == 3:
        _minimise_threes(values, start, keys, codes[:full])
    else:
        for i in range(full):
            code = start
            for j in range(group):
                code += keys[j] * values[i * group + j]
            codes[i] = code
    if full < codes.shape[0]:
        code = np.int64(0)
        for j in range(group):
            code += keys[j] * _digit(values, full * group + j, offset, filler)
        codes[full] = code


@kernel
def _minimise_threes(values: Any, start: Any, keys: Any, codes: Any) -> None:
    """Minimize groups of three without an inner loop, three times as fast."""
    key_0, key_1, key_2 = keys[0], keys[1], keys[2]
    for i in range(codes.shape[0]):
        codes[i] = start + key_0 * values[3 * i] + key_1 * values[3 * i + 1] + key_2 * values[3 * i + 2]


@kernel
def _digit(values: Any, position: Any, offset: Any, filler: Any) -> Any:
    if position < values.shape[0]:
        return np.int64(values[position]) - offset
    return np.int64(filler)


@kernel
def find_distinct(codes: Any, slots: Any, distinct: Any, counts: Any, first: Any, numbers: Any) -> Any:
    """Number the distinct codes in order of appearance, with a hash table of open addressing.

    codes: (n,) int64, non-negative. slots: (2^k,) int32, all zero. distinct, counts: int64, and first: int32, each
    (2^(k-1),): the u-th new code, its occurrences, its first position. numbers: (n,) int32, the u of codes[i].
    Returns the number of distinct codes, or -1 if the slots would be over half full.
    """
    mask = slots.shape[0] - 1
    count = 0
    previous = np.int64(-1)
    number = 0
    for i in range(codes.shape[0]):
        code = codes[i]
        if code != previous:
            slot = ((((code ^ (code >> 31)) & 0x7FFFFFFF) * 0x9E3779B1) >> 20) & mask
            while slots[slot] > 0 and distinct[slots[slot] - 1] != code:
                slot = (slot + 1) & mask
            if slots[slot] == 0:
                if count == distinct.shape[0]:
                    return -1
                distinct[count] = code
                counts[count] = 0
                first[count] = i
                count += 1
                slots[slot] = count
            number = slots[slot] - 1
            previous = code
        counts[number] += 1
        numbers[i] = number
    return count


@kernel
def sort_order(codes: Any, order: Any) -> None:
    """Fill order (m,) int32 with the positions of codes (m,) int64, non-negative, from smallest to largest.

    This is a least-significant-digit radix sort.
    """
    count = codes.shape[0]
    largest = np.int64(0)
    for i in range(count):
        largest = max(largest, codes[i])
        order[i] = i
    moved = np.empty(count, np.int32)
    starts = np.empty(_RADIX + 1, np.int64)
    shift = 0
    while (largest >> shift) > 0:
        for digit in range(_RADIX + 1):
            starts[digit] = 0
        for i in range(count):
            starts[((codes[i] >> shift) & (_RADIX - 1)) + 1] += 1
        for digit in range(_RADIX):
            starts[digit + 1] += starts[digit]
        for i in range(count):
            digit = (codes[order[i]] >> shift) & (_RADIX - 1)
            moved[starts[digit]] = order[i]
            starts[digit] += 1
        for i in range(count):
            order[i] = moved[i]
        shift += _RADIX_BITS


@kernel
def gather_table(order: Any, distinct: Any, counts: Any, table_codes: Any, table_counts: Any, rank_of: Any) -> None:
    """Sort the table: codes and counts by rank, and the rank of every number. All are (m,)."""
    for rank in range(order.shape[0]):
        number = order[rank]
        table_codes[rank] = distinct[number]
        table_counts[rank] = counts[number]
        rank_of[number] = rank


@kernel
def gather_tuples(values: Any, offset: Any, filler: Any, first: Any, order: Any, tuples: Any) -> None:
    """Collect the digits of each code's first group. tuples: (m, g) int32, filled."""
    group = tuples.shape[1]
    for rank in range(order.shape[0]):
        start = np.int64(first[order[rank]]) * group
        for j in range(group):
            tuples[rank, j] = _digit(values, start + j, offset, filler)


@kernel
def replace_by_ranks(numbers: Any, rank_of: Any) -> None:
    """Replace numbers (n,) int32 by ranks, in place."""
    for i in range(numbers.shape[0]):
        numbers[i] = rank_of[numbers[i]]


@kernel
def find_collision(values: Any, offset: Any, filler: Any, group: Any, first: Any, numbers: Any) -> Any:
    """Return the first group whose digits differ from those of the first group with its code, or -1."""
    for i in range(numbers.shape[0]):
        start = np.int64(first[numbers[i]]) * group
        for j in range(group):
            digit = _digit(values, i * group + j, offset, filler)
            if digit != _digit(values, start + j, offset, filler):
                return i
    return -1


@kernel
def expand(ranks: Any, tuples: Any, offset: Any, values: Any) -> None:
    """Expand ranks to digits plus `offset`, without the padding of the last group.

    ranks: (ceil n/g,) int32 in 0..m-1. tuples: (m, g) int32. values: (n,) int32, filled.
    """
    group = tuples.shape[1]
    count = values.shape[0]
    full = count // group
    if group == 3:
        _expand_threes(ranks[:full], tuples, offset, values)
    else:
        for i in range(full):
            for j in range(group):
                values[i * group + j] = tuples[ranks[i], j] + offset
    for position in range(full * group, count):
        values[position] = tuples[ranks[full], position - full * group] + offset


@kernel
def _expand_threes(ranks: Any, tuples: Any, offset: Any, values: Any) -> None:
    for i in range(ranks.shape[0]):
        rank = ranks[i]
        values[3 * i] = tuples[rank, 0] + offset
        values[3 * i + 1] = tuples[rank, 1] + offset
        values[3 * i + 2] = tuples[rank, 2] + offset
