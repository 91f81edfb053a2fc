"""Train the prediction that comes with the package.

    python -m codecbench.plugins.codecs.orb_features.train_prediction [OUTPUT.npz]

Training set: the descriptors of 200 composed pictures of codecbench.slam.places.train_vocabulary, none of them from a
sequence that the benchmark runs on. The result depends on the seed alone.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from codecbench.plugins.codecs.orb_features.prediction import FILE, UNIT
from codecbench.slam.places.train_vocabulary import extract_descriptors, load_photographs

PICTURES = 200
SEED = 1
_RIDGE = 0.002


def train(descriptors: NDArray[np.uint64]) -> tuple[NDArray[np.int16], NDArray[np.int16]]:
    """Weights (256, 256) and biases (256,), as `prediction` has them, from descriptors (N, 4).

    With bits as -1 and 1, one Cholesky factor of their covariance holds the best linear prediction of every bit from
    those before it. Each is divided by the variance that is left, so that all speak of log odds alike.
    """
    bits = np.unpackbits(descriptors.view(np.uint8).reshape(-1, 32), axis=1, bitorder="little")
    signs = bits.astype(np.float64) * 2.0 - 1.0
    means = signs.mean(axis=0)
    factor = np.linalg.cholesky(np.cov(signs.T) + _RIDGE * np.eye(256))
    left = np.diag(factor)
    predictor = np.tril(np.eye(256) - left[:, None] * np.linalg.inv(factor), -1)
    odds = UNIT / left**2
    weights = 2.0 * np.rint((predictor * odds[:, None]).T)
    biases = np.rint((means - predictor @ means) * odds) - 0.5 * weights.sum(axis=0)
    if (np.abs(weights).sum(axis=0) + np.abs(biases)).max() > np.iinfo(np.int16).max:
        raise ValueError("the sums of some bit do not fit into 16 bits; lower UNIT")
    return weights.astype(np.int16), biases.astype(np.int16)


def main() -> None:
    """Train with the fixed seed and write the prediction, by default over the one in the package."""
    target: Any = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(str(FILE))
    descriptors, _ = extract_descriptors(load_photographs(), PICTURES, np.random.default_rng(SEED))
    weights, biases = train(descriptors)
    np.savez_compressed(target, weights=weights[np.triu_indices(256, 1)], biases=biases)
    sys.stdout.write(f"{target}: from {len(descriptors)} descriptors, {target.stat().st_size} bytes\n")


if __name__ == "__main__":
    main()
