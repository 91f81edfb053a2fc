"""Short sequences of small moving pictures, for what codecs with memory are asked."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from codecbench.core.contracts.image import Image

FRAME_RATE_HZ: Final = 30.0
_FRAMES: Final = 14
_LONG: Final = 120
"""Frames of a stream that is longer than encoders look ahead: by 16 to 80 frames, as far as we know."""
_SIZES: Final = ((48, 64), (33, 17))
_SIZES_WITH_CORNERS: Final = ((120, 160), (97, 131))
_CORNER_FRAMES: Final = 8


@dataclass(frozen=True)
class MovingPictures:
    """A sequence with a name to call it by in a report; the pictures are views of one array."""

    name: str
    pictures: list[Image] = field(repr=False)


def moving_pictures(channels: int, seed: int = 1) -> list[MovingPictures]:
    """Sequences of 1 or 3 channels, of even and of odd sides: a texture that glides, a disc before it, some noise.

    The same seed gives the same pictures everywhere; another one gives another motion, too.
    """
    rng = np.random.default_rng(seed)
    return [
        MovingPictures(f"{width}x{height}", _sequence(height, width, channels, _FRAMES, rng))
        for height, width in _SIZES
    ]


def long_sequence(channels: int, seed: int = 3) -> MovingPictures:
    """A sequence of 1 or 3 channels that no encoder can hold back to its end; small, so that it costs little."""
    height, width = _SIZES[-1]
    pictures = _sequence(height, width, channels, _LONG, np.random.default_rng(seed))
    return MovingPictures(f"{width}x{height}", pictures)


def pictures_with_corners(channels: int, seed: int = 5) -> list[MovingPictures]:
    """Sequences of 1 or 3 channels in which detectors find something: squares of all grays that glide, some noise.

    The second ends with a picture without a corner. The same seed gives the same pictures everywhere.
    """
    rng = np.random.default_rng(seed)
    found: list[MovingPictures] = []
    for height, width in _SIZES_WITH_CORNERS:
        squares = rng.integers(0, 256, (height // 8 + _FRAMES, width // 8 + _FRAMES))
        ground = np.kron(squares, np.ones((8, 8)))
        film = [ground[2 * k : 2 * k + height, 3 * k : 3 * k + width] for k in range(_CORNER_FRAMES)]
        shown = [np.clip(frame + rng.normal(0, 3, frame.shape), 0, 255).astype(np.uint8) for frame in film]
        if found:
            shown[-1] = np.full_like(shown[-1], 90)
        pictures = shown if channels == 1 else [np.repeat(frame[..., None], 3, axis=2) for frame in shown]
        found.append(MovingPictures(f"{width}x{height}", pictures))
    return found


def _sequence(height: int, width: int, channels: int, frames: int, rng: np.random.Generator) -> list[Image]:
    speed = rng.uniform(0.5, 3, 2)
    rows, columns = np.mgrid[0:height, 0:width]
    film = np.zeros((frames, height, width, channels))
    for index in range(frames):
        down, across = speed * index
        texture = 100 + 50 * np.sin((columns + across) / 5) + 40 * np.cos((rows + down) / 4)
        disc = (rows - height / 2) ** 2 + (columns - width / 4 - 2 * index) ** 2 < (min(height, width) / 4) ** 2
        shown = texture + 60 * disc + rng.normal(0, 2, (height, width))
        film[index] = np.stack([np.roll(shown, 3 * channel, axis=1) for channel in range(channels)], axis=2)
    samples = np.clip(np.round(film), 0, 255).astype(np.uint8)
    return list(samples[..., 0].copy() if channels == 1 else samples)
