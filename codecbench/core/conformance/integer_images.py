"""Pictures that every machine draws alike: integers only, no random generator of a library, no real numbers.

A corpus names its pictures by generator and seed, and another machine draws them again to encode them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.image import Image

GENERATOR = "shading-and-edges-1"
"""Raised with any change of a pixel."""

_OCTAVES = ((32, 110), (8, 50), (1, 12))  # spacing of the lattice in pixels, amplitude in gray levels
_DISC_LEVELS = 70
_SALTS = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], np.uint64)


def integer_image(seed: int, height: int, width: int, channels: int) -> Image:
    """A picture of smooth shading at two scales, a disc with a sharp edge and noise, in 1 or 3 channels.

    The channels share the disc and differ in the rest, so colour is neither constant nor noise.
    """
    planes = [_plane(seed + 1000 * channel, height, width) for channel in range(channels)]
    rows, columns = np.indices((height, width))
    inside = (2 * rows - height) ** 2 + (2 * columns - width) ** 2 < (min(height, width) ** 2) // 2
    pictures = [np.clip(plane + _DISC_LEVELS * inside, 0, 255).astype(np.uint8) for plane in planes]
    return pictures[0] if channels == 1 else np.stack(pictures, axis=2)


def _plane(seed: int, height: int, width: int) -> NDArray[np.int64]:
    plane = np.full((height, width), 30, np.int64)
    for octave, (spacing, amplitude) in enumerate(_OCTAVES):
        plane += _shading(seed + 100 * octave, height, width, spacing) * amplitude // 255
    return plane


def _shading(seed: int, height: int, width: int, spacing: int) -> NDArray[np.int64]:
    """Bilinear interpolation, 0..255, of random values on a lattice."""
    lattice = _random_bytes(seed, height // spacing + 2, width // spacing + 2)
    rows, y = np.divmod(np.arange(height), spacing)
    columns, x = np.divmod(np.arange(width), spacing)
    rows, y = rows[:, None], y[:, None]
    top = lattice[rows, columns] * (spacing - x) + lattice[rows, columns + 1] * x
    bottom = lattice[rows + 1, columns] * (spacing - x) + lattice[rows + 1, columns + 1] * x
    shading: NDArray[np.int64] = (top * (spacing - y) + bottom * y) // spacing**2
    return shading


def _random_bytes(seed: int, height: int, width: int) -> NDArray[np.int64]:
    """Hashes of places: the finaliser of SplitMix64 (Steele, Lea & Flood 2014, doi:10.1145/2660193.2660195)."""
    places = np.arange(height * width, dtype=np.uint64)
    with np.errstate(over="ignore"):
        state = (places + np.uint64(1)) * _SALTS[0] + np.uint64(seed) * _SALTS[1] + _SALTS[2]
        state = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        state = (state ^ (state >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    top_bytes: NDArray[np.uint64] = (state ^ (state >> np.uint64(31))) >> np.uint64(56)
    return top_bytes.astype(np.int64).reshape(height, width)
