"""scikit-image's photographs, and textures made of them: crops, recolored and seamless surfaces, wood, planks.

Resampling is plain arithmetic on arrays, not a library's, so the pixels do not depend on a library's version.
Textures are (H, W, 3) uint8 RGB; densities are texels per meter.
"""

from __future__ import annotations

import hashlib
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.contracts.image import Image

Floats = NDArray[np.float32]
Color = tuple[float, float, float]
_CROP_TRIALS = 8
PHOTOGRAPH_FILES = {
    "astronaut": "astronaut.png",
    "brick": "brick.png",
    "camera": "camera.png",
    "cat": "chelsea.png",
    "coffee": "coffee.png",
    "coins": "coins.png",
    "colors": "color.png",
    "grass": "grass.png",
    "gravel": "gravel.png",
    "galaxies": "hubble_deep_field.jpg",
    "tissue": "ihc.png",
    "moon": "moon.png",
    "motorcycle": "motorcycle_left.png",
    "page": "page.png",
    "retina": "retina.jpg",
    "rocket": "rocket.jpg",
    "text": "text.png",
}
"""Names of the photographs here, and their files in `skimage/data`."""


def photograph_file(name: str) -> Path:
    """The file of a photograph, without scikit-image's downloader. Raises DatasetError if it is missing."""
    package = find_spec("skimage")
    if package is None or package.origin is None:
        raise DatasetError("synthetic: scikit-image is not installed; the room needs its photographs")
    file = Path(package.origin).parent / "data" / PHOTOGRAPH_FILES[name]
    if not file.is_file():
        raise DatasetError(f"synthetic: {file} is missing; reinstall scikit-image, which includes this photograph")
    return file


@cache
def photograph(name: str) -> Image:
    """A photograph as (H, W, 3) RGB, read-only and cached."""
    content = np.frombuffer(photograph_file(name).read_bytes(), np.uint8)
    stored = cv2.imdecode(content, cv2.IMREAD_COLOR)
    if stored is None:
        raise DatasetError(f"synthetic: {photograph_file(name)} is damaged; reinstall scikit-image")
    image: Image = np.ascontiguousarray(stored[:, :, ::-1])
    image.setflags(write=False)
    return image


@cache
def photographs_digest() -> str:
    """Hex digest over the bytes of all photographs, part of the fingerprints of rendered sequences."""
    digest = hashlib.sha256()
    for name in sorted(PHOTOGRAPH_FILES):
        digest.update(hashlib.sha256(photograph_file(name).read_bytes()).digest())
    return digest.hexdigest()


def resize(image: NDArray[np.generic], height: int, width: int) -> Image:
    """Resize an image: halve it by averaging as often as possible, then interpolate bilinearly."""
    pixels = image.astype(np.float32)
    while pixels.shape[0] >= 2 * height and pixels.shape[1] >= 2 * width:
        pixels = halve(pixels)
    rows = np.clip((np.arange(height) + 0.5) * pixels.shape[0] / height - 0.5, 0, pixels.shape[0] - 1)
    columns = np.clip((np.arange(width) + 0.5) * pixels.shape[1] / width - 0.5, 0, pixels.shape[1] - 1)
    return round_to_uint8(_interpolate(_interpolate(pixels, rows, 0), columns, 1))


def halve(pixels: Floats) -> Floats:
    """Average over 2 x 2 pixels; an odd last row or column is repeated."""
    odd = (pixels.shape[0] % 2, pixels.shape[1] % 2)
    even = np.pad(pixels, ((0, odd[0]), (0, odd[1]), (0, 0)), mode="edge") if any(odd) else pixels
    quarters = even[0::2, 0::2] + even[0::2, 1::2] + even[1::2, 0::2] + even[1::2, 1::2]
    return np.asarray(quarters * np.float32(0.25), dtype=np.float32)


def _interpolate(pixels: Floats, places: NDArray[np.float64], axis: int) -> Floats:
    """Interpolate linearly along an axis at fractional indices."""
    low = places.astype(np.int64)
    high = np.minimum(low + 1, pixels.shape[axis] - 1)
    share = (places - low).astype(np.float32).reshape((-1, 1, 1) if axis == 0 else (1, -1, 1))
    between = pixels.take(low, axis) * (1 - share) + pixels.take(high, axis) * share
    return np.asarray(between, dtype=np.float32)


def round_to_uint8(pixels: NDArray[np.floating]) -> Image:
    """Round to the nearest gray levels, 0..255."""
    return np.asarray(np.clip(np.rint(pixels), 0, 255), dtype=np.uint8)


def crop(name: str, height: int, width: int, rng: np.random.Generator, zoom: float = 1.0) -> Image:
    """Crop a photograph to the given size, at the most detailed of several random positions.

    zoom: texels per pixel of the photograph, more if the photograph is too small.
    """
    photo = photograph(name)
    zoom = max(zoom, height / photo.shape[0], width / photo.shape[1])
    rows, columns = max(int(height / zoom), 1), max(int(width / zoom), 1)
    best, most_detail = photo[:rows, :columns], -1.0
    for _ in range(_CROP_TRIALS):
        row = int(rng.integers(photo.shape[0] - rows + 1))
        column = int(rng.integers(photo.shape[1] - columns + 1))
        candidate = photo[row : row + rows, column : column + columns]
        detail = float(np.abs(np.diff(candidate[:, :, 1].astype(np.float32), axis=1)).sum())
        if detail > most_detail:
            best, most_detail = candidate, detail
    return resize(best, height, width)


