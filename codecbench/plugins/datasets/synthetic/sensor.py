"""What a camera adds to a perfect picture: darker corners, noise of photons and of reading out, rounding."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.image import Image
from codecbench.plugins.datasets.synthetic.textures import rounded

READ_NOISE = 1.0
"""Standard deviation in gray levels at black."""

SHOT_NOISE = 0.02
"""Variance per gray level of brightness: with READ_NOISE, a deviation of 1.9 at 128, as of an indoor webcam."""

_CORNER_LOSS = 0.22


def sensed(light: NDArray[np.float32], noise: float, rng: np.random.Generator) -> Image:
    """The picture (H, W, 3) that the sensor gives for `light`, 0..255; `noise` scales both deviations."""
    exposed = light * _vignette(*light.shape[:2])
    if noise > 0.0:
        deviation = np.sqrt(np.float32(READ_NOISE**2) + np.float32(SHOT_NOISE) * exposed) * np.float32(noise)
        exposed += deviation * rng.standard_normal(light.shape, dtype=np.float32)
    return rounded(exposed)


@cache
def _vignette(height: int, width: int) -> NDArray[np.float32]:
    """(H, W, 1) factors: 1 in the middle, falling with the square of the distance."""
    rows = (np.arange(height) - (height - 1) / 2)[:, None]
    columns = (np.arange(width) - (width - 1) / 2)[None, :]
    squares = (rows**2 + columns**2) / (((height - 1) / 2) ** 2 + ((width - 1) / 2) ** 2 + 1e-9)
    return np.asarray((1.0 - _CORNER_LOSS * squares)[:, :, None], dtype=np.float32)
