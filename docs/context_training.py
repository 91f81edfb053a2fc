"""Find what the profile `context` starts from, in pictures that come with this project's dependencies or are rendered.

python docs/context_training.py

writes `predictors.npz` and `priors.npz` beside the profile. The pictures are photographs from scikit-image's package
and frames of the worlds of the dataset `synthetic`. Linear predictors are least squares over blocks and their
neighbours at two steps. For the priors every picture is coded at four steps, two of the plain transform and two of the
lapped, twice, in an order drawn by chance, with statistics that go on from picture to picture; a prior is the mean of a
context's probability after each picture of the second time.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.image import Image
from codecbench.plugins.codecs.dct.planes import pad_plane, planes_from_image
from codecbench.plugins.codecs.dct.tables import FLAT
from codecbench.plugins.codecs.multilevel.context import contexts, outer
from codecbench.plugins.codecs.multilevel.context.binary import new_coder
from codecbench.plugins.codecs.multilevel.context.coefficients import MAX_BLOCK_BYTES, code_blocks
from codecbench.plugins.codecs.multilevel.context.contexts import CONTEXTS, WEIGHT_SETS
from codecbench.plugins.codecs.multilevel.context.outer import DC_PLACES, PREDICTION_BITS, edge_places
from codecbench.plugins.codecs.multilevel.context.quantization import (
    estimate_costs,
    optimise,
    quantise,
    steps_from_table,
)
from codecbench.plugins.codecs.multilevel.context.transform import forward_transform
from codecbench.plugins.datasets.synthetic.dataset import Synthetic
from codecbench.plugins.datasets.synthetic.textures import photograph

PHOTOGRAPHS = (
    "astronaut", "brick", "camera", "cat", "coffee", "coins", "grass", "gravel", "moon", "motorcycle", "rocket",
)  # fmt: skip
WORLDS = ("room", "dim_room", "corridor_loop", "street", "field")
SEVERITIES = (0.0, 0.5)
PLACE = 0.4
"""Where in its path a world is looked at."""

PREDICTION_QFS = (0.75, 1.875)
PRIOR_QFS = ((0.6, False), (1.1, True), (2.0, False), (3.6, True))
"""And whether the transform is the lapped."""
CHROMA = 1.5
UNSEEN = 1 << 29
EVEN_WEIGHT = 26214
MOST_SEEN = 16
Arrays = dict[str, NDArray[np.generic]]
Coded = tuple[int, NDArray[np.int32]]
"""Blocks in a row of a plane, and its indices (n + 1, 64), the last row zeros."""


def main() -> None:
    """Train on all pictures and write both files."""
    chosen = [*photographs(), *frames_of_worlds()]
    print(f"{len(chosen)} pictures")
    write(chosen, outer.PREDICTORS_FILE, contexts.PRIORS_FILE)
    for file in (outer.PREDICTORS_FILE, contexts.PRIORS_FILE):
        print(f"{file}: {file.stat().st_size} bytes")


def write(pictures: list[Image], predictors_file: Path, priors_file: Path) -> None:
    """Train on the pictures and write what was found."""
    found = predictors_from(pictures)
    np.savez_compressed(predictors_file, **found)  # type: ignore[arg-type,unused-ignore]
    np.savez_compressed(priors_file, **priors_from(pictures, found))  # type: ignore[arg-type,unused-ignore]


def photographs() -> Iterator[Image]:
    for name in PHOTOGRAPHS:
        image = photograph(name)
        yield image[:, :, 0] if np.ptp(image, axis=2).max() == 0 else image


def frames_of_worlds() -> Iterator[Image]:
    for world in WORLDS:
        for severity in SEVERITIES:
            sequence = Synthetic.create(world=world, severity=severity).open()
            yield sequence.read(int(PLACE * len(sequence))).image


def predictors_from(pictures: list[Image]) -> Arrays:
    """Weights of the first row, the first column and DC, for the plain transform and the lapped."""
    edges, dc = np.zeros((2, 14, 32), np.int16), np.zeros((2, 31), np.int16)
    for lapped in (False, True):
        around = [neighbours(*coded) for coded in at_steps(pictures, lapped)]
        for row in range(14):
            edges[int(lapped), row] = least_squares(edge_samples(*blocks, row) for blocks in around)
        dc[int(lapped)] = least_squares(dc_samples(*blocks) for blocks in around)
    return {"edges": edges, "dc": dc}


def at_steps(pictures: list[Image], lapped: bool) -> Iterator[Coded]:
    for image in pictures:
        for columns, coefficients in [*transformed(image, False, lapped), *transformed(image, True, lapped)]:
            for qf in PREDICTION_QFS:
                indices = np.zeros((len(coefficients) + 1, 64), np.int32)
                quantise(coefficients, steps_from_table(FLAT, qf, lapped), indices)
                yield columns, indices


def neighbours(columns: int, indices: NDArray[np.int32]) -> tuple[NDArray[np.int32], ...]:
    """Of all blocks that have them: the block itself, those to the left, above, above left and above right (n, 64)."""
    grid = indices[:-1].reshape(-1, columns, 64)
    parts = (grid[1:, 1:-1], grid[1:, :-2], grid[:-1, 1:-1], grid[:-1, :-2], grid[:-1, 2:])
    return tuple(part.reshape(-1, 64) for part in parts)


Samples = tuple[NDArray[np.int32], NDArray[np.int32]]
"""What an index is expected from (n, features), and the index (n,)."""


def edge_samples(own: NDArray[np.int32], left: NDArray[np.int32], top: NDArray[np.int32], corner: NDArray[np.int32],
                 right: NDArray[np.int32], row: int) -> Samples:  # fmt: skip
    """Of an index of the first row (row 0 to 6) or column (7 to 13), as `edges.edge_prediction` takes them."""
    places, place = edge_places(row)
    across, other_across, same_along, along, _ = np.split(places, [7, 15, 22, 29])
    other, same = (left, top) if row >= 7 else (top, left)
    coded = own[:, along] * (np.arange(7) < row % 7)
    parts = [own[:, across], other[:, other_across], same[:, same_along], coded, slopes(left, top, corner, right)]
    return np.hstack(parts), own[:, place]


def dc_samples(own: NDArray[np.int32], left: NDArray[np.int32], top: NDArray[np.int32], corner: NDArray[np.int32],
               right: NDArray[np.int32]) -> Samples:  # fmt: skip
    """Of DC, less that of the block to the left, as `dc.dc_prediction` takes them."""
    _, row, column, own_row, own_column = np.split(DC_PLACES, [3, 10, 17, 24])
    parts = [slopes(left, top, corner, right), left[:, row], top[:, column], own[:, own_row], own[:, own_column]]
    return np.hstack(parts), own[:, 0] - left[:, 0]


def slopes(left: NDArray[np.int32], top: NDArray[np.int32], corner: NDArray[np.int32],
           right: NDArray[np.int32]) -> NDArray[np.int32]:  # fmt: skip
    """Differences of DC (n, 3)."""
    return np.stack([top[:, 0] - left[:, 0], corner[:, 0] - left[:, 0], right[:, 0] - top[:, 0]], axis=1)


def least_squares(samples: Iterable[Samples]) -> NDArray[np.int64]:
    """The weights in 1/2^12; 0 of what is never there.

    A sample counts the less the more energy is in its features: few blocks full of contrast would decide otherwise,
    and most bits go where little is.
    """
    squares, products = np.float64(0.0), np.float64(0.0)
    for features, index in samples:
        values = features.astype(np.float64)
        counting = values / (1 + np.square(values).sum(axis=1, keepdims=True))
        squares = squares + counting.T @ values
        products = products + counting.T @ index
    weights = np.linalg.lstsq(squares, products, rcond=None)[0]
    return np.rint(weights * (1 << PREDICTION_BITS)).astype(np.int64)


def priors_from(pictures: list[Image], weights: Arrays) -> Arrays:
    """Log odds, what they are worth, and mixing weights, of luma and of chroma; from weights of `predictors_from`."""
    predicting = [(edges.astype(np.int64), dc.astype(np.int64)) for edges, dc in zip(*weights.values(), strict=True)]
    trained = [
        trained_on([item for image in pictures for item in as_best_does(image, chroma)], predicting)
        for chroma in (False, True)
    ]
    odds, seen, mixing = (np.stack(parts) for parts in zip(*trained, strict=True))
    return {"odds": odds, "seen": seen, "weights": mixing}


def transformed(image: Image, chroma: bool, lapped: bool) -> Iterator[Coded]:
    """Blocks in a row, and coefficients (n, 64), of the luma of a picture, or of its chroma if it has any."""
    planes = planes_from_image(image, "ycbcr420")
    for plane in map(pad_plane, planes[1:] if chroma else planes[:1]):
        coefficients = np.empty((plane.size // 64, 64), np.int32)
        forward_transform(plane, int(lapped), coefficients)
        yield plane.shape[1] // 8, coefficients


def as_best_does(image: Image, chroma: bool) -> Iterator[tuple[bool, Coded]]:
    """Luma or chroma at every step, quantised as `effort: best` does it, and whether it was lapped."""
    for qf, lapped in PRIOR_QFS:
        steps = steps_from_table(FLAT, qf * (CHROMA if chroma else 1), lapped)
        for columns, coefficients in transformed(image, chroma, lapped):
            indices = np.zeros((len(coefficients) + 1, 64), np.int32)
            quantise(coefficients, steps, indices)
            costs = np.empty((66, 8, 2), np.int64)
            for _ in range(2):
                estimate_costs(indices, columns, costs)
                optimise(coefficients, steps, columns, costs, indices)
            yield lapped, (columns, indices)


Predicting = tuple[NDArray[np.int64], NDArray[np.int64]]


def trained_on(
    items: list[tuple[bool, Coded]], predicting: list[Predicting]
) -> tuple[NDArray[np.int8], NDArray[np.uint8], NDArray[np.int32]]:
    """Log odds in 1/16, what they are worth in bits seen, and weights."""
    model = np.full(CONTEXTS, UNSEEN, np.int32)
    weights = np.full((WEIGHT_SETS, 3), EVEN_WEIGHT, np.int32)
    sums, times, visits = np.zeros(CONTEXTS), np.zeros(CONTEXTS), np.zeros(CONTEXTS)
    weight_sums = np.zeros(weights.shape)
    rng = np.random.default_rng(0)
    for second_time in (False, True):
        for number in rng.permutation(len(items)):
            lapped, (columns, indices) = items[number]
            before = model.copy()
            data = np.empty(4 * indices.size + 2 * MAX_BLOCK_BYTES, np.uint8)
            coder = new_coder(True, len(data) - MAX_BLOCK_BYTES)
            code_blocks(coder, data, model, weights, indices, 0, len(indices) - 1, columns, *predicting[lapped])
            changed = model != before
            visits += changed * np.maximum((model & 255) - (before & 255), 1)
            if second_time:
                sums += changed * (model >> 8)
                times += changed
                weight_sums += weights
    share = np.where(times > 0, sums / np.maximum(times, 1), 1 << 21) / (1 << 22)
    odds = np.clip(np.rint(16 * np.log(share / (1 - share))), -127, 127)
    seen = np.minimum(visits / 2, MOST_SEEN)
    return (
        (odds * (seen >= 1)).astype(np.int8),
        seen.astype(np.uint8),
        np.rint(weight_sums / len(items)).astype(np.int32),
    )


if __name__ == "__main__":
    main()
