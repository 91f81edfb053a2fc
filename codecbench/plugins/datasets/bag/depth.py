"""Depth images from messages: 16UC1 and 32FC1, as they are or as compressed_depth_image_transport sends them."""

from __future__ import annotations

import struct
from typing import Any, Final

import cv2
import numpy as np

from codecbench.core.contracts.errors import BitstreamError, DatasetError
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.sequence import Depth
from codecbench.plugins.codecs.quantizer import DepthScale
from codecbench.plugins.codecs.rvl import Rvl
from codecbench.plugins.datasets.bag.images import check_compressed, decode_image, read_samples
from codecbench.plugins.datasets.selection import already_coded

_COMPRESSED_DEPTH: Final = "compressedDepth"
_CONFIGURATION: Final = struct.Struct("<iff")
_PNG_START: Final = b"\x89PNG"


def is_depth(message: Any, topic: str) -> bool:
    """Whether an Image or CompressedImage is depth by its encoding, or of 16UC1 by the name of its topic."""
    if hasattr(message, "format"):
        return _COMPRESSED_DEPTH in message.format
    return message.encoding == "32FC1" or (message.encoding == "16UC1" and "depth" in topic.lower())


def decode_depth(message: Any, depth: Depth, where: str) -> Image:
    """The depth (H, W) of a message in steps of `depth`: unchanged from 16 bits, rounded from meters.

    Raises DatasetError, naming `where`.
    """
    if hasattr(message, "format"):
        return _decode_compressed(message, depth, where)
    if message.encoding != "32FC1":
        return decode_image(message, None, where)
    steps = np.nan_to_num(np.rint(read_samples(message, 1, 32, where).astype(np.float64) / depth.unit_m), posinf=-1.0)
    return np.where((steps < 1) | (steps > 65535), depth.unknown, steps).astype(np.uint16)


def _decode_compressed(message: Any, depth: Depth, where: str) -> Image:
    """Decode a payload of compressed_depth_image_transport: 12 bytes of configuration, then PNG or RVL."""
    content = np.ascontiguousarray(message.data)
    if _COMPRESSED_DEPTH not in message.format or len(content) <= _CONFIGURATION.size:
        raise DatasetError(f"{where}: {len(content)} bytes of {message.format[:60]!r} are not compressed depth")
    _, step, offset = _CONFIGURATION.unpack_from(content.data)
    coded = content[_CONFIGURATION.size :]
    pixels: Any
    try:
        if coded[:4].tobytes() == _PNG_START:
            check_compressed(coded, where)
            pixels = cv2.imdecode(coded, cv2.IMREAD_UNCHANGED)
        else:
            pixels = Rvl.create().decode(content.tobytes())
    except (BitstreamError, cv2.error) as error:
        raise DatasetError(f"{where}: its depth cannot be decoded: {error}") from error
    if pixels is None or pixels.dtype != np.uint16 or pixels.ndim != 2:
        raise DatasetError(f"{where}: {len(content)} bytes of {message.format[:60]!r} hold no whole 16-bit depth image")
    if not message.format.strip().startswith("32FC1"):
        return np.asarray(pixels, np.uint16)
    return DepthScale("inverse", 16, depth.unknown, depth.unit_m, step, offset, 0.0).pixels(pixels)


def depth_notes(message: Any, depth: Depth) -> list[str]:
    """Notes on how distances were recorded and converted."""
    step = f"steps of {1e3 * depth.unit_m:g} mm"
    if not hasattr(message, "format"):
        is_exact = message.encoding != "32FC1"
        return [f"pixels are distances in {step}" if is_exact else f"distances in meters (32FC1) are rounded to {step}"]
    kind = message.format.strip()[:60]
    if not message.format.strip().startswith("32FC1"):
        return [f"pixels are distances in {step}, recorded as {kind}, which is lossless"]
    return [already_coded(f"the topic has inverse depth ({kind}), rounded to {step}")]
