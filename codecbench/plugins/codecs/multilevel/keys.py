"""Keys, whether codes under them are unique, and the search for the tuple of a code.

Users give k in (0, 1); the arithmetic is exact in integers K = k * 2^p, since floating-point keys collide. Keys are
super-increasing if each exceeds the largest code of all smaller ones together: every tuple then has its own code, and
division recovers it. Codes are one-to-one, so all three search strategies of header-less decoding return the same
tuples.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.errors import ParamsError
from codecbench.core.counting.kernel import kernel

Keys = NDArray[np.int64]
AutomaticKeys = Literal["canonical", "random"]

MAX_CODE = (1 << 62) - 1
MANUAL_BITS = 30
MAX_CHECKS = 1 << 22
"""Most combinations of digit differences that `colliding_digits` tries."""

Search = Literal["sequential", "pruned", "greedy"]

MAX_SEQUENTIAL_TESTS = 1 << 36
"""Limit of the exhaustive search, a minute or two."""

FREE_PRUNED_TESTS = 1 << 24
PRUNED_TESTS_PER_BYTE = 1 << 17
"""Limit of the pruned search per byte of the table, beyond the free tests."""


def canonical_keys(radix: int, group: int) -> list[int]:
    """Return 1, R, R^2, ...: the smallest super-increasing keys for digits 0..R-1."""
    return [radix**place for place in range(group)]


def random_keys(radix: int, group: int, rng: np.random.Generator) -> list[int]:
    """Draw super-increasing keys, each up to twice as large as necessary."""
    keys: list[int] = []
    for _ in range(group):
        smallest = (radix - 1) * sum(keys) + 1
        keys.append(smallest + int(smallest * rng.random()))
    return keys


def manual_keys(fractions: Iterable[float]) -> list[int]:
    """Return round(k * 2^30) for keys k in (0, 1)."""
    return [max(round(fraction * 2**MANUAL_BITS), 1) for fraction in fractions]


def check_keys(keys: list[int], radix: int, level: int) -> Keys:
    """Return the keys as an array. Raises ParamsError if a code could exceed 62 bits."""
    largest = sum(keys) * (radix - 1)
    if largest > MAX_CODE:
        raise ParamsError(
            f"level {level}: codes of {len(keys)} digits in 0..{radix - 1} need {largest.bit_length()} bits, "
            f"at most 62 fit: lower `group` or `levels`, or raise `qf`"
        )
    return np.array(keys, dtype=np.int64)


def is_super_increasing(keys: Keys, radix: int) -> bool:
    """Whether each key exceeds every code of the smaller keys, in any order."""
    reach = 0
    for key in sorted(keys.tolist()):
        if key <= reach:
            return False
        reach += key * (radix - 1)
    return True


def colliding_digits(keys: Keys, radix: int) -> tuple[tuple[int, ...], tuple[int, ...]] | None:
    """Return two tuples of digits 0..radix-1 with the same code, or None if all codes differ.

    Meet in the middle: for every combination of differences of all digits but two, Bezout's identity gives the two that
    solve the remaining equation. Raises ParamsError beyond MAX_CHECKS combinations.
    """
    if is_super_increasing(keys, radix):
        return None
    free = len(keys) - 2
    if (2 * radix - 1) ** free > MAX_CHECKS:
        raise ParamsError(
            f"cannot check whether {len(keys)} keys are one-to-one for digits 0..{radix - 1}: too many tuples; "
            f"set `keys: canonical` or `decoding: header`"
        )
    differences = np.zeros(len(keys), dtype=np.int64)
    divisor, inverse = _bezout(int(keys[0]), int(keys[1]))
    if not find_difference(keys, radix, divisor, inverse, differences):
        return None
    first = tuple(max(int(d), 0) for d in differences)
    second = tuple(max(-int(d), 0) for d in differences)
    return first, second


def _bezout(a: int, b: int) -> tuple[int, int]:
    """Return gcd(a, b), and the inverse of a / gcd modulo b / gcd."""
    divisor = int(np.gcd(a, b))
    modulus = b // divisor
    return divisor, pow(a // divisor, -1, modulus) if modulus > 1 else 0


@kernel
def find_difference(keys: Any, radix: Any, divisor: Any, inverse: Any, differences: Any) -> Any:
    """Find digit differences in -(R-1)..R-1, not all zero, that do not change the code; returns whether there are any.

    keys: (g,) int64, each at most 2^30. divisor: gcd of the first two keys; inverse: of keys[0] / divisor
    modulo keys[1] / divisor. differences: (g,) int64, filled if True is returned.
    """
    group = keys.shape[0]
    reach = radix - 1
    step_0 = keys[1] // divisor
    step_1 = keys[0] // divisor
    for j in range(2, group):
        differences[j] = -reach
    while True:
        # All solutions of keys[0] * first + keys[1] * second = rest are (first + t * step_0, second - t * step_1);
        # the one tried has the smallest `first` for which both lie in -(R-1) or above and below R.
        rest = np.int64(0)
        zero = True
        for j in range(2, group):
            rest -= keys[j] * differences[j]
            zero = zero and differences[j] == 0
        if rest % divisor == 0:
            start = ((rest // divisor) % step_0) * inverse % step_0
            first = start - (start + reach) // step_0 * step_0
            second = (rest - keys[0] * first) // keys[1]
            if second > reach:
                skipped = (second - reach + step_1 - 1) // step_1
                first += skipped * step_0
                second -= skipped * step_1
            if zero and first == 0 and second == 0:
                first += step_0
                second -= step_1
            if first <= reach and second >= -reach:
                differences[0] = first
                differences[1] = second
                return True
        j = 2
        while j < group and differences[j] == reach:
            differences[j] = -reach
            j += 1
        if j >= group:
            return False
        differences[j] += 1


@kernel
def sequential_search(codes: Any, keys: Any, radix: Any, tuples: Any) -> Any:
    """Try all R^g tuples in turn for every code, as the paper does; returns whether every code has a tuple.

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
    """Try the digits of all keys but the smallest, within the bounds of the smaller keys; divide by the smallest.

    order: (g,) int64, positions of the keys from the smallest to the largest. The rest is as in `sequential_search`.
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
    """Divide by one key after another, the largest first; correct for super-increasing keys only."""
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
