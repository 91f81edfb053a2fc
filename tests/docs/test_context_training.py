"""What the profile `context` starts from is made by docs/context_training.py, from pictures that are always there."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from project import DOCS

from codecbench.plugins.codecs.multilevel.context import contexts, outer
from codecbench.plugins.codecs.multilevel.context.outer import dc_prediction, edge_prediction
from codecbench.plugins.datasets.synthetic.textures import PHOTOGRAPH_FILES

sys.path.insert(0, str(DOCS))
import context_training

COLUMNS = 6


@pytest.fixture(scope="module")
def indices() -> np.ndarray:
    """Of 6 x 5 blocks, and the row of zeros."""
    drawn = np.random.default_rng(5).integers(-9, 10, (30, 64)).astype(np.int32)
    return np.vstack([drawn, np.zeros((1, 64), np.int32)])


def test_samples_are_what_the_coder_predicts_from(indices: np.ndarray) -> None:
    """Weights applied to the samples give what the kernels give, block by block."""
    weights = np.random.default_rng(6).integers(-4000, 4000, (14, 32))
    dc_weights = np.random.default_rng(7).integers(-4000, 4000, 31)
    around = context_training.neighbours(COLUMNS, indices)
    places = [block for block in range(COLUMNS, 30) if 0 < block % COLUMNS < COLUMNS - 1]
    for number, block in enumerate(places):
        beside = (block - 1, block - COLUMNS, block - COLUMNS - 1, block - COLUMNS + 1)
        for row in range(14):
            features, index = context_training.edge_samples(*around, row)
            part, rank = row // 7, row % 7 + 1
            assert features[number] @ weights[row] == edge_prediction(indices, block, *beside, part, rank, weights)
            assert index[number] == indices[block, rank * (8 if part else 1)]
        features, difference = context_training.dc_samples(*around)
        expected = (int(indices[block - 1, 0]) << 12) + features[number] @ dc_weights
        assert expected == dc_prediction(indices, block, *beside, dc_weights)
        assert difference[number] == indices[block, 0] - indices[block - 1, 0]


def test_least_squares_finds_the_weights_that_there_are() -> None:
    rng = np.random.default_rng(8)
    true = np.array([1024, -512, 0, 4096])
    parts = [rng.integers(-50, 50, (40, 4)) * np.array([1, 1, 0, 1]) for _ in range(3)]
    found = context_training.least_squares((part, part @ true / 4096) for part in parts)
    assert np.array_equal(found, true)


def test_every_picture_comes_with_a_dependency_or_is_rendered() -> None:
    assert set(context_training.PHOTOGRAPHS) <= set(PHOTOGRAPH_FILES)
    shapes = {image.ndim for image in context_training.photographs()}
    assert shapes == {2, 3}, "gray photographs have no chroma to learn from"


@pytest.mark.thorough
def test_two_pictures_give_files_of_the_format(tmp_path: Path) -> None:
    pictures = [image[:96, :128] for image in context_training.photographs() if image.ndim == 3][:2]
    made = tmp_path / "predictors.npz", tmp_path / "priors.npz"
    context_training.write(pictures, *made)
    for file, ours in zip(made, (outer.PREDICTORS_FILE, contexts.PRIORS_FILE), strict=True):
        with np.load(file) as small, np.load(ours) as kept:
            assert {name: (small[name].shape, small[name].dtype) for name in small} == {
                name: (kept[name].shape, kept[name].dtype) for name in kept
            }
            assert all(small[name].any() for name in small)
    again = tmp_path / "again.npz", tmp_path / "priors_again.npz"
    context_training.write(pictures, *again)
    assert [file.read_bytes() for file in again] == [file.read_bytes() for file in made]
