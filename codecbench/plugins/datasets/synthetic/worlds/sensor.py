"""From light to gray levels: lens, exposure, photons counted one by one, reading out, gamma.

Pictures are averaged as display values whose gamma is 2, so that only exactly rounded arithmetic is needed in both
directions: light is the square of the value, the value is the root of the light.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.image import Image
from codecbench.core.kernels.compiled import compiled
from codecbench.plugins.datasets.synthetic.render import LANE, TEXEL_WEIGHT

READ_NOISE_ELECTRONS = 6.0
CORNER_LOSS = 0.30
"""Share of the light that is lost in the corners."""


class Sensor:
    """A camera's lens and sensor.

    electrons: of a white pixel. brightness: of white, as a share of the range. lens_blur_px: standard deviation, at
    most 1.
    """

    def __init__(self, electrons: float, brightness: float, lens_blur_px: float) -> None:
        self._electrons = electrons
        self._brightness = brightness
        side = lens_blur_px**2 / 4
        self._taps = np.array([side, 1 - 2 * side, side], np.float32)

    def picture(self, total: NDArray[np.uint64], samples: int, gain: float, key: int) -> Image:
        """The picture (H, W, 3) of a renderer's sum of samples (H, W).

        gain: factor on the exposure. key: 63 bits that choose the noise.
        """
        light = np.empty((*total.shape, 3), np.float32)
        _develop(total, 1.0 / (255.0 * TEXEL_WEIGHT * samples), light)
        blurred = np.empty_like(light)
        for _ in range(2):
            _blur_rows(light, self._taps, blurred)
            _blur_columns(blurred, self._taps, light)
        image = np.empty(light.shape, np.uint8)
        exposure = np.float32(self._brightness * gain)
        _expose(light, exposure, np.float32(self._electrons), np.float32(READ_NOISE_ELECTRONS), np.uint64(key), image)
        return image


@compiled
def _develop(total: Any, scale: float, light: Any) -> None:
    """Light (H, W, 3), 1 for white, of packed display values."""
    height, width = total.shape
    for y in range(height):
        for x in range(width):
            color = total[y, x]
            for channel in range(3):
                value = np.float32(np.float64(color & LANE) * scale)
                light[y, x, channel] = value * value
                color >>= np.uint64(21)


@compiled
def _blur_rows(light: Any, taps: Any, out: Any) -> None:
    height, width, channels = light.shape
    for y in range(height):
        for x in range(width):
            left, right = max(x - 1, 0), min(x + 1, width - 1)
            for c in range(channels):
                out[y, x, c] = taps[0] * light[y, left, c] + taps[1] * light[y, x, c] + taps[2] * light[y, right, c]


@compiled
def _blur_columns(light: Any, taps: Any, out: Any) -> None:
    height, width, channels = light.shape
    for y in range(height):
        above, below = max(y - 1, 0), min(y + 1, height - 1)
        for x in range(width):
            for c in range(channels):
                out[y, x, c] = taps[0] * light[above, x, c] + taps[1] * light[y, x, c] + taps[2] * light[below, x, c]


@compiled
def _expose(light: Any, exposure: Any, electrons: Any, read_noise: Any, key: Any, image: Any) -> None:
    """Display values of exposed light with vignetting, shot noise and read noise.

    One normal number a value: the sum of four uniform ones of 16 bits from one mixed counter.
    """
    height, width, channels = light.shape
    half_diagonal = ((width - 1) ** 2 + (height - 1) ** 2) / 4.0 + 1e-9
    spread = np.float32(np.sqrt(3.0) / 65536.0)
    counter = key
    for y in range(height):
        for x in range(width):
            square = ((x - (width - 1) / 2) ** 2 + (y - (height - 1) / 2) ** 2) / half_diagonal
            factor = np.float32(1.0 - CORNER_LOSS * square) * exposure
            for c in range(channels):
                counter += np.uint64(0x9E3779B97F4A7C15)
                bits = _mixed(counter)
                sixteen = np.uint64(0xFFFF)
                drawn = (bits & sixteen) + (bits >> np.uint64(16) & sixteen)
                drawn += (bits >> np.uint64(32) & sixteen) + (bits >> np.uint64(48))
                normal = (np.float32(drawn) - np.float32(131070.0)) * spread
                value = light[y, x, c] * factor
                value += normal * np.sqrt(value * electrons + read_noise * read_noise) / electrons
                value = min(max(value, np.float32(0.0)), np.float32(1.0))
                image[y, x, c] = np.uint8(np.sqrt(value) * np.float32(255.0) + np.float32(0.5))


@compiled(inline="always")
def _mixed(counter: Any) -> Any:
    """64 well mixed bits (the finaliser of SplitMix64; Steele, Lea and Flood, 2014)."""
    bits = (counter ^ (counter >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return bits ^ (bits >> np.uint64(31))
