"""Converts light to gray levels: lens blur, exposure, shot noise, read noise, gamma.

Sub-frames are averaged as display values with a gamma of 2, so exactly rounded arithmetic suffices in both directions:
light is the square of the value, and the value is the square root of the light.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.image import Image
from codecbench.core.kernels.compiled import compiled
from codecbench.plugins.datasets.synthetic.render import LANE
from codecbench.plugins.datasets.synthetic.worlds.exposure import SAMPLE_WEIGHT

READ_NOISE_ELECTRONS = 6.0
CORNER_LOSS = 0.30
"""Share of the light lost in the corners."""


class Sensor:
    """A camera's lens and sensor.

    electrons: in a white pixel. brightness: of white, as a share of the range. lens_blur_px: standard deviation of the
    lens's blur, at most 1.
    """

    def __init__(self, electrons: float, brightness: float, lens_blur_px: float) -> None:
        self._electrons = electrons
        self._brightness = brightness
        self._side = np.float32(lens_blur_px**2 / 4)

    def expose(self, total: NDArray[np.uint64], samples: int, gain: float, key: int) -> Image:
        """The image (H, W, 3) of a renderer's sum of sub-frames (H, W).

        gain: factor on the exposure. key: seed of the noise.
        """
        height, width = total.shape
        light = np.empty((height, 3 * width), np.float32)
        _develop(total, 1.0 / (255.0 * SAMPLE_WEIGHT * samples), light)
        blurred = np.empty_like(light)
        for _ in range(2):
            _blur_rows(light, self._side, blurred)
            _blur_columns(blurred, self._side, light)
        starts = np.random.default_rng(key).integers(_NOISE_LENGTH - 3 * width, size=height)
        factors = _vignette(height, width) * np.float32(self._brightness * gain)
        image = np.empty(light.shape, np.uint8)
        read_noise = np.float32(READ_NOISE_ELECTRONS)
        _expose(light, factors, _normals(), starts, np.float32(self._electrons), read_noise, image)
        return image.reshape(height, width, 3)


_NOISE_LENGTH = 1 << 19


@cache
def _normals() -> NDArray[np.float32]:
    """Normal numbers; each row of a frame uses a run of them, which is faster than drawing new ones."""
    return np.random.default_rng(20250101).standard_normal(_NOISE_LENGTH, dtype=np.float32)


@cache
def _vignette(height: int, width: int) -> NDArray[np.float32]:
    """Vignetting factors (H, 3 W) of each channel: 1 in the middle, falling with the squared distance from it."""
    rows = (np.arange(height) - (height - 1) / 2)[:, None]
    columns = (np.arange(width) - (width - 1) / 2)[None, :]
    squares = (rows**2 + columns**2) / (((height - 1) / 2) ** 2 + ((width - 1) / 2) ** 2 + 1e-9)
    return np.repeat((1.0 - CORNER_LOSS * squares).astype(np.float32), 3, axis=1)


@compiled
def _develop(total: Any, scale: float, light: Any) -> None:
    """Convert packed display values (H, W) to light (H, 3 W), 1 for white."""
    height, width = total.shape
    for y in range(height):
        for x in range(width):
            color = total[y, x]
            for channel in range(3):
                value = np.float32(np.float64(color & LANE) * scale)
                light[y, 3 * x + channel] = value * value
                color >>= np.uint64(21)


@compiled
def _blur_rows(light: Any, side: Any, out: Any) -> None:
    """Blur along rows with weights side, 1 - 2 side, side; the outermost pixels repeat."""
    height, width = light.shape
    middle = np.float32(1.0) - side - side
    for y in range(height):
        left, here, right, inner = light[y, :-6], light[y, 3:-3], light[y, 6:], out[y, 3:-3]
        for x in range(width - 6):
            inner[x] = middle * here[x] + side * (left[x] + right[x])
        for x in range(3):
            end = width - 3 + x
            out[y, x] = middle * light[y, x] + side * (light[y, x] + light[y, x + 3])
            out[y, end] = middle * light[y, end] + side * (light[y, end - 3] + light[y, end])


@compiled
def _blur_columns(light: Any, side: Any, out: Any) -> None:
    """Blur along columns with the weights of `_blur_rows`."""
    height, width = light.shape
    middle = np.float32(1.0) - side - side
    for y in range(height):
        above, below = light[max(y - 1, 0)], light[min(y + 1, height - 1)]
        for x in range(width):
            out[y, x] = middle * light[y, x] + side * (above[x] + below[x])


@compiled
def _expose(light: Any, factors: Any, normals: Any, starts: Any, electrons: Any, read_noise: Any, image: Any) -> None:
    """Convert light times `factors` to display values, with shot noise and read noise from `normals`, row by row."""
    height, width = light.shape
    for y in range(height):
        start = starts[y]
        for x in range(width):
            value = light[y, x] * factors[y, x]
            value += normals[start + x] * np.sqrt(value * electrons + read_noise * read_noise) / electrons
            value = min(max(value, np.float32(0.0)), np.float32(1.0))
            image[y, x] = np.uint8(np.sqrt(value) * np.float32(255.0) + np.float32(0.5))
