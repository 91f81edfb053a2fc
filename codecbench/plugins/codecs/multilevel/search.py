"""Header-less decoding: the tuple of every code is found again by search under the same keys.

All three strategies return the same tuples, because codes are one-to-one.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np

from codecbench.core.counting.kernel import kernel

Search = Literal["sequential", "pruned", "greedy"]

MAX_SEQUENTIAL_TESTS = 1 << 36
"""A minute or two: beyond it the exhaustive search is refused."""

FREE_PRUNED_TESTS = 1 << 24
PRUNED_TESTS_PER_BYTE = 1 << 17
"""What a bitstream may ask of the pruned search, by the size of its table."""


@kernel
def sequential_search(codes: Any, keys: Any, radix: Any, tuples: Any) -> Any:
    """Try all R^g tuples in turn for every code, as the paper does; whether every code has a tuple.

    codes: (U,) int64. keys: (g,) int64. radix: digits are 0..radix-1. tuples: (U, g) int32, filled.
    """
    group = keys.shape[0]
    digits = np.zeros(group, np.int64)
    for row in range(codes.shape[0]):
        for j in range(group):
            digits[j] = 0
        trial = np.int64(0)
        while trial != codes[row]:
            j = 0
            while j < group and digits[j] == radix - 1:
                trial -= keys[j] * digits[j]
                digits[j] = 0
                j += 1
            if j == group:
                return False
            digits[j] += 1
            trial += keys[j]
        for j in range(group):
            tuples[row, j] = digits[j]
    return True


@kernel
def pruned_search(codes: Any, keys: Any, order: Any, radix: Any, tuples: Any) -> Any:
    """Try the digits of all keys but the smallest, within the bounds that the smaller keys leave; divide for it.

    order: (g,) int64, positions of the keys from the smallest to the largest. The rest as above.
    """
    group = keys.shape[0]
    reach = np.zeros(group + 1, np.int64)
    for place in range(group):
        reach[place + 1] = reach[place] + keys[order[place]] * (radix - 1)
    rests = np.empty(group, np.int64)
    digits = np.zeros(group, np.int64)
    for row in range(codes.shape[0]):
        place = group - 1
        rests[place] = codes[row]
        digits[place] = _highest_digit(rests[place], keys[order[place]], radix)
        while True:
            rest = rests[place] - keys[order[place]] * digits[place]
            if digits[place] < 0 or rest > reach[place]:
                # This digit, and every smaller one, leaves more than the smaller keys can reach: one place up.
                place += 1
                if place >= group:
                    return False
                digits[place] -= 1
            elif place == 0:
                break
            else:
                place -= 1
                rests[place] = rest
                digits[place] = _highest_digit(rest, keys[order[place]], radix)
        for j in range(group):
            tuples[row, order[j]] = digits[j]
    return True


@kernel
def _highest_digit(rest: Any, key: Any, radix: Any) -> Any:
    return min(rest // key, radix - 1)


@kernel
def greedy_search(codes: Any, keys: Any, order: Any, radix: Any, tuples: Any) -> Any:
    """Divide by one key after another, the largest first: right for super-increasing keys only."""
    group = keys.shape[0]
    for row in range(codes.shape[0]):
        rest = codes[row]
        for place in range(group - 1, -1, -1):
            j = order[place]
            digit = _highest_digit(rest, keys[j], radix)
            rest -= digit * keys[j]
            tuples[row, j] = digit
        if rest != 0:
            return False
    return True
