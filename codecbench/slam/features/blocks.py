"""Loops over rows of pixels in whole vectors, without a slow rest."""

from __future__ import annotations

from codecbench.core.kernels.compiled import compiled

_BLOCK = 32  # pixels of 8 bits that a vector holds, or a divisor of it


@compiled
def spans(first: int, last: int) -> tuple[tuple[int, int], tuple[int, int]]:
    """Two spans of pixels, start and end, that cover first..last - 1 in whole blocks, the second over some of the first
    again; where there is no whole block, the first span is all."""
    whole = first + (last - first) // _BLOCK * _BLOCK
    if whole in (first, last):
        return (first, last), (last, last)
    return (first, whole), (last - _BLOCK, last)
