"""The trained prediction of an ORB descriptor's bits from the bits before them.

Tests of the pattern at neighboring places are correlated, whatever the image. `BIASES[j]` are approximate log odds of
bit j being 1 if all other bits are 0, in 1/UNIT; each bit k of an earlier block that is 1 adds `WEIGHTS[k, j]`. Bits of
one block do not predict each other, so a whole block is looked up at once. `train_prediction` makes the tables, so that
no sum leaves the range of `CHANCES`.
"""

from __future__ import annotations

from importlib import resources
from typing import Final

import numpy as np
from numpy.typing import NDArray

BITS: Final = 256
BLOCK: Final = 16
"""Number of bits predicted together, from all bits before them."""
UNIT: Final = 32
STEP_SHIFT: Final = 3
STEPS: Final = 256
"""Number of steps of log odds, each 2^STEP_SHIFT / UNIT; the lower half predicts 0."""
CLASSES: Final = 9
"""Number of classes of references by their rate of wrong bits so far; class 0 means no reference."""
LOWEST_CHANCE: Final = 24
FILE: Final = resources.files("codecbench.plugins.codecs.orb_features") / "prediction.npz"

_CLASS_LIMITS = np.array([6, 12, 20, 30, 44, 60, 80])


def _load_tables() -> tuple[NDArray[np.int8], NDArray[np.int16], NDArray[np.uint16]]:
    with resources.as_file(FILE) as file, np.load(file, allow_pickle=False) as arrays:
        weights = np.zeros((BITS, BITS), np.int8)
        weights[np.triu_indices(BITS, 1)] = arrays["weights"]
        return weights, arrays["biases"], arrays["chances"]


def _sum_by_nibble(weights: NDArray[np.int8]) -> NDArray[np.int8]:
    """Sum weights by nibble, (16 * BITS / 4, BITS): row 16 n + v is for the bits 4 n to 4 n + 3 with the value v."""
    values = np.unpackbits(np.arange(16, dtype=np.uint8)[:, None], axis=1, count=4, bitorder="little")
    sums = np.einsum("vk,nkj->nvj", values.astype(np.int16), weights.reshape(BITS // 4, 4, BITS).astype(np.int16))
    return np.ascontiguousarray(sums.reshape(-1, BITS).astype(np.int8))


def _chances_of_one(chances: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Return P(bit = 1) in 1/2^16 by class, reference's bit and predicted step, (CLASSES * 2 * STEPS,).

    chances: (CLASSES, STEPS): without a reference P(bit = 1); with one the probability that the bit differs, by the
    predicted step toward the reference's bit.
    """
    ones = np.stack([chances[:, ::-1], 65536 - chances.astype(np.int64)], axis=1).astype(np.uint16)
    ones[0] = chances[0]
    return ones.reshape(-1)


def class_of(differing: NDArray[np.int64], seen: NDArray[np.int64] | int) -> NDArray[np.int64]:
    """Return the class of a reference by its number of differing bits among those seen."""
    rate = (256 * differing + 256) // (np.asarray(seen) + 14)
    return 1 + np.asarray(np.searchsorted(_CLASS_LIMITS, rate, side="right"), np.int64)


WEIGHTS, BIASES, _CHANCES = _load_tables()
NIBBLES: Final = _sum_by_nibble(WEIGHTS)
CHANCES: Final = _chances_of_one(_CHANCES)
CLASS_STARTS: Final = 2 * STEPS * np.stack([class_of(np.arange(BITS), seen) for seen in range(0, BITS, BLOCK)])
"""(blocks, BITS): start of a reference's class in CHANCES, by block and number of wrong bits."""
