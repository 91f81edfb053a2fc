"""Pictures as planes of an encoder and back: full-range BT.601, 4:2:0 chroma in the middle of its four samples."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import cv2
import numpy as np

from codecbench.core.contracts.image import Image, gray_from_image
from codecbench.plugins.codecs.video.encoders import PixelFormat

_NEUTRAL: Final = 128
_FORMATS: Final[dict[str, PixelFormat]] = {
    "gray": "gray",
    "yuv420p": "yuv420p",
    "yuvj420p": "yuv420p",
    "yuv444p": "yuv444p",
    "yuvj444p": "yuv444p",
    "bgr0": "rgb",
}


def padded(image: Image, width: int, height: int) -> Image:
    """The image with its last row and column repeated up to a size."""
    below, right = height - image.shape[0], width - image.shape[1]
    if not below and not right:
        return image
    return np.asarray(cv2.copyMakeBorder(image, 0, below, 0, right, cv2.BORDER_REPLICATE), dtype=np.uint8)


def planes_from_image(image: Image, pixel_format: PixelFormat) -> list[Image]:
    """What an encoder is given, plane by plane; a gray image has neutral chroma. Sides are even for yuv420p."""
    if pixel_format == "gray":
        return [gray_from_image(image)]
    if pixel_format == "rgb":
        code = cv2.COLOR_GRAY2BGRA if image.ndim == 2 else cv2.COLOR_RGB2BGRA
        return [np.asarray(cv2.cvtColor(image, code), dtype=np.uint8).reshape(image.shape[0], -1)]
    if image.ndim == 2:
        luma = image
        blue = red = np.full_like(image, _NEUTRAL)
    else:
        ycrcb = np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2YCrCb), dtype=np.uint8)
        luma, red, blue = (np.ascontiguousarray(ycrcb[..., channel]) for channel in range(3))
    return [luma, blue, red] if pixel_format == "yuv444p" else [luma, _halved(blue), _halved(red)]


def _halved(chroma: Image) -> Image:
    """Means of 2x2 samples."""
    half = (chroma.shape[1] // 2, chroma.shape[0] // 2)
    return np.asarray(cv2.resize(chroma, half, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def fill_frame(frame: Any, planes: Sequence[Image]) -> None:
    """Copy planes into a frame of FFmpeg's, whose rows are longer than what they hold."""
    for target, plane in zip(frame.planes, planes, strict=True):
        rows = np.frombuffer(target, np.uint8).reshape(-1, target.line_size)
        rows[: plane.shape[0], : plane.shape[1]] = plane


def image_from_frame(frame: Any, channels: int) -> Image | None:
    """A decoded frame as a gray or an RGB image, or None where its format is none that is written here."""
    pixel_format = _FORMATS.get(frame.format.name)
    if pixel_format is None:
        return None
    planes = [_plane(plane, frame) for plane in frame.planes]
    if pixel_format == "rgb":
        image = np.asarray(cv2.cvtColor(planes[0].reshape(frame.height, frame.width, 4), cv2.COLOR_BGRA2RGB), np.uint8)
        return np.ascontiguousarray(image[..., 1]) if channels == 1 else image
    if channels == 1:
        return planes[0].copy()
    if len(planes) == 1:
        return np.asarray(cv2.cvtColor(planes[0], cv2.COLOR_GRAY2RGB), dtype=np.uint8)
    luma = planes[0]
    blue, red = (_full_size(chroma, luma.shape) for chroma in planes[1:])
    return np.asarray(cv2.cvtColor(cv2.merge([luma, red, blue]), cv2.COLOR_YCrCb2RGB), dtype=np.uint8)


def _plane(plane: Any, frame: Any) -> Image:
    """The samples of a plane without what its rows are filled up with."""
    sample_bytes = 4 if frame.format.name == "bgr0" else 1
    rows: Image = np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)[
        : plane.height, : plane.width * sample_bytes
    ]
    return np.ascontiguousarray(rows)


def _full_size(chroma: Image, shape: tuple[int, ...]) -> Image:
    if chroma.shape == shape:
        return chroma
    return np.asarray(cv2.resize(chroma, shape[::-1], interpolation=cv2.INTER_LINEAR), dtype=np.uint8)
