"""What the bits of an ORB descriptor say of those after them, and how sure that is.

Tests of the pattern that look at neighbouring places agree or disagree often, whatever the picture. `BIASES[j]` speaks
for bit j being 1 while all bits are 0, and each bit k of an earlier block that is 1 adds `WEIGHTS[k, j]`: log odds,
nearly, in 1/UNIT. Bits of one block say nothing of each other, so that all of it can be looked up at once.
`train_prediction` makes these, so that no sum of some of them leaves the range of `CHANCES`.
"""

from __future__ import annotations

from importlib import resources
from typing import Final

import numpy as np
from numpy.typing import NDArray

BITS: Final = 256
BLOCK: Final = 16
"""Bits that are predicted together, from all before them."""
UNIT: Final = 32
STEP_SHIFT: Final = 3
STEPS: Final = 256
"""How sure a prediction is, in steps of 2^STEP_SHIFT / UNIT; half of them speak for 0."""
CLASSES: Final = 9
"""Of references by how often they were wrong so far; 0 is without one."""
LOWEST_CHANCE: Final = 24
FILE: Final = resources.files("codecbench.plugins.codecs.orb_features") / "prediction.npz"

_CLASS_LIMITS = np.array([6, 12, 20, 30, 44, 60, 80])


def _stored() -> tuple[NDArray[np.int8], NDArray[np.int16], NDArray[np.uint16]]:
    with resources.as_file(FILE) as file, np.load(file, allow_pickle=False) as stored:
        weights = np.zeros((BITS, BITS), np.int8)
        weights[np.triu_indices(BITS, 1)] = stored["weights"]
        return weights, stored["biases"], stored["chances"]


def _by_nibble(weights: NDArray[np.int8]) -> NDArray[np.int8]:
    """(16 * BITS / 4, BITS): row 16 n + v is what the four bits 4 n, 4 n + 1, ... say together where they are v."""
    values = np.unpackbits(np.arange(16, dtype=np.uint8)[:, None], axis=1, count=4, bitorder="little")
    sums = np.einsum("vk,nkj->nvj", values.astype(np.int16), weights.reshape(BITS // 4, 4, BITS).astype(np.int16))
    return np.ascontiguousarray(sums.reshape(-1, BITS).astype(np.int8))


def _of_ones(chances: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """(CLASSES * 2 * STEPS,): P(bit = 1) in 1/2^16 by class, the reference's bit, and what is predicted.

    chances: (CLASSES, STEPS): without a reference, that; with one, that the bit differs, by how the prediction speaks
    for the reference's.
    """
    of_ones = np.stack([chances[:, ::-1], 65536 - chances.astype(np.int64)], axis=1).astype(np.uint16)
    of_ones[0] = chances[0]
    return of_ones.reshape(-1)


def class_of(differing: NDArray[np.int64], seen: NDArray[np.int64] | int) -> NDArray[np.int64]:
    """The class of a reference of which so many of the bits seen were wrong."""
    rate = (256 * differing + 256) // (np.asarray(seen) + 14)
    return 1 + np.asarray(np.searchsorted(_CLASS_LIMITS, rate, side="right"), np.int64)


WEIGHTS, BIASES, _CHANCES = _stored()
NIBBLES: Final = _by_nibble(WEIGHTS)
CHANCES: Final = _of_ones(_CHANCES)
CLASS_STARTS: Final = 2 * STEPS * np.stack([class_of(np.arange(BITS), seen) for seen in range(0, BITS, BLOCK)])
"""(blocks, BITS): where the class of a reference begins in CHANCES, by the block and the bits that were wrong."""
