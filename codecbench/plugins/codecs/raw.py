"""Uncompressed pixels: the baseline of every comparison, and the template to copy for a new codec.

A bitstream is little-endian:

    bytes  content
    4      magic `RAW1`, or `RAW2` if a sample has two bytes
    1      channels: 1 gray, 3 RGB
    4      width
    4      height
    ...    height x width x channels samples, row by row
    4      CRC-32 of everything before it
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import replace

import numpy as np

from codecbench.core.contracts.codec import Capabilities, Codec
from codecbench.core.contracts.errors import BitstreamError, ImageError
from codecbench.core.contracts.image import LAYOUTS, MAX_PIXELS, Image, Layout, channel_count, check_image
from codecbench.core.contracts.params import NoParams
from codecbench.core.contracts.recipe import Recipe, Scene
from codecbench.core.counting.trace import NULL_TRACE, Trace

_DTYPES = {b"RAW1": "u1", b"RAW2": "<u2"}
_HEADER = struct.Struct("<4sBII")
_CRC = struct.Struct("<I")


class Raw(Codec[NoParams]):
    """The identity codec: the size of a frame and the result of a task without any compression."""

    name = "raw"
    version = "1"
    params_type = NoParams
    capabilities = Capabilities(bits=(8, 16), lossless=True)
    examples = ({},)
    reference = "baseline"

    def encode(self, image: Image, *, trace: Trace = NULL_TRACE) -> bytes:
        image = check_image(image, bits=(8, 16))
        height, width = image.shape[:2]
        if height * width > MAX_PIXELS:
            raise ImageError(
                f"raw: an image of {width}x{height} exceeds the {MAX_PIXELS} pixels that a decoder accepts"
            )
        magic = b"RAW%d" % image.itemsize
        header = _HEADER.pack(magic, channel_count(image), width, height)
        content = header + image.astype(_DTYPES[magic], copy=False).tobytes()
        return content + _CRC.pack(zlib.crc32(content))

    def recipes(self, scene: Scene) -> tuple[Recipe, ...]:
        note = "Subscribe to the raw topic, transport `raw`, which every node publishes."
        header_note = "codecbench adds a header and a checksum to the pixels; other stacks do not."
        python = (replace(recipe, note=header_note) for recipe in super().recipes(scene))
        return (Recipe("ROS 2 image_transport", "yaml", "", note), *python)

    def decode(self, bitstream: bytes, *, trace: Trace = NULL_TRACE) -> Image:
        if len(bitstream) < _HEADER.size + _CRC.size:
            raise BitstreamError(f"raw: {len(bitstream)} bytes are too few for a header and a checksum")
        magic, channels, width, height = _HEADER.unpack_from(bitstream)
        dtype = np.dtype(_DTYPES.get(magic, "V"))
        layout = Layout(channels, 8 * dtype.itemsize)
        if layout not in LAYOUTS:
            raise BitstreamError(f"raw: not a raw bitstream (magic {magic!r}, {channels} channels)")
        expected = _HEADER.size + width * height * channels * dtype.itemsize + _CRC.size
        if not 0 < width * height <= MAX_PIXELS or len(bitstream) != expected:
            raise BitstreamError(f"raw: {width}x{height}x{channels} needs {expected} bytes, got {len(bitstream)}")
        (crc,) = _CRC.unpack_from(bitstream, len(bitstream) - _CRC.size)
        if crc != zlib.crc32(memoryview(bitstream)[: -_CRC.size]):
            raise BitstreamError("raw: checksum mismatch, the bitstream is damaged")
        shape = (height, width) if channels == 1 else (height, width, channels)
        pixels = np.frombuffer(bitstream, dtype, width * height * channels, _HEADER.size)
        return pixels.reshape(shape).astype(f"uint{layout.bits}")
