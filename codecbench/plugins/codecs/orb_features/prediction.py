"""What the bits of an ORB descriptor say of those after them.

Tests of the pattern that look at neighbouring places agree or disagree often, whatever the picture. `BIASES[j]` speaks
for bit j being 1 while all bits are 0, and each bit k < j that is 1 adds `WEIGHTS[k, j]`: log odds, nearly, in 1/UNIT.
`train_prediction` makes them, so that no sum of some of them leaves 16 bits.
"""

from __future__ import annotations

from importlib import resources
from typing import Final

import numpy as np
from numpy.typing import NDArray

BITS: Final = 256
UNIT: Final = 1024
FILE: Final = resources.files("codecbench.plugins.codecs.orb_features") / "prediction.npz"


def _weights() -> tuple[NDArray[np.int16], NDArray[np.int16]]:
    with resources.as_file(FILE) as file, np.load(file, allow_pickle=False) as stored:
        weights = np.zeros((BITS, BITS), np.int16)
        weights[np.triu_indices(BITS, 1)] = stored["weights"]
        return weights, stored["biases"]


WEIGHTS, BIASES = _weights()
