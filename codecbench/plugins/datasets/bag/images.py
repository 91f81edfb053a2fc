"""Images from messages: sensor_msgs/Image in the usual encodings, and sensor_msgs/CompressedImage."""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass
from io import BytesIO
from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.contracts.image import MAX_PIXELS, Image
from codecbench.plugins.codecs.jfif import quality_from_jpeg
from codecbench.plugins.datasets.selection import already_coded

_COMPRESSED_FORMATS: Final = ("JPEG", "PNG", "WEBP", "AVIF", "JPEG2000", "TIFF", "BMP")


@dataclass(frozen=True)
class _Layout:
    """How an encoding stores samples."""

    bits: int
    """Bits per sample."""
    channels: int
    """Samples per pixel."""
    conversion: int | None = None
    """OpenCV's code of the conversion to RGB; None if there is nothing to convert."""
    rows: float = 1.0
    """Rows of samples per row of pixels."""


def _layouts() -> dict[str, _Layout]:
    """The layout of every supported encoding, by its name."""
    bases = {
        "mono": _Layout(8, 1),
        "rgb": _Layout(8, 3),
        "bgr": _Layout(8, 3, cv2.COLOR_BGR2RGB),
        "rgba": _Layout(8, 4, cv2.COLOR_RGBA2RGB),
        "bgra": _Layout(8, 4, cv2.COLOR_BGRA2RGB),
        "bayer_rggb": _Layout(8, 1, cv2.COLOR_BayerRGGB2RGB),
        "bayer_bggr": _Layout(8, 1, cv2.COLOR_BayerBGGR2RGB),
        "bayer_gbrg": _Layout(8, 1, cv2.COLOR_BayerGBRG2RGB),
        "bayer_grbg": _Layout(8, 1, cv2.COLOR_BayerGRBG2RGB),
    }
    layouts = {
        f"{name}{bits}": _Layout(bits, x.channels, x.conversion) for name, x in bases.items() for bits in (8, 16)
    }
    for bits in (8, 16):
        layouts |= {
            f"{bits}UC1": layouts[f"mono{bits}"],
            f"{bits}UC3": layouts[f"bgr{bits}"],
            f"{bits}UC4": layouts[f"bgra{bits}"],
        }
    uyvy, yuyv = (_Layout(8, 2, code) for code in (cv2.COLOR_YUV2RGB_UYVY, cv2.COLOR_YUV2RGB_YUY2))
    nv12, nv21 = (_Layout(8, 1, code, rows=1.5) for code in (cv2.COLOR_YUV2RGB_NV12, cv2.COLOR_YUV2RGB_NV21))
    packed = {"yuv422": uyvy, "uyvy": uyvy, "yuv422_yuy2": yuyv, "yuyv": yuyv}
    return layouts | packed | {"nv12": nv12, "nv21": nv21}


_LAYOUTS: Final = _layouts()


def decode_image(message: Any, bits: int | None, where: str) -> Image:
    """The gray (H, W) or RGB (H, W, 3) image of a sensor_msgs/Image. Raises DatasetError, naming `where`.

    bits: how many of 16 bits the samples fill; the upper 8 of these are kept. None keeps all 16 bits of gray. Bayer
    images are interpolated bilinearly.
    """
    layout = _LAYOUTS.get(message.encoding)
    if layout is None:
        known = ", ".join(sorted(_LAYOUTS))
        raise DatasetError(f"{where}: encoding {message.encoding[:40]!r} is not supported; supported: {known}")
    samples = read_samples(message, layout.channels, layout.bits, where, layout.rows)
    if layout.bits == 16 and bits is None:
        if layout.channels > 1 or layout.conversion is not None:
            raise DatasetError(
                f"{where}: {message.encoding} has color; frames of 16 bits are gray: set `samples: 8_bits`"
            )
        return np.asarray(samples, dtype=np.uint16)
    return _rgb(eight_bits(samples, bits or 16) if layout.bits == 16 else samples, layout, where)


def read_samples(message: Any, channels: int, bits: int, where: str, rows_per_pixel: float = 1.0) -> NDArray[Any]:
    """The samples (H, W) or (H, W, C) of a sensor_msgs/Image: uint8, uint16, or float32. Raises DatasetError."""
    width, height, step = int(message.width), int(message.height * rows_per_pixel), int(message.step)
    row_bytes = width * channels * bits // 8
    if not 0 < width * height <= MAX_PIXELS or step < row_bytes or len(message.data) < step * (height - 1) + row_bytes:
        raise DatasetError(
            f"{where}: {width}x{height} {message.encoding} in rows of {step} bytes does not fit {len(message.data)} "
            f"bytes, or is more than {MAX_PIXELS} pixels"
        )
    step = row_bytes if height == 1 else step  # a single row's step may be arbitrarily large
    padded = np.zeros(step * height, np.uint8)
    padded[: len(message.data)] = message.data[: len(padded)]
    rows = np.ascontiguousarray(padded.reshape(height, step)[:, :row_bytes])
    order, kind = ">" if message.is_bigendian else "<", {8: "u1", 16: "u2", 32: "f4"}[bits]
    samples = rows.view(order + kind).reshape((height, width, channels) if channels > 1 else (height, width))
    return samples.astype(kind, copy=False)


