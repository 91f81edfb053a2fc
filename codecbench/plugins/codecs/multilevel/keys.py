"""Keys: what they are, and whether codes under them can be told apart.

The user sees k in (0, 1); the arithmetic is exact in integers K = k * 2^p, since floating-point keys collide.
Keys are super-increasing when each exceeds the largest code of all smaller ones together: every tuple then has
its own code and is found by division.
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
"""Combinations of digit differences that `colliding_digits` tries before it gives up."""


def canonical_keys(radix: int, group: int) -> list[int]:
    """1, R, R^2, ...: the smallest super-increasing keys for digits 0..R-1."""
    return [radix**place for place in range(group)]


def random_keys(radix: int, group: int, rng: np.random.Generator) -> list[int]:
    """Super-increasing keys, each up to twice as large as it has to be."""
    keys: list[int] = []
    for _ in range(group):
        smallest = (radix - 1) * sum(keys) + 1
        keys.append(smallest + int(smallest * rng.random()))
    return keys


def manual_keys(fractions: Iterable[float]) -> list[int]:
    """round(k * 2^30) for keys k in (0, 1)."""
    return [max(round(fraction * 2**MANUAL_BITS), 1) for fraction in fractions]


def checked(keys: list[int], radix: int, level: int) -> Keys:
    """The keys as an array. Raises ParamsError where a code could exceed 62 bits."""
    largest = sum(keys) * (radix - 1)
    if largest > MAX_CODE:
        raise ParamsError(
            f"level {level}: codes of {len(keys)} digits in 0..{radix - 1} need {largest.bit_length()} bits, "
            f"at most 62 fit: lower `group` or `levels`, or raise `qf`"
        )
    return np.array(keys, dtype=np.int64)


def is_super_increasing(keys: Keys, radix: int) -> bool:
    """Whether each key exceeds every code of the smaller keys, in whatever order they stand."""
    reach = 0
    for key in sorted(keys.tolist()):
        if key <= reach:
            return False
        reach += key * (radix - 1)
    return True


def colliding_digits(keys: Keys, radix: int) -> tuple[tuple[int, ...], tuple[int, ...]] | None:
    """Two tuples of digits 0..radix-1 with the same code, or None where all codes differ.

    Meet in the middle: every combination of differences of all digits but two is met by the two that solve
    the remaining equation, found by Bezout's identity. Raises ParamsError beyond MAX_CHECKS combinations.
    """
    if is_super_increasing(keys, radix):
        return None
    free = len(keys) - 2
    if (2 * radix - 1) ** free > MAX_CHECKS:
        raise ParamsError(
            f"cannot tell whether {len(keys)} keys are one-to-one for digits 0..{radix - 1}: too many tuples; "
            f"take `keys: canonical` or `decoding: header`"
        )
    differences = np.zeros(len(keys), dtype=np.int64)
    divisor, inverse = _bezout(int(keys[0]), int(keys[1]))
    if not find_difference(keys, radix, divisor, inverse, differences):
        return None
    first = tuple(max(int(d), 0) for d in differences)
    second = tuple(max(-int(d), 0) for d in differences)
    return first, second


def _bezout(a: int, b: int) -> tuple[int, int]:
    """gcd(a, b), and the inverse of a / gcd modulo b / gcd."""
    divisor = int(np.gcd(a, b))
    modulus = b // divisor
    return divisor, pow(a // divisor, -1, modulus) if modulus > 1 else 0


@kernel
def find_difference(keys: Any, radix: Any, divisor: Any, inverse: Any, differences: Any) -> Any:
    """Digit differences in -(R-1)..R-1, not all zero, that leave the code as it is; whether there are any.

    keys: (g,) int64, each at most 2^30. divisor: gcd of the first two keys; inverse: of keys[0] / divisor
    modulo keys[1] / divisor. differences: (g,) int64, filled where True is returned.
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
