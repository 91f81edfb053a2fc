"""Train the prediction that comes with the package.

    python -m codecbench.plugins.codecs.orb_features.train_prediction [OUTPUT.npz]

Training set: the descriptors of 200 composed images of codecbench.slam.places.train_vocabulary, none of them from a
sequence of the benchmark. The result depends only on the seed.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from codecbench.plugins.codecs.orb_features.coding import MOST_DIFFERING
from codecbench.plugins.codecs.orb_features.prediction import (
    BITS,
    BLOCK,
    CLASSES,
    FILE,
    LOWEST_CHANCE,
    STEP_SHIFT,
    STEPS,
    UNIT,
    class_of,
)
from codecbench.slam.places.train_vocabulary import extract_descriptors, load_photographs

PICTURES = 200
SEED = 1
_RIDGE = 0.002
_PRIOR = 400.0
"""Weight of a class's smooth curve, in counted bits."""


def train(descriptors: NDArray[np.uint64]) -> tuple[NDArray[np.int8], NDArray[np.int16]]:
    """Train weights (256, 256) and biases (256,) of `prediction` from descriptors (N, 4).

    With bits as -1 and 1, this is the best linear prediction of a block from all bits before it. Each bit's is divided
    by its residual variance, so that all are log odds.
    """
    signs = _bits(descriptors) * 2.0 - 1.0
    means = signs.mean(axis=0)
    covariance = np.cov(signs.T) + _RIDGE * np.eye(BITS)
    predictor, left = np.zeros((BITS, BITS)), np.diag(covariance).copy()
    for start in range(BLOCK, BITS, BLOCK):
        before, block = slice(start), slice(start, start + BLOCK)
        predictor[block, before] = np.linalg.solve(covariance[before, before], covariance[before, block]).T
        left[block] -= (predictor[block, before] * covariance[block, before]).sum(axis=1)
    weights = np.rint(2.0 * UNIT * (predictor / left[:, None]).T)
    biases = np.rint((means - predictor @ means) * (UNIT / left)) - np.rint(0.5 * weights.sum(axis=0))
    if np.abs(weights).reshape(-1, 4, BITS).sum(axis=1).max() > np.iinfo(np.int8).max:
        raise ValueError("the summed weights of some four bits do not fit into 8 bits; lower UNIT")
    if (np.abs(weights).sum(axis=0) + np.abs(biases)).max() >= (STEPS // 2) << STEP_SHIFT:
        raise ValueError(f"the sum of some bit is beyond {STEPS} steps; lower UNIT")
    return weights.astype(np.int8), biases.astype(np.int16)


def train_chances(
    descriptors: NDArray[np.uint64], pictures: NDArray[np.int64], weights: NDArray[np.int8], biases: NDArray[np.int16]
) -> NDArray[np.uint16]:
    """Measure the probabilities (CLASSES, STEPS) of `prediction` by class and predicted step.

    A descriptor's reference is the nearest one of the same image.
    """
    counts = np.zeros((CLASSES, STEPS, 2))
    for picture in np.unique(pictures):
        rows = descriptors[pictures == picture]
        bits = _bits(rows).astype(np.int64)
        odds = bits @ weights.astype(np.int64) + biases
        _count(counts, np.zeros_like(bits), odds, bits)
        distances = np.bitwise_count(rows[:, None] ^ rows).sum(axis=2)
        np.fill_diagonal(distances, BITS)
        has_reference = distances.min(axis=1) <= MOST_DIFFERING
        bits, odds, expected = bits[has_reference], odds[has_reference], bits[distances.argmin(axis=1)[has_reference]]
        differing = bits ^ expected
        before = np.arange(BITS) // BLOCK * BLOCK
        wrong = np.concatenate([np.zeros((len(bits), 1), np.int64), differing.cumsum(axis=1)], axis=1)[:, before]
        _count(counts, class_of(wrong, before), np.where(expected == 1, odds, -odds - 1), differing)
    return np.stack([_chances(of_class) for of_class in counts])


def _bits(descriptors: NDArray[np.uint64]) -> NDArray[np.uint8]:
    return np.unpackbits(descriptors.view(np.uint8).reshape(-1, 32), axis=1, bitorder="little")


def _count(
    counts: NDArray[np.float64], classes: NDArray[np.int64], odds: NDArray[np.int64], bits: NDArray[np.int64]
) -> None:
    places = (classes * STEPS + STEPS // 2 + (odds >> STEP_SHIFT)) * 2 + bits
    counts += np.bincount(places.ravel(), minlength=counts.size).reshape(counts.shape)


def _chances(counts: NDArray[np.float64]) -> NDArray[np.uint16]:
    """Return P(1) in 1/2^16, (STEPS,), of counts (STEPS, 2) of zeros and ones, smoothed by a line of log odds."""
    steps, seen = np.arange(STEPS) - (STEPS - 1) / 2, counts.sum(axis=1)
    odds = np.log((counts[:, 1] + 0.5) / (counts[:, 0] + 0.5))
    slope, at_zero = np.polyfit(steps, odds, 1, w=np.sqrt(seen))
    smooth = 1.0 / (1.0 + np.exp(-np.clip(slope * steps + at_zero, -8.0, 8.0)))
    chances = (counts[:, 1] + _PRIOR * smooth) / (seen + _PRIOR)
    return np.asarray(np.clip(np.rint(65536.0 * chances), LOWEST_CHANCE, 65536 - LOWEST_CHANCE), np.uint16)


def main() -> None:
    """Train with the fixed seed and write the prediction, by default over the one in the package."""
    target: Any = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(str(FILE))
    descriptors, pictures = extract_descriptors(load_photographs(), PICTURES, np.random.default_rng(SEED))
    weights, biases = train(descriptors)
    chances = train_chances(descriptors, pictures, weights, biases)
    np.savez_compressed(target, weights=weights[np.triu_indices(BITS, 1)], biases=biases, chances=chances)
    sys.stdout.write(f"{target}: from {len(descriptors)} descriptors, {target.stat().st_size} bytes\n")


if __name__ == "__main__":
    main()
