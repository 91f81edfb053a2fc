"""Pictures on which codecs are checked: single ones at the edges of what codecs are asked for, and short films."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.image import Image

FRAME_RATE_HZ: Final = 30.0
_FRAMES: Final = 14
_LONG: Final = 120
"""Frames of a stream that is longer than encoders look ahead: by 16 to 80 frames, as far as we know."""
_SIZES: Final = ((48, 64), (33, 17))
_SIZES_WITH_CORNERS: Final = ((120, 160), (97, 131))
_CORNER_FRAMES: Final = 8
GENERATOR = "shading-and-edges-1"
"""Raised with any change of a pixel."""

_OCTAVES = ((32, 110), (8, 50), (1, 12))  # spacing of the lattice in pixels, amplitude in gray levels
_DISC_LEVELS = 70
_SALTS = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], np.uint64)


@dataclass(frozen=True)
class Film:
    """One picture or more, with a name to call them by in a report; those of a sequence are views of one array."""

    name: str
    pictures: list[Image] = field(repr=False)


def conformance_images(channels: int, seed: int = 1) -> list[Film]:
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
    return [Film(name, [_layout(plane, channels, rng)]) for name, plane in planes.items()]


def saturated_images(channels: int) -> list[Film]:
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
    return [Film(name, [_repeated(picture.astype(np.uint8), channels)]) for name, picture in pictures.items()]


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


def moving_pictures(channels: int, seed: int = 1) -> list[Film]:
    """Sequences of 1 or 3 channels, of even and of odd sides: a texture that glides, a disc before it, some noise.

    The same seed gives the same pictures everywhere; another one gives another motion, too.
    """
    rng = np.random.default_rng(seed)
    return [Film(f"{width}x{height}", _sequence(height, width, channels, _FRAMES, rng)) for height, width in _SIZES]


def long_sequence(channels: int, seed: int = 3) -> Film:
    """A sequence of 1 or 3 channels that no encoder can hold back to its end; small, so that it costs little."""
    height, width = _SIZES[-1]
    pictures = _sequence(height, width, channels, _LONG, np.random.default_rng(seed))
    return Film(f"{width}x{height}", pictures)


def pictures_with_corners(channels: int, seed: int = 5) -> list[Film]:
    """Sequences of 1 or 3 channels in which detectors find something: squares of all grays that glide, some noise.

    The second ends with a picture without a corner. The same seed gives the same pictures everywhere.
    """
    rng = np.random.default_rng(seed)
    films: list[Film] = []
    for height, width in _SIZES_WITH_CORNERS:
        squares = rng.integers(0, 256, (height // 8 + _FRAMES, width // 8 + _FRAMES))
        ground = np.kron(squares, np.ones((8, 8)))
        film = [ground[2 * k : 2 * k + height, 3 * k : 3 * k + width] for k in range(_CORNER_FRAMES)]
        shown = [np.clip(frame + rng.normal(0, 3, frame.shape), 0, 255).astype(np.uint8) for frame in film]
        if films:
            shown[-1] = np.full_like(shown[-1], 90)
        pictures = shown if channels == 1 else [np.repeat(frame[..., None], 3, axis=2) for frame in shown]
        films.append(Film(f"{width}x{height}", pictures))
    return films


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


def integer_image(seed: int, height: int, width: int, channels: int) -> Image:
    """A picture that every machine draws alike: of integers only, without a library's random generator.

    A corpus names it by generator and seed. Smooth shading at two scales, a disc with a sharp edge and noise, in 1 or 3
    channels. The channels share the disc and differ in the rest, so colour is neither constant nor noise.
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
