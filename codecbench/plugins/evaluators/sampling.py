"""Choose the frames that represent a sequence."""

from __future__ import annotations


def evenly_spread(length: int, count: int) -> list[int]:
    """Up to `count` frame indices: the middles of equal parts of 0..length-1."""
    count = min(length, count)
    return [int((position + 0.5) * length / count) for position in range(count)]
