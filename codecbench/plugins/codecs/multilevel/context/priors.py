"""What a coder knows before it has seen anything: statistics of other pictures, in `priors.npz`.

Made by `docs/context_training.py` from photographs that scikit-image brings and rendered frames, luma and chroma apart.
"""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from codecbench.plugins.codecs.multilevel.context.binary import SEEN_BITS, probabilities_from_odds

FILE = Path(__file__).with_name("priors.npz")
"""For luma and chroma: odds (2, contexts) int8, in 1/16; seen (2, contexts) uint8, how many bits a prior is worth;
weights (2, sets, 3) int32."""


def new_statistics(chroma: bool) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """A model and weights for a coder, as `binary` has them, that have seen nothing of the picture yet."""
    model, weights = _priors()
    return model[int(chroma)].copy(), weights[int(chroma)].copy()


@functools.cache
def _priors() -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    with np.load(FILE) as file:
        odds, seen, weights = (file[name] for name in ("odds", "seen", "weights"))
    states = (probabilities_from_odds(odds.astype(np.int64)) << SEEN_BITS) | seen
    return states.astype(np.int32), weights
