"""Convert images to planes of an encoder and back: full-range BT.601, 4:2:0 chroma centered in its four samples."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import cv2
import numpy as np

from codecbench.core.contracts.image import Image, gray_from_image
from codecbench.plugins.codecs.video.encoders import PixelFormat

_NEUTRAL_CHROMA: Final = 128
_FORMATS: Final[dict[str, PixelFormat]] = {
    "gray": "gray",
    "yuv420p": "yuv420p",
    "yuvj420p": "yuv420p",
    "yuv444p": "yuv444p",
    "yuvj444p": "yuv444p",
    "bgr0": "rgb",
}


def pad_image(image: Image, width: int, height: int) -> Image:
    """Repeat the last row and column up to a size."""
    below, right = height - image.shape[0], width - image.shape[1]
    if not below and not right:
        return image
    return np.asarray(cv2.copyMakeBorder(image, 0, below, 0, right, cv2.BORDER_REPLICATE), dtype=image.dtype)


def planes_from_image(image: Image, pixel_format: PixelFormat) -> list[Image]:
    """Split an image into the planes of an encoder; gray has neutral chroma. Sides must be even for yuv420p."""
    if pixel_format == "gray":
        return [gray_from_image(image)]
    if pixel_format == "rgb":
        code = cv2.COLOR_GRAY2BGRA if image.ndim == 2 else cv2.COLOR_RGB2BGRA
        return [np.asarray(cv2.cvtColor(image, code), dtype=np.uint8).reshape(image.shape[0], -1)]
    if image.ndim == 2:
        luma = image
        blue = red = np.full_like(image, _NEUTRAL_CHROMA)
    else:
        ycrcb = np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2YCrCb), dtype=np.uint8)
        luma, red, blue = (np.ascontiguousarray(ycrcb[..., channel]) for channel in range(3))
    return [luma, blue, red] if pixel_format == "yuv444p" else [luma, _halve(blue), _halve(red)]


def _halve(chroma: Image) -> Image:
    """Average 2x2 samples."""
    half = (chroma.shape[1] // 2, chroma.shape[0] // 2)
    return np.asarray(cv2.resize(chroma, half, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def fill_frame(frame: Any, planes: Sequence[Image]) -> None:
    """Copy planes into a frame of FFmpeg, whose rows may be longer."""
    for target, plane in zip(frame.planes, planes, strict=True):
        rows = np.frombuffer(target, np.uint8).reshape(-1, target.line_size)
        rows[: plane.shape[0], : plane.shape[1]] = plane


def image_from_frame(frame: Any, channels: int) -> Image | None:
    """Convert a decoded frame to a gray or an RGB image; None if its format is none of ours."""
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
    blue, red = (_upsample(chroma, luma.shape) for chroma in planes[1:])
    return np.asarray(cv2.cvtColor(cv2.merge([luma, red, blue]), cv2.COLOR_YCrCb2RGB), dtype=np.uint8)


def planes_from_codes(codes: Image, bits: int, pixel_format: str) -> list[Image]:
    """Return (H, W) uint16 codes of so many bits as the bytes of little-endian planes, with neutral chroma if any."""
    planes = [codes]
    if not pixel_format.startswith("gray"):
        planes += 2 * [np.full((codes.shape[0] // 2, codes.shape[1] // 2), 1 << (bits - 1), np.uint16)]
    return [plane.astype("<u2", copy=False).view(np.uint8) for plane in planes]


def codes_from_frame(frame: Any, bits: int) -> Image | None:
    """Return the (H, W) uint16 codes of a decoded gray frame of so many bits; None if its format is another.

    FFmpeg's H.264 decoder adds neutral chroma to gray.
    """
    if frame.format.name not in (f"gray{bits}le", f"yuv420p{bits}le"):
        return None
    plane = frame.planes[0]
    return np.frombuffer(plane, "<u2").reshape(-1, plane.line_size // 2)[: plane.height, : plane.width]


def _plane(plane: Any, frame: Any) -> Image:
    """Samples of a plane without the padding of its rows."""
    sample_bytes = 4 if frame.format.name == "bgr0" else 1
    rows: Image = np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)[
        : plane.height, : plane.width * sample_bytes
    ]
    return np.ascontiguousarray(rows)


def _upsample(chroma: Image, shape: tuple[int, ...]) -> Image:
    if chroma.shape == shape:
        return chroma
    return np.asarray(cv2.resize(chroma, shape[::-1], interpolation=cv2.INTER_LINEAR), dtype=np.uint8)
