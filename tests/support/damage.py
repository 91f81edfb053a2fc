"""Damaged copies of bitstreams, and what a decoder makes of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import numpy as np

from codecbench import BitstreamError, Codec


def damaged_copies(bitstreams: list[bytes], count: int, rng: np.random.Generator) -> Iterator[tuple[int, bytes]]:
    """`count` times the index of a bitstream and a copy of it that is cut, flipped, overwritten or shifted."""
    for number in range(count):
        index = number % len(bitstreams)
        copy = bytearray(bitstreams[index])
        place = int(rng.integers(len(copy)))
        kind = int(rng.integers(6))
        if kind == 0:
            del copy[place:]
        elif kind == 1:
            for _ in range(int(rng.integers(1, 4))):
                copy[int(rng.integers(len(copy)))] ^= 1 << int(rng.integers(8))
        elif kind == 2:
            for _ in range(int(rng.integers(1, 8))):
                copy[int(rng.integers(len(copy)))] = int(rng.integers(256))
        elif kind == 3:
            part = copy[place : place + int(rng.integers(1, 30))]
            copy[place : place + len(part)] = rng.bytes(len(part))
        elif kind == 4:
            del copy[place : place + int(rng.integers(1, 40))]
        else:
            copy[place:place] = copy[int(rng.integers(len(copy))) :][:20]
        yield index, bytes(copy)


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
