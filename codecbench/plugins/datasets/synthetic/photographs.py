"""The photographs on the room's surfaces: those that lie inside scikit-image's package, read without its downloader."""

from __future__ import annotations

import hashlib
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.contracts.image import Image

FILES = {
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
"""Our names of the photographs, and their files in `skimage/data`."""


def photograph_file(name: str) -> Path:
    """Where a photograph lies. Raises DatasetError where scikit-image or the file is missing."""
    found = find_spec("skimage")
    if found is None or found.origin is None:
        raise DatasetError("synthetic: scikit-image is not installed, and its photographs cover the room")
    file = Path(found.origin).parent / "data" / FILES[name]
    if not file.is_file():
        raise DatasetError(f"synthetic: {file} is missing; reinstall scikit-image, which brings this photograph")
    return file


@cache
def photograph(name: str) -> Image:
    """One photograph as (H, W, 3) RGB; do not write into it."""
    content = np.frombuffer(photograph_file(name).read_bytes(), np.uint8)
    stored = cv2.imdecode(content, cv2.IMREAD_COLOR)
    if stored is None:
        raise DatasetError(f"synthetic: {photograph_file(name)} is damaged; reinstall scikit-image")
    image: Image = np.ascontiguousarray(stored[:, :, ::-1])
    image.setflags(write=False)
    return image


@cache
def photographs_digest() -> str:
    """Hex digest over the bytes of all photographs, part of the fingerprint of what is rendered from them."""
    digest = hashlib.sha256()
    for name in sorted(FILES):
        digest.update(hashlib.sha256(photograph_file(name).read_bytes()).digest())
    return digest.hexdigest()
