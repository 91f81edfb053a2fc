"""Small pictures that need no random numbers, so that golden bitstreams depend on arithmetic alone."""

from __future__ import annotations

import numpy as np


def textured(height: int, width: int, channels: int = 1) -> np.ndarray:
    """Slopes, edges and a pseudo-random texture from a linear congruence; uint8."""
    row, column = np.mgrid[:height, :width].astype(np.int64)
    texture = ((row * 1103 + column * 12345 + row * column * 77) % 251) // 9
    edges = 60 * (((row // 13) + (column // 17)) % 2)
    plane = np.clip(30 + (3 * row + 2 * column) % 120 + edges + texture, 0, 255).astype(np.uint8)
    if channels == 1:
        return plane
    return np.dstack([plane, plane[::-1], np.clip(255 - plane // 2, 0, 255).astype(np.uint8)])
