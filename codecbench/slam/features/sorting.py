"""Counting sort of small integers, for compiled code."""

from __future__ import annotations

import numpy as np

from codecbench.core.kernels.compiled import compiled


@compiled
def stable_order(keys, key_count):  # type: ignore[no-untyped-def]
    """Return the stable order (M,) that sorts integer keys in 0..key_count - 1, by counting."""
    starts = np.zeros(key_count + 1, dtype=np.int64)
    for i in range(keys.shape[0]):
        starts[keys[i] + 1] += 1
    for k in range(key_count):
        starts[k + 1] += starts[k]
    out = np.empty(keys.shape[0], dtype=np.int64)
    for i in range(keys.shape[0]):
        out[starts[keys[i]]] = i
        starts[keys[i]] += 1
    return out
