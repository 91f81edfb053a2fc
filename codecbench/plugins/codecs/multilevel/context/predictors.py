"""Linear predictors of the first row, the first column and DC of a block, in 1/2^12.

They stand in `predictors.npz`, for equal steps; for other tables they are scaled by the ratio of the steps. `edges` and
`dc` say which weight belongs to what. `docs/context_training.py` found them by least squares over other pictures.
"""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from codecbench.plugins.codecs.dct.tables import Table

PREDICTION_BITS = 12
_MAX_WEIGHT = 1 << 24

FILE = Path(__file__).with_name("predictors.npz")
"""For blocks whose borders are not filtered and those whose are: edges (2, 14, 32) and dc (2, 31) int16."""


def predictors(table: Table, lapped: bool) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The weights of the first row and column (14, 32) and of DC (31,) for a quantisation table."""
    edges, dc = (weights[int(lapped)] for weights in _weights())
    steps = table.reshape(64).astype(np.int64)
    scaled = np.stack([_scaled(edges[row], steps, *edge_places(row)) for row in range(14)])
    return scaled, _scaled(dc, steps, DC_PLACES, 0)


@functools.cache
def _weights() -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    with np.load(FILE) as file:
        return file["edges"].astype(np.int64), file["dc"].astype(np.int64)


def _scaled(
    weights: NDArray[np.int64], steps: NDArray[np.int64], places: NDArray[np.int64], place: int
) -> NDArray[np.int64]:
    """Weights of indices at `places` for the index at `place`, halves up."""
    ratios = 2 * weights * steps[places] + steps[place]
    return np.asarray(np.clip(ratios // (2 * steps[place]), -_MAX_WEIGHT, _MAX_WEIGHT), np.int64)


def edge_places(row: int) -> tuple[NDArray[np.int64], int]:
    """The places in a block of what predicts the index of a row of weights, and its own place."""
    part, rank = divmod(row, 7)
    along, across = (8, 1) if part else (1, 8)
    place = (rank + 1) * along
    steps = np.arange(1, 8)
    lines = (place + steps * across, place + np.arange(8) * across, steps * along, steps * along, np.zeros(3, np.int64))
    return np.concatenate(lines), place


DC_PLACES = np.concatenate([[0, 0, 0], *2 * [np.arange(1, 8), 8 * np.arange(1, 8)]]).astype(np.int64)
