"""Kernels that between them use every form of the language of kernels."""

# ruff: noqa: B007

import math

import numpy as np

from codecbench.core.counting.kernel import kernel

OFFSET = 3
TABLE = np.array([5, 3, 8, 1, 9, 2, 7, 4])
SCALE = (2, 0.5)


@kernel
def clamped(value, low, high):
    return low if value < low else (high if value > high else value)


@kernel
def divided(value, by):
    """Two results."""
    quotient = value // by
    return quotient, value - quotient * by


@kernel
def arithmetic(a, b):
    total = 0.0
    for i in range(a.shape[0]):
        x, y = a[i], b[i]
        total += x * y - x / (y + 10) + -x + +y
        total -= (int(x) % 7) // 2 + abs(y - OFFSET) + 2 * 3
        bits = (i << 3) ^ (i >> 1) | (i & 5) & ~i
        a[i] += bits
        b[i] *= 2
        b[i] -= a[i] / 3
    return total


@kernel
def conditions(a, flags):
    found = 0
    for i in range(len(a)):
        x = a[i]
        if 0 < x < 5 <= OFFSET + i or (x == 7 and not flags[i]):
            found += 1
        elif flags[i] and (x > 3 or flags[i - 1] or x != 2):
            found += 2 if not (x < 4 and flags[i]) else x + 1
        else:
            found = found - 1 if flags[i] else found
        either = flags[i] or x > 6
        neither = not flags[i] and not x
        both = x and flags[i] and i
        if either and not neither:
            found += both & 1
        if x:
            found += 1
    return found


@kernel
def loops(a, limit):
    steps = 0
    i = 0
    while (i < limit and a[i] >= 0) or steps < 3:
        steps += 1
        if a[i] == 2:
            i += 1
            continue
        if steps > 40:
            break
        i += 1 + (a[i] & 1)
        if i >= limit:
            return -steps
    else:
        steps += 100
    n = limit
    while n:
        n >>= 1
        steps += 1
    while True:
        steps += 1
        if steps & 3 == 0:
            break
    for row in range(1, limit + 2, 3):
        for column in range(row):
            if column * row > 12:
                break
            steps += a[column] * row
        else:
            steps += 1
    return steps


@kernel
def indices(image, order, result):
    height, width = image.shape
    result[:] = 0
    result[0, 1:3] = 7
    for row in range(height - 1):
        line = image[row, :]
        other = image[row + 1, 1 : width - 1]
        for column in range(width - 2):
            result[row, column] = line[column] + other[column] * image[order[row * 2 % height], (column + 1) % width]
            result[row, column] += TABLE[(row + column) & 7]
            result[order[row], 0], result[row, 0] = result[row, 0], result[order[row], 0]
    swap = np.empty(height // 2 + 1, np.int64)
    counts = np.zeros((2, width), np.int64)
    ones = np.ones(width + 1)
    for i in range(swap.size):
        swap[i] = i
        counts[i & 1, min(i, width - 1)] += 1
    return swap, counts, ones


@kernel
def calls(a, b):
    total = 0.0
    for i in range(len(a)):
        quotient, rest = divided(a[i], 3)
        total += max(quotient, rest, 2) - min(quotient, rest)
        total += math.sqrt(b[i]) + np.floor(b[i]) * math.pi + round(b[i] * 3)
        total += clamped(int(b[i] * 10), 2, clamped(i, 1, 4)) if i > 1 and clamped(a[i], 0, 5) < 5 else np.float64(i)
        a[clamped(i + 1, 0, len(a) - 1)] += np.int64(rest)
    return total


@kernel
def nested_choices(a):
    total = 0
    for i in range(len(a)):
        x = a[i]
        total += (x + 1 if x > 2 and i else (x - 1 if x < 1 or i > 3 else x * 2)) * (2 if x & 1 else 3)
        total += max(x if x > 3 else 3, (i * 2 if i < 2 else i) + 1)
        a[i if i < 3 else 3 - 1] = total & 15
        small = 0 <= x < 3
        chain = 1 if 0 < x <= i < 9 else 0
        total += chain + (1 if small else -x)
    return total


@kernel
def nothing(a):
    """Returns nothing and may leave early."""
    for i in range(len(a)):
        if a[i] < 0:
            return
        a[i] = a[i] + 1


@kernel
def recursive(n):
    if n < 2:
        return n
    return recursive(n - 1) + recursive(n - 2)


@kernel
def loose_values(a: np.ndarray, start: int = 2) -> int:
    """Annotations, a default, several targets and tuples."""
    first: int = start
    last = middle = first + 1
    (first, middle), last = (middle, last), first
    for i in range(len(a)):
        pass
    return first * 100 + middle * 10 + last + i
