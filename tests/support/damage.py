"""Damaged copies of bitstreams, and what a decoder makes of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import numpy as np

from codecbench import BitstreamError, Codec
from codecbench.core.conformance.damage import mutations


def damaged_copies(bitstreams: list[bytes], count: int, rng: np.random.Generator) -> Iterator[tuple[int, bytes]]:
    """`count` times the index of a bitstream and a copy of it: cut, or damaged as `codecbench verify` does it."""
    for index, bitstream in enumerate(bitstreams):
        copies = len(range(index, count, len(bitstreams)))
        for length in rng.integers(len(bitstream), size=copies // 6):
            yield index, bitstream[:length]
        for _, copy in mutations(bitstream, rng, copies - copies // 6, ""):
            yield index, copy


def outcomes(codec: Codec, bitstreams: list[bytes], count: int, seed: int) -> Counter[str]:
    """How many damaged copies were refused, decoded to what they were copies of, or decoded to something else."""
    decoded = [codec.decode(bitstream) for bitstream in bitstreams]
    found: Counter[str] = Counter()
    for index, copy in damaged_copies(bitstreams, count, np.random.default_rng(seed)):
        try:
            pixels = codec.decode(copy)
        except BitstreamError:
            found["refused"] += 1
        else:
            same = copy == bitstreams[index] or np.array_equal(pixels, decoded[index])
            found["same" if same else "changed"] += 1
    return found
