"""Hamming distance of binary descriptors, inside compiled code."""

from __future__ import annotations

from typing import Any

import numpy as np

from codecbench.core.kernels.compiled import compiled


@compiled
def count_bits(word: Any) -> Any:
    """Return the number of bits set in a uint64; the compiler makes this loop one processor instruction."""
    count = np.uint64(0)
    while word != np.uint64(0):
        word &= word - np.uint64(1)
        count += np.uint64(1)
    return count


@compiled(inline="always")
def hamming(descriptors_a: Any, i: int, descriptors_b: Any, j: int) -> int:
    """Return the number of bits that differ between `descriptors_a[i]` (N, 4) and `descriptors_b[j]` (M, 4), uint64."""
    return int(
        count_bits(descriptors_a[i, 0] ^ descriptors_b[j, 0])
        + count_bits(descriptors_a[i, 1] ^ descriptors_b[j, 1])
        + count_bits(descriptors_a[i, 2] ^ descriptors_b[j, 2])
        + count_bits(descriptors_a[i, 3] ^ descriptors_b[j, 3])
    )
