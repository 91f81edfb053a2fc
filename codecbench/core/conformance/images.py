"""Small images at the edges of what codecs are asked for."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.image import Image


@dataclass(frozen=True)
class NamedImage:
    """An image with a name to call it by in a report."""

    name: str
    pixels: Image = field(repr=False)


def conformance_images(channels: int, seed: int = 1) -> list[NamedImage]:
    """Images of 1 or 3 channels: single pixels, single rows and columns, prime sizes, constants, extremes, noise.

    The first has ordinary content; the same seed gives the same images everywhere.
    """
    rng = np.random.default_rng(seed)
    planes = {
        "image 64x48": _picture(48, 64, rng),
        "1x1": rng.integers(0, 256, (1, 1)),
        "1x1 black": np.zeros((1, 1)),
        "row 1x19": rng.integers(0, 256, (1, 19)),
        "column 23x1": rng.integers(0, 256, (23, 1)),
        "prime 17x31": _picture(17, 31, rng),
        "black 16x16": np.zeros((16, 16)),
        "white 33x16": np.full((33, 16), 255),
        "gray 8x8": np.full((8, 8), 128),
        "noise 40x40": rng.integers(0, 256, (40, 40)),
        "checkerboard 16x24": np.indices((16, 24)).sum(axis=0) % 2 * 255,
        "edge 24x24": np.where(np.arange(24) < 11, 0, 255) * np.ones((24, 1)),
    }
    return [NamedImage(name, _layout(plane, channels, rng)) for name, plane in planes.items()]


def saturated_images(channels: int) -> list[NamedImage]:
    """Images of 1 or 3 channels, 64x64, of which a decoder that forgets to stop at 0 and 255 makes nonsense.

    Black beside white, the corners of the colour cube side by side, and texture that touches either end. Edges lie
    at multiples of 16 pixels, so that a codec of blocks is not asked for more than it can do.
    """
    rows, columns = np.indices((64, 64)) // 16
    texture = np.indices((64, 64)).sum(axis=0) * 7 % 12
    halves = np.where(columns < 2, 0, 255)
    cube = np.stack([(rows + shift * columns) // 2 % 2 * 255 for shift in (1, 2, 3)], axis=2)
    pictures = {
        "black beside white": halves,
        "white board": np.where((rows + columns) % 2 == 0, 0, 255),
        "nearly black": texture,
        "nearly white": 255 - texture,
        "saturated colours": cube if channels == 3 else cube[:, :, 0],
    }
    return [NamedImage(name, _repeated(picture.astype(np.uint8), channels)) for name, picture in pictures.items()]


def _repeated(picture: Image, channels: int) -> Image:
    return picture if picture.ndim == 3 or channels == 1 else np.repeat(picture[:, :, None], channels, axis=2)


def _picture(height: int, width: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Smooth shading, a disc with a sharp edge and a little noise."""
    rows, columns = np.mgrid[0:height, 0:width]
    shading = 90 + 60 * np.sin(columns / 9) + 50 * np.cos(rows / 7)
    disc = (rows - height / 2) ** 2 + (columns - width / 3) ** 2 < (min(height, width) / 4) ** 2
    picture: NDArray[np.float64] = np.clip(shading + 70 * disc + rng.normal(0, 2, (height, width)), 0, 255)
    return picture


def _layout(plane: NDArray[np.generic], channels: int, rng: np.random.Generator) -> Image:
    gray = np.round(plane.astype(np.float64)).astype(np.uint8)
    if channels == 1:
        return np.ascontiguousarray(gray)
    if gray.min() == gray.max():
        return np.repeat(gray[:, :, None], 3, axis=2)
    shifted = [np.roll(gray, int(shift), axis=shift % 2) for shift in rng.integers(0, 4, 2)]
    return np.ascontiguousarray(np.stack([gray, *shifted], axis=2))
