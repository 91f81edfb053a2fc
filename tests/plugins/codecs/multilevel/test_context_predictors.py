"""The linear predictors: scaled with the table, and better than the neighbour."""

from __future__ import annotations

import numpy as np
import pytest

from codecbench.plugins.codecs.dct.tables import FLAT, LUMINANCE
from codecbench.plugins.codecs.multilevel.context.outer import (
    PREDICTION_BITS,
    dc_prediction,
    edge_prediction,
    predictors,
)
from codecbench.plugins.codecs.multilevel.context.quantization import quantise, steps_from_table
from codecbench.plugins.codecs.multilevel.context.transform import forward_transform

COLUMNS = 12


def indices_of(lapped: bool) -> np.ndarray:
    """Of a smooth picture with an edge that runs slantwise through blocks."""
    rows, columns = np.mgrid[:96, : 8 * COLUMNS]
    plane = (40 + rows / 2 + columns / 3 + 90 / (1 + np.exp(-(rows - 1.6 * columns + 30) / 3))).astype(np.uint8)
    coefficients = np.empty((plane.size // 64, 64), np.int32)
    forward_transform(plane, int(lapped), coefficients)
    indices = np.zeros((len(coefficients) + 1, 64), np.int32)
    quantise(coefficients, steps_from_table(FLAT, 0.5, lapped), indices)
    return indices


@pytest.mark.parametrize("lapped", [False, True])
def test_predictions_beat_the_block_to_the_left(lapped: bool) -> None:
    indices = indices_of(lapped)
    edges, dc = predictors(FLAT, lapped)
    predicted, plain = [], []
    for block in range(COLUMNS, len(indices) - 1):
        if 0 < block % COLUMNS < COLUMNS - 1:
            around = (block - 1, block - COLUMNS, block - COLUMNS - 1, block - COLUMNS + 1)
            expected = dc_prediction(indices, block, *around, dc) / (1 << PREDICTION_BITS)
            predicted.append(abs(indices[block, 0] - expected))
            plain.append(abs(indices[block, 0] - indices[block - 1, 0]))
            for part, rank, place in ((0, 1, 1), (1, 1, 8)):
                expected = edge_prediction(indices, block, *around, part, rank, edges) / (1 << PREDICTION_BITS)
                predicted.append(abs(indices[block, place] - expected))
                plain.append(abs(indices[block, place]))
    assert np.mean(predicted) < 0.95 * np.mean(plain)


def test_weights_follow_the_steps() -> None:
    """Indices at another table stand for other coefficients: twice the step of the source counts twice."""
    edges, dc = predictors(FLAT, lapped=True)
    table = FLAT.copy()
    table[0, 1] *= 2  # the first row's first, place 1
    scaled_edges, scaled_dc = predictors(table, lapped=True)
    assert np.array_equal(scaled_dc[[3, 17]], 2 * dc[[3, 17]])
    others = np.setdiff1d(np.arange(31), [3, 17])
    assert np.array_equal(scaled_dc[others], dc[others])
    assert np.abs(scaled_edges[0, 29:] - edges[0, 29:] / 2).max() <= 0.5


def test_flat_tables_are_alike_and_others_are_not() -> None:
    assert np.array_equal(predictors(FLAT, lapped=False)[0], predictors(3 * FLAT, lapped=False)[0])
    assert not np.array_equal(predictors(FLAT, lapped=False)[0], predictors(LUMINANCE, lapped=False)[0])
