"""Write and read image files in memory through OpenCV; converts between our RGB and its BGR."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TypeAlias

import cv2
import numpy as np

from codecbench.core.contracts.errors import BitstreamError, ImageError
from codecbench.core.contracts.image import Image, channel_count


def write_image(image: Image, extension: str, options: Sequence[int] = ()) -> bytes:
    """Encode the image as a file of the format of `extension` (`.jpg`).

    `options` alternate OpenCV's IMWRITE_* flags and their values. Raises ImageError if OpenCV refuses.
    """
    stored = image if channel_count(image) == 1 else cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    try:
        done, buffer = cv2.imencode(extension, stored, [int(option) for option in options])
    except cv2.error as error:
        raise ImageError(f"OpenCV cannot write shape {image.shape} as {extension}: {error}") from error
    if not done:
        raise ImageError(f"OpenCV cannot write shape {image.shape} as {extension}")
    return buffer.tobytes()


Options: TypeAlias = dict[str, int | str]
"""Values by name of OpenCV's flags; a string is the name of a value."""


def flags(options: Options) -> list[int]:
    """Convert options to the list that `write_image` takes."""
    pairs = ((name, getattr(cv2, value) if isinstance(value, str) else value) for name, value in options.items())
    return [number for name, value in pairs for number in (getattr(cv2, name), value)]


def read_image(bitstream: bytes, shape: tuple[int, ...], name: str, bits: int = 8) -> Image:
    """Decode a file whose header promises `shape` and `bits` to a gray or RGB image; EXIF orientation is not applied.

    Raises BitstreamError if OpenCV finds no image or another shape or dtype.
    """
    try:
        stored = cv2.imdecode(np.frombuffer(bitstream, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error as error:
        raise BitstreamError(f"{name}: OpenCV cannot read the file: {error}") from error
    if stored is None or stored.shape != shape or stored.dtype != f"uint{bits}":
        got = "nothing" if stored is None else f"{stored.dtype} of shape {stored.shape}"
        raise BitstreamError(f"{name}: the header declares uint{bits} of shape {shape}, OpenCV read {got}")
    pixels = stored if stored.ndim == 2 else cv2.cvtColor(stored, cv2.COLOR_BGR2RGB)
    return np.asarray(pixels, dtype=f"uint{bits}")


def library_versions(row: str, library: str) -> dict[str, str]:
    """Return OpenCV's version and that of the library in one row (`JPEG`) of its build information."""
    versions = {"opencv": cv2.__version__}
    line = re.search(rf"^\s*{row}:\s*(.+)$", cv2.getBuildInformation(), re.MULTILINE)
    version = re.search(r"\(ver ([^)]+)\)", line[1]) if line else None
    versions[library] = version[1] if version else "unknown"
    return versions