def _rgb(samples: Any, layout: _Layout, where: str) -> Image:
    if layout.conversion is None:
        return np.asarray(np.ascontiguousarray(samples), dtype=np.uint8)
    try:
        return np.asarray(cv2.cvtColor(samples, layout.conversion), dtype=np.uint8)
    except cv2.error as error:
        raise DatasetError(f"{where}: an image of {samples.shape} cannot be converted: {error.err}") from error


def eight_bits(samples: NDArray[Any], bits: int) -> NDArray[np.uint8]:
    """Keep the upper 8 of the `bits` bits that samples use; larger samples become 255."""
    return np.asarray(np.minimum(samples >> (bits - 8), 255), dtype=np.uint8)


def is_supported(message: Any) -> bool:
    """Whether the encoding of an Image or CompressedImage is one of intensities that are supported."""
    return hasattr(message, "format") or message.encoding in _LAYOUTS


def bits_of(largest: int) -> int:
    """Bits per sample of a camera with this largest sample: 8, 10, 12, 14 or 16."""
    return max(8, (largest.bit_length() + 1) // 2 * 2)


def largest_sample(message: Any) -> int | None:
    """The largest sample of a 16-bit sensor_msgs/Image, None for others."""
    layout = _LAYOUTS.get(message.encoding)
    if layout is None or layout.bits != 16:
        return None
    whole = message.data[: len(message.data) // 2 * 2]
    return int(np.asarray(whole).view(">u2" if message.is_bigendian else "<u2").max(initial=0))


def decode_compressed(message: Any, bits: int | None, where: str) -> Image:
    """Decode a sensor_msgs/CompressedImage; 16 bits and Bayer patterns as in `decode_image`.

    Raises DatasetError, naming `where`.
    """
    content = np.ascontiguousarray(message.data)
    check_compressed(content, where)
    try:
        stored = cv2.imdecode(content, cv2.IMREAD_UNCHANGED)
    except cv2.error:
        stored = None
    if stored is None or stored.dtype not in (np.uint8, np.uint16):
        raise DatasetError(f"{where}: its {len(content)} bytes of {message.format[:60]!r} cannot be decoded")
    if stored.dtype == np.uint16 and bits is None and stored.ndim == 2:
        return np.asarray(stored, dtype=np.uint16)
    samples = eight_bits(stored, bits or 16) if stored.dtype == np.uint16 else stored
    if samples.ndim == 2:
        layout = _LAYOUTS.get(re.split(r"[;\s]", message.format.strip())[0], _LAYOUTS["mono8"])
        return _rgb(samples, layout if layout.channels == 1 else _LAYOUTS["mono8"], where)
    return _rgb(samples, _LAYOUTS["bgra8" if samples.shape[2] == 4 else "bgr8"], where)


def check_compressed(content: NDArray[np.uint8], where: str) -> None:
    """Raise DatasetError, before decoding, if the content is no image, truncated, or too large by its header."""
    PillowImage.init()
    formats = tuple(name for name in _COMPRESSED_FORMATS if name in PillowImage.OPEN)  # Pillow before 11.3 has no AVIF
    try:
        with (
            warnings.catch_warnings(action="ignore"),
            PillowImage.open(BytesIO(content.tobytes()), formats=formats) as opened,
        ):
            (width, height), kind = opened.size, opened.format
    except (OSError, ValueError, SyntaxError, PillowImage.DecompressionBombError) as error:
        raise DatasetError(f"{where}: contains no image that can be decoded: {error}") from error
    if not 0 < width * height <= MAX_PIXELS:
        raise DatasetError(f"{where}: declares {width}x{height}; at most {MAX_PIXELS} pixels are allowed")
    if kind == "JPEG" and b"\xff\xd9" not in content[-4096:].tobytes():
        raise DatasetError(f"{where}: the JPEG image is cut short")


def image_notes(message: Any, bits: int, largest: int | None) -> list[str]:
    """Notes on the conversion of a sensor_msgs/Image.

    largest: the largest sample seen in 16-bit images, None for others.
    """
    notes = []
    if largest is not None:
        fit = bits_of(largest)
        better = "" if fit == bits else f"; set `bits: {fit}`"
        notes.append(
            f"16-bit samples become 8-bit by their bits {bits - 8} to {bits - 1} (`bits: {bits}`); the largest in a "
            f"sample of the frames is {largest}{better}"
        )
    if message.encoding.startswith("bayer"):
        notes.append(f"{message.encoding} becomes RGB by bilinear interpolation (OpenCV)")
    elif message.encoding in ("yuv422", "uyvy", "yuv422_yuy2", "yuyv", "nv12", "nv21"):
        notes.append(f"{message.encoding} becomes RGB by BT.601 (OpenCV); the camera halved its chroma")
    return notes


def compressed_notes(message: Any) -> list[str]:
    """Notes on the loss in the frames of a sensor_msgs/CompressedImage."""
    content = np.ascontiguousarray(message.data).tobytes()
    if content.startswith(b"\x89PNG"):
        return ["the frames were recorded as PNG, which is lossless"]
    quality = quality_from_jpeg(content)
    measured = "" if quality is None else f", {quality}"
    kind = message.format.strip()[:60] or "compressed"
    return [already_coded(f"the topic has {kind} images{measured}")]
