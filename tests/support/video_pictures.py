"""Moving pictures for tests of video codecs."""

from __future__ import annotations

import numpy as np


def gliding_pictures(count: int, height: int, width: int, channels: int, seed: int = 3) -> list[np.ndarray]:
    """A window that glides over a texture with noise, uint8."""
    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[0 : height + count, 0 : width + 2 * count]
    texture = 110 + 50 * np.sin(columns / 7) + 45 * np.cos(rows / 5 + columns / 23)
    layers = [np.roll(texture, 4 * channel, axis=1) for channel in range(channels)]
    still = np.stack(layers, axis=2) + rng.normal(0, 4, (*texture.shape, 1))
    pictures = []
    for index in range(count):
        window = still[index : index + height, 2 * index : 2 * index + width]
        shown = np.clip(np.round(window + rng.normal(0, 1, window.shape)), 0, 255).astype(np.uint8)
        pictures.append(np.ascontiguousarray(shown[..., 0] if channels == 1 else shown))
    return pictures


def psnr_db(pictures: list[np.ndarray], decoded: list[np.ndarray]) -> float:
    """PSNR over all pictures together."""
    squares = [np.mean((left.astype(float) - right) ** 2) for left, right in zip(pictures, decoded, strict=True)]
    return float(10 * np.log10(255**2 / np.mean(squares)))