def recolor(image: Image, color: Color, contrast: float = 1.0) -> Image:
    """Show the brightness of an image, relative to its mean, in shades of one color (0..255)."""
    gray = image.astype(np.float32) @ np.array([0.299, 0.587, 0.114], np.float32)
    deviation = (gray - gray.mean(dtype=np.float64)) / 128.0 * contrast
    return round_to_uint8(np.array(color) * (1.0 + deviation[:, :, None]))


def scatter_patches(
    name: str, height: int, width: int, rng: np.random.Generator, patch: int, zoom: float = 1.0
) -> Image:
    """Make a large gray surface without repetition or seams from overlapping random patches of a photograph.

    Patches are weighted by a smooth window, and the sum is scaled to preserve contrast.
    Source: Heitz and Neyret, "High-Performance By-Example Noise using a Histogram-Preserving Blending
    Operator", 2018, equation 2, without its histogram transform.
    """
    photo = photograph(name)
    source = resize(photo, int(photo.shape[0] * zoom), int(photo.shape[1] * zoom))[:, :, 1].astype(np.float32)
    mean = np.float32(source.mean(dtype=np.float64))
    patch = min(patch, *source.shape) // 2 * 2
    ramp = 1.0 - np.abs((np.arange(patch) + 0.5) / (patch / 2) - 1.0)
    window = (ramp * ramp * (3 - 2 * ramp)).astype(np.float32)
    weight = np.outer(window, window)
    total = np.zeros((height + 2 * patch, width + 2 * patch), np.float32)
    squares = np.zeros_like(total)
    for top in range(0, height + patch, patch // 2):
        for left in range(0, width + patch, patch // 2):
            row, column = (int(rng.integers(side - patch + 1)) for side in source.shape)
            piece = source[row : row + patch, column : column + patch] - mean
            total[top : top + patch, left : left + patch] += weight * piece
            squares[top : top + patch, left : left + patch] += weight * weight
    whole = mean + total / np.sqrt(np.maximum(squares, 1e-6))
    gray = round_to_uint8(whole[patch : patch + height, patch : patch + width])
    return np.repeat(gray[:, :, None], 3, axis=2)


def wood(height: int, width: int, rng: np.random.Generator, color: Color) -> Image:
    """Wood with its grain along the width: the table in the photograph of a coffee cup."""
    table = photograph("coffee")[300:395, 20:150]
    top = int(rng.integers(0, 40))
    left = int(rng.integers(0, 40))
    piece = table[top : top + 50, left : left + 90]
    if rng.random() < 0.5:
        piece = piece[::-1]
    if rng.random() < 0.5:
        piece = piece[:, ::-1]
    grain = recolor(resize(piece, height, width), color, 0.9)
    sheet = _fine_grain()
    rows, columns = np.arange(height) % len(sheet), np.arange(width) % len(sheet)
    top, left = (int(start) for start in rng.integers(len(sheet), size=2))
    return round_to_uint8(grain * sheet[(rows + top) % len(sheet)][:, (columns + left) % len(sheet), None])


@cache
def _fine_grain() -> Floats:
    """Factors about 1 (1024, 1024): the roughness of wood; each surface uses another part of it."""
    gray = recolor(
        scatter_patches("gravel", 1024, 1024, np.random.default_rng(1), 64, 0.4), (128.0, 128.0, 128.0), 0.16
    )
    return np.asarray(gray[:, :, 0].astype(np.float32) / 128.0)


def planks(height: int, width: int, rng: np.random.Generator, color: Color, plank: int) -> Image:
    """A floor of planks `plank` texels wide, each with its own length, shade and grain."""
    floor = np.zeros((height, width, 3), np.uint8)
    for top in range(0, height, plank):
        left = -int(rng.integers(plank * 4))
        while left < width:
            length = int(rng.integers(plank * 5, plank * 9))
            light, warm = float(rng.uniform(0.78, 1.15)), float(rng.uniform(0.94, 1.06))
            board = wood(plank, length, rng, (color[0] * light * warm, color[1] * light, color[2] * light / warm))
            board[:2] = board[:2] // 3
            board[:, :2] = board[:, :2] // 3
            first, last = max(left, 0), min(left + length, width)
            rows = min(plank, height - top)
            floor[top : top + rows, first:last] = board[:rows, first - left : last - left]
            left += length
    return floor


def add_mat(image: Image, border: int, color: Color = (236.0, 232.0, 224.0)) -> Image:
    """Put an image on a plain mat with a border of `border` texels."""
    sheet = np.empty((image.shape[0] + 2 * border, image.shape[1] + 2 * border, 3), np.uint8)
    sheet[:] = np.array(color, np.uint8)
    sheet[border:-border, border:-border] = image
    return sheet
