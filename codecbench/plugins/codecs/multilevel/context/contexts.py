"""Contexts of a block's decisions: offsets of each kind, the classes that they consist of, and their initial state.

`docs/context_training.py` makes `priors.npz`, the initial state, from photographs of scikit-image and rendered frames,
luma and chroma apart.
"""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from codecbench.core.counting.kernel import kernel
from codecbench.plugins.codecs.dct.tables import ZIGZAG
from codecbench.plugins.codecs.multilevel.context.binary import SEEN_BITS, probabilities_from_odds

PRIORS_FILE = Path(__file__).with_name("priors.npz")
"""For luma and chroma: odds (2, contexts) int8, in 1/16; seen (2, contexts) uint8, the weight of a prior in bits;
weights (2, sets, 3) int32."""

INNER = np.array([place for place in ZIGZAG.tolist() if place % 8 and place // 8], np.int32)
"""The 49 places of the inner part, in zigzag order."""
ZONES = np.array([0] * 3 + [1] * 7 + [2] * 15 + [3] * 24, np.int32)
"""Zone of frequency of the inner part's places, by rank."""
MAX_INDEX = (1 << 17) - 1
DC_RESIDUAL = 3
"""Column of |DC residual| in the counts of a block, after the nonzero counts inside, in the first row and column."""


def classes(limits: tuple[int, ...], size: int) -> NDArray[np.int32]:
    """Return the class of each number below `size`: how many limits it reaches."""
    return np.searchsorted(np.array(limits), np.arange(size), side="right").astype(np.int32)


_LAST_MAGNITUDE = 63
_MAGNITUDES = classes((1, 2, 3, 5, 7, 10, 15, 23, 41), 1 + _LAST_MAGNITUDE)

SHARES = np.array([[min(12 * missing // (49 - rank), 11) for rank in range(49)] for missing in range(50)], np.int32)
"""Share of nonzero places from a rank on, in twelfths, by the number of nonzero indices left and the rank."""

# First context of each decision.
LENGTH = 0
LENGTH_BITS = LENGTH + 800 + 240 + 240
INNER_FLAGS = LENGTH_BITS + 64
INNER_SIZES = INNER_FLAGS + 49 * 12 + 49 * 100 + 600
EDGE_COUNTS = INNER_SIZES + 15 * 670
EDGE_FLAGS = EDGE_COUNTS + 2400 + 1920 + 1280
EDGE_SIGNS = EDGE_FLAGS + 1280 + 1280 + 800
EDGE_SIZES = EDGE_SIGNS + 160
DC_FLAGS = EDGE_SIZES + 15 * 340
DC_SIZES = DC_FLAGS + 250
DC_SIGNS = DC_SIZES + 15 * 220
CONTEXTS = DC_SIGNS + 5

# Sets of weights.
LENGTH_SET, FLAG_SET, SIZE_SET, EDGE_COUNT_SET = 0, 6, 55, 111
EDGE_FLAG_SET, EDGE_SIZE_SET, DC_SET = 125, 139, 167
WEIGHT_SETS = DC_SET + 15


@kernel(_nrt=False, forceinline=True)
def class_of(magnitude: Any) -> Any:
    return np.int64(_MAGNITUDES[min(magnitude, _LAST_MAGNITUDE)])


@kernel(_nrt=False, forceinline=True)
def magnitudes_around(indices: Any, left: Any, top: Any, corner: Any, right: Any, place: Any) -> Any:
    """Sum the magnitudes at a place of the blocks around: left and top twice, corner and right once."""
    beside = abs(indices[left, place]) + abs(indices[top, place])
    return 2 * beside + abs(indices[corner, place]) + abs(indices[right, place])


def new_statistics(chroma: bool) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return the initial model and weights of a coder, as in `binary`."""
    model, weights = _priors()
    return model[int(chroma)].copy(), weights[int(chroma)].copy()


@functools.cache
def _priors() -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    with np.load(PRIORS_FILE) as file:
        odds, seen, weights = (file[name] for name in ("odds", "seen", "weights"))
    states = (probabilities_from_odds(odds.astype(np.int64)) << SEEN_BITS) | seen
    return states.astype(np.int32), weights
