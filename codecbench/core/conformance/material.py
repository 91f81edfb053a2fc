"""Synthetic test images and sequences for the checks, with extreme sizes and contents."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.image import Image, Layout

FRAME_RATE_HZ: Final = 30.0
_FRAMES: Final = 14
_LONG: Final = 120
"""Number of frames of a long stream: more than any known encoder's lookahead of 16 to 80 frames."""
_SIZES: Final = ((48, 64), (33, 17))
_SIZES_WITH_CORNERS: Final = ((120, 160), (97, 131))
_CORNER_FRAMES: Final = 8
GENERATOR = "shading-and-edges-1"
"""Name and version of `integer_image`; raise it with any change of a pixel."""

_OCTAVES = ((32, 110), (8, 50), (1, 12))  # spacing of the lattice in pixels, amplitude in gray levels
_DISC_LEVELS = 70
_SALTS = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], np.uint64)


@dataclass(frozen=True)
class Film:
    """A test sequence of one or more frames."""

    name: str
    """Name for reports."""
    pictures: Sequence[Image] = field(repr=False)
    """Frames in order; those of a sequence may be views of one array."""


def conformance_images(layout: Layout, seed: int = 1) -> list[Film]:
    """Return images of a layout: single pixels, rows and columns, prime sizes, constants, extremes, noise.

    The first has ordinary content, and one of 16 bits looks like depth in millimeters with holes; equal seeds give
    equal images everywhere.
    """
    rng, white = np.random.default_rng(seed), (1 << layout.bits) - 1
    planes = {
        "image 64x48": _picture(48, 64, rng) * (white / 255),
        "1x1": rng.integers(0, white + 1, (1, 1)),
        "1x1 black": np.zeros((1, 1)),
        "row 1x19": rng.integers(0, white + 1, (1, 19)),
        "column 23x1": rng.integers(0, white + 1, (23, 1)),
        "prime 17x31": _picture(17, 31, rng) * (white / 255),
        "black 16x16": np.zeros((16, 16)),
        "white 33x16": np.full((33, 16), white),
        "gray 8x8": np.full((8, 8), (white + 1) // 2),
        "noise 40x40": rng.integers(0, white + 1, (40, 40)),
        "checkerboard 16x24": np.indices((16, 24)).sum(axis=0) % 2 * white,
        "edge 24x24": np.where(np.arange(24) < 11, 0, white) * np.ones((24, 1)),
    }
    if layout.bits == 16:
        planes["depth 37x50"] = (500 + 16 * _picture(37, 50, rng)) * (rng.random((37, 50)) > 0.1)
    return [Film(name, [_in_layout(plane, layout, rng)]) for name, plane in planes.items()]


def saturated_images(layout: Layout) -> list[Film]:
    """Return 64x64 images of a layout that overflow in a decoder which does not clip to black and white.

    They have black beside white, adjacent corners of the color cube, and texture that touches either end. Edges lie at
    multiples of 16 pixels, to suit block-based codecs.
    """
    rows, columns = np.indices((64, 64)) // 16
    texture = np.indices((64, 64)).sum(axis=0) * 7 % 12
    halves = np.where(columns < 2, 0, 255)
    cube = np.stack([(rows + shift * columns) // 2 % 2 * 255 for shift in (1, 2, 3)], axis=2)
    pictures = {
        "black next to white": halves,
        "white board": np.where((rows + columns) % 2 == 0, 0, 255),
        "nearly black": texture,
        "nearly white": 255 - texture,
        "saturated colors": cube if layout.channels == 3 else cube[:, :, 0],
    }
    gain, dtype = ((1 << layout.bits) - 1) // 255, f"uint{layout.bits}"
    return [
        Film(name, [_with_channels((gain * picture).astype(dtype), layout.channels)])
        for name, picture in pictures.items()
    ]


def _with_channels(picture: Image, channels: int) -> Image:
    return picture if picture.ndim == 3 or channels == 1 else np.repeat(picture[:, :, None], channels, axis=2)


def _picture(height: int, width: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw smooth shading, a disc with a sharp edge and a little noise."""
    rows, columns = np.mgrid[0:height, 0:width]
    shading = 90 + 60 * np.sin(columns / 9) + 50 * np.cos(rows / 7)
    disc = (rows - height / 2) ** 2 + (columns - width / 3) ** 2 < (min(height, width) / 4) ** 2
    picture: NDArray[np.float64] = np.clip(shading + 70 * disc + rng.normal(0, 2, (height, width)), 0, 255)
    return picture


def _in_layout(plane: NDArray[np.generic], layout: Layout, rng: np.random.Generator) -> Image:
    gray = np.round(plane.astype(np.float64)).astype(f"uint{layout.bits}")
    if layout.channels == 1:
        return np.ascontiguousarray(gray)
    if gray.min() == gray.max():
        return np.repeat(gray[:, :, None], 3, axis=2)
    shifted = [np.roll(gray, int(shift), axis=shift % 2) for shift in rng.integers(0, 4, 2)]
    return np.ascontiguousarray(np.stack([gray, *shifted], axis=2))


def moving_pictures(layout: Layout, seed: int = 1) -> list[Film]:
    """Return sequences of a layout, with even and odd sizes: moving texture, a disc before it, some noise.

    Equal seeds give equal frames everywhere; another seed also changes the motion.
    """
    rng = np.random.default_rng(seed)
    return [Film(f"{width}x{height}", _sequence(height, width, layout, _FRAMES, rng)) for height, width in _SIZES]


def long_sequence(layout: Layout, seed: int = 3) -> Film:
    """Return a small sequence of a layout, longer than any encoder holds back."""
    height, width = _SIZES[-1]
    pictures = _sequence(height, width, layout, _LONG, np.random.default_rng(seed))
    return Film(f"{width}x{height}", pictures)


def pictures_with_corners(layout: Layout, seed: int = 5) -> list[Film]:
    """Return 8-bit sequences of a layout with features to detect: moving gray squares and some noise.

    The second ends with a frame without corners. Equal seeds give equal frames everywhere.
    """
    rng = np.random.default_rng(seed)
    films: list[Film] = []
    for height, width in _SIZES_WITH_CORNERS:
        squares = rng.integers(0, 256, (height // 8 + _FRAMES, width // 8 + _FRAMES))
        ground = np.kron(squares, np.ones((8, 8)))
        crops = [ground[2 * k : 2 * k + height, 3 * k : 3 * k + width] for k in range(_CORNER_FRAMES)]
        frames = [np.clip(crop + rng.normal(0, 3, crop.shape), 0, 255).astype(np.uint8) for crop in crops]
        if films:
            frames[-1] = np.full_like(frames[-1], 90)
        pictures = frames if layout.channels == 1 else [np.repeat(frame[..., None], 3, axis=2) for frame in frames]
        films.append(Film(f"{width}x{height}", pictures))
    return films


def _sequence(height: int, width: int, layout: Layout, frames: int, rng: np.random.Generator) -> list[Image]:
    white, channels = (1 << layout.bits) - 1, layout.channels
    speed = rng.uniform(0.5, 3, 2)
    rows, columns = np.mgrid[0:height, 0:width]
    film = np.zeros((frames, height, width, channels))
    for index in range(frames):
        down, across = speed * index
        texture = 100 + 50 * np.sin((columns + across) / 5) + 40 * np.cos((rows + down) / 4)
        disc = (rows - height / 2) ** 2 + (columns - width / 4 - 2 * index) ** 2 < (min(height, width) / 4) ** 2
        plane = texture + 60 * disc + rng.normal(0, 2, (height, width))
        film[index] = np.stack([np.roll(plane, 3 * channel, axis=1) for channel in range(channels)], axis=2)
    samples = np.clip(np.round(film * (white / 255)), 0, white).astype(f"uint{layout.bits}")
    return list(samples[..., 0].copy() if channels == 1 else samples)


def integer_image(seed: int, height: int, width: int, channels: int, bits: int = 8) -> Image:
    """Draw an image that is equal on every machine: integer arithmetic only, without a library's random generator.

    A corpus identifies it by generator and seed. It has smooth shading at two scales, a disc with a sharp edge and
    noise. Its 1 or 3 channels share the disc and differ in the rest, so color is neither constant nor noise. One of 16
    bits has more noise in its lower 8.
    """
    planes = [_plane(seed + 1000 * channel, height, width) for channel in range(channels)]
    rows, columns = np.indices((height, width))
    inside = (2 * rows - height) ** 2 + (2 * columns - width) ** 2 < (min(height, width) ** 2) // 2
    pictures: list[Image] = [np.clip(plane + _DISC_LEVELS * inside, 0, 255).astype(np.uint8) for plane in planes]
    if bits == 16:
        return np.asarray(256 * pictures[0].astype(np.int64) + _random_bytes(seed + 500, height, width), np.uint16)
    return pictures[0] if channels == 1 else np.stack(pictures, axis=2)


def _plane(seed: int, height: int, width: int) -> NDArray[np.int64]:
    plane = np.full((height, width), 30, np.int64)
    for octave, (spacing, amplitude) in enumerate(_OCTAVES):
        plane += _shading(seed + 100 * octave, height, width, spacing) * amplitude // 255
    return plane


def _shading(seed: int, height: int, width: int, spacing: int) -> NDArray[np.int64]:
    """Interpolate random values 0..255 on a lattice, bilinearly."""
    lattice = _random_bytes(seed, height // spacing + 2, width // spacing + 2)
    rows, y = np.divmod(np.arange(height), spacing)
    columns, x = np.divmod(np.arange(width), spacing)
    rows, y = rows[:, None], y[:, None]
    top = lattice[rows, columns] * (spacing - x) + lattice[rows, columns + 1] * x
    bottom = lattice[rows + 1, columns] * (spacing - x) + lattice[rows + 1, columns + 1] * x
    shading: NDArray[np.int64] = (top * (spacing - y) + bottom * y) // spacing**2
    return shading


def _random_bytes(seed: int, height: int, width: int) -> NDArray[np.int64]:
    """Hash pixel positions by the finalizer of SplitMix64 (Steele, Lea & Flood 2014, doi:10.1145/2660193.2660195)."""
    places = np.arange(height * width, dtype=np.uint64)
    with np.errstate(over="ignore"):
        state = (places + np.uint64(1)) * _SALTS[0] + np.uint64(seed) * _SALTS[1] + _SALTS[2]
        state = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        state = (state ^ (state >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    top_bytes: NDArray[np.uint64] = (state ^ (state >> np.uint64(31))) >> np.uint64(56)
    return top_bytes.astype(np.int64).reshape(height, width)
