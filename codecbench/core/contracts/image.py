"""Images: their layout, how they are checked, and the one conversion of color to gray."""

from __future__ import annotations

from typing import Any, NamedTuple, TypeAlias

import cv2
import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.errors import ImageError

Image: TypeAlias = NDArray[np.uint8 | np.uint16]
"""(H, W) gray, uint8 or uint16, or (H, W, 3) RGB, uint8; row-major, H and W at least 1. Never BGR."""

MAX_PIXELS = 1 << 26
"""Largest image that a decoder allocates, whatever a header says: 67 Mpixel."""


class Layout(NamedTuple):
    """Channels of an image, 1 gray or 3 RGB, and bits of its samples, 8 or 16."""

    channels: int
    bits: int = 8

    def __str__(self) -> str:
        """`gray`, `color` or `16-bit gray`."""
        color = "gray" if self.channels == 1 else "color"
        return color if self.bits == 8 else f"{self.bits}-bit {color}"


LAYOUTS = (Layout(1), Layout(3), Layout(1, 16))
"""All layouts that an image may have."""


def check_image(image: Image, channels: tuple[int, ...] = (1, 3), bits: tuple[int, ...] = (8,)) -> Image:
    """Check `image` and return it as a C-contiguous writable array, the only kind that kernels are compiled for.

    `channels` and `bits` list what is allowed: 1 for (H, W), 3 for (H, W, 3); 8 for uint8, 16 for uint16. Raises
    ImageError for anything but an array of an allowed layout with at least one pixel.
    """
    if not isinstance(image, np.ndarray):
        raise ImageError(f"an image is a numpy array, got {type(image).__name__}")
    if image.dtype not in [np.dtype(f"uint{count}") for count in bits]:
        allowed = " or ".join(f"uint{count}" for count in bits)
        raise ImageError(f"an image has dtype {allowed}, got {image.dtype}")
    count = channel_count(image)
    if count not in channels:
        raise ImageError(f"image has {count} channel(s); allowed here: {', '.join(map(str, channels))}")
    if layout_of(image) not in LAYOUTS:
        raise ImageError(f"a 16-bit image is gray, got {count} channels; convert it to gray")
    if image.size == 0:
        raise ImageError(f"image of shape {image.shape} has no pixels")
    return np.require(image, requirements=["C", "W"])


def channel_count(image: Image) -> int:
    """Return 1 for an (H, W) image and 3 for an (H, W, 3) image. Raises ImageError for any other shape."""
    if image.ndim == 2:
        return 1
    if image.ndim == 3 and image.shape[2] == 3:
        return 3
    raise ImageError(f"an image has shape (H, W) or (H, W, 3), got {image.shape}")


def layout_of(image: Image) -> Layout:
    """Return the layout of an image. Raises ImageError for a shape that no image has."""
    return Layout(channel_count(image), 8 * image.dtype.itemsize)


def gray_from_image(image: Image) -> NDArray[Any]:
    """Return the (H, W) gray form of an image, of its dtype: itself, or BT.601 luma of RGB as OpenCV computes it.

    Every metric and every tracker in codecbench uses this function: file readers' own gray modes differ from it on half
    the pixels, and Rec. 709 weights on nearly all.
    """
    if channel_count(image) == 1:
        return image
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), dtype=np.uint8)


def png_bytes(image: Image) -> bytes:
    """Return the image as a PNG file of OpenCV's encoder at its default effort, the reference of `cr_percent`."""
    stored = image if channel_count(image) == 1 else cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    done, buffer = cv2.imencode(".png", stored)
    if not done:
        raise ImageError(f"OpenCV could not write an image of shape {image.shape} as PNG")
    return buffer.tobytes()
