"""PNG (ISO/IEC 15948) through OpenCV: lossless, with a CRC in every chunk.

Quantized depth follows 12 bytes, as in ROS's compressed_depth_image_transport: int32 0, float32 A, float32 B.
"""

from __future__ import annotations

import math
import struct
import zlib
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from codecbench.core.contracts.codec import Capabilities, Codec
from codecbench.core.contracts.errors import BitstreamError, ImageError
from codecbench.core.contracts.image import MAX_PIXELS, Image, check_image
from codecbench.core.contracts.params import Params
from codecbench.core.contracts.recipe import Recipe, Scene
from codecbench.core.counting.trace import NULL_TRACE, Trace
from codecbench.plugins.codecs.opencv import Options, flags, library_versions, read_image, write_image
from codecbench.plugins.codecs.quantizer import DepthParams, DepthQuantization, DepthScale, FarDistance
from codecbench.plugins.codecs.recipes import FFMPEG, GSTREAMER, compressed_image_transport, opencv

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_CHUNK = struct.Struct(">I4s")
_CRC = struct.Struct(">I")
_INVERSE_DEPTH = struct.Struct("<iff")
_HEADER = struct.Struct(">IIBBBBB")
_GRAY, _RGB = 0, 2
_MAX_DEFLATE_RATIO = 1032  # a deflate stream cannot expand more (RFC 1951: 258 bytes from two bits)


class PngParams(Params):
    """Set zlib's effort and the quantizer of 16-bit depth, in steps of 1 mm with 0 for no distance."""

    effort: Annotated[int, Field(ge=0, le=9)] | None = Field(
        None, description="zlib level, 0 (none) to 9 (smallest); default: OpenCV's fast one"
    )
    quantizer: Literal["none", "inverse"] = Field(
        "none", description="inverse: of 16-bit depth, lossy, as compressed_depth_image_transport sends 32FC1"
    )
    far_m: FarDistance = 10.0
    depth_quantization: DepthQuantization = 100.0

    @model_validator(mode="after")
    def _check_quantizer(self) -> Self:
        if self.quantizer == "none" and (self.far_m, self.depth_quantization) != (10.0, 100.0):
            raise ValueError("far_m and depth_quantization are for inverse depth; set quantizer to inverse")
        return self

    @property
    def depth(self) -> DepthParams | None:
        """How 16-bit frames are quantized; None if they are not."""
        if self.quantizer == "none":
            return None
        return DepthParams(
            quantizer="inverse", depth_bits=16, far_m=self.far_m, depth_quantization=self.depth_quantization
        )


class Png(Codec[PngParams]):
    """The lossless reference: `cr_percent` is relative to this codec at its defaults."""

    name = "png"
    version = "1"
    params_type = PngParams
    capabilities = Capabilities(bits=(8, 16))
    examples = ({}, {"effort": 9})

    def encode(self, image: Image, *, trace: Trace = NULL_TRACE) -> bytes:
        image = check_image(image, bits=(8, 16))
        if image.shape[0] * image.shape[1] > MAX_PIXELS:
            raise ImageError(f"png: an image of shape {image.shape} exceeds the {MAX_PIXELS} pixels of a decoder")
        depth, header = self.params.depth, b""
        if image.dtype == np.uint16 and depth is not None:
            header = _INVERSE_DEPTH.pack(0, depth.depth_scale.step, depth.depth_scale.offset)
            image = depth.codes(image)
        return header + write_image(image, ".png", flags(self._options()))

    def is_lossless(self) -> bool:
        return self.params.quantizer == "none"

    def remark_at(self, bits: int) -> str:
        return "" if bits == 8 or self.params.depth is None else self.params.depth.depth_remark

    def _options(self) -> Options:
        """Options for OpenCV."""
        return {} if self.params.effort is None else {"IMWRITE_PNG_COMPRESSION": self.params.effort}

    def recipes(self, scene: Scene) -> tuple[Recipe, ...]:
        effort = self.params.effort
        note = "" if effort is not None else "No level equals OpenCV's default; 1 came within 1 % of it."
        keys: dict[str, str | float] = {"format": "png", "png_level": 1 if effort is None else effort}
        if scene.bits == 16 and self.params.depth is not None:
            keys |= {"depth_max": self.params.far_m, "depth_quantization": self.params.depth_quantization}
            return (compressed_image_transport(keys, "Publish 32FC1, in meters.", 16), *super().recipes(scene))
        return (
            compressed_image_transport(keys, note, scene.bits),
            opencv(scene, ".png", self._options()),
            Recipe(
                GSTREAMER, "sh", "", "pngenc filters no rows: frames of the same level were up to 1.6 times as large."
            ),
            Recipe(
                FFMPEG, "sh", "", "FFmpeg's png encoder filters rows differently: frames were up to 1.6 times as large."
            ),
        )

    def decode(self, bitstream: bytes, *, trace: Trace = NULL_TRACE) -> Image:
        scale, start = None, 0
        if bitstream[:4] == bytes(4) and len(bitstream) > _INVERSE_DEPTH.size:
            _, a, b = _INVERSE_DEPTH.unpack_from(bitstream)
            scale, start = DepthScale("inverse", 16, 0, 0.001, a, b, 0.0), _INVERSE_DEPTH.size
        shape, bits = _read_shape(bitstream[start:])
        if scale is not None and not (bits == 16 and scale.step > 0 and math.isfinite(scale.step + scale.offset)):
            raise BitstreamError(f"png: inverse depth of {bits} bits, A {scale.step:g} and B {scale.offset:g}")
        image = read_image(bitstream[start:], shape, "png", bits)
        return image if scale is None else scale.pixels(image)

    def libraries(self) -> dict[str, str]:
        return library_versions("PNG", "libpng")


def _read_shape(bitstream: bytes) -> tuple[tuple[int, ...], int]:
    """Check every chunk and its CRC, and return the shape that a PNG file promises, and the bits of its samples.

    Accepts what `encode` writes: 8 bits, gray or RGB, or 16 bits, gray, not interlaced, nothing after the end.
    """
    if bitstream[: len(_SIGNATURE)] != _SIGNATURE:
        raise BitstreamError(f"png: no PNG signature in {bitstream[:8]!r}")
    shape: tuple[int, ...] | None = None
    bits = 0
    compressed_bytes, position, kind = 0, len(_SIGNATURE), b""
    while kind != b"IEND":
        kind, content, position = _read_chunk(bitstream, position)
        if (kind == b"IHDR") != (shape is None):
            raise BitstreamError(f"png: chunk {kind!r} is misplaced: IHDR comes first and once")
        if kind == b"IHDR":
            shape, bits = _shape_from_header(content)
        elif kind == b"IDAT":
            compressed_bytes += len(content)
        elif kind != b"IEND":
            raise BitstreamError(f"png: unexpected chunk {kind!r}; only IHDR, IDAT and IEND are read")
    if position != len(bitstream):
        raise BitstreamError(f"png: {len(bitstream) - position} bytes after the end")
    assert shape is not None
    row_bytes = 1 + shape[1] * (3 if len(shape) == 3 else 1) * bits // 8
    if shape[0] * row_bytes > _MAX_DEFLATE_RATIO * compressed_bytes:
        raise BitstreamError(f"png: {compressed_bytes} compressed bytes are too few for an image of shape {shape}")
    return shape, bits


def _read_chunk(bitstream: bytes, position: int) -> tuple[bytes, memoryview, int]:
    """Return the type and content of the chunk at `position`, and the start of the next one."""
    overhead = _CHUNK.size + _CRC.size
    if position + overhead > len(bitstream):
        raise BitstreamError(f"png: ends inside a chunk at byte {position}")
    length, kind = _CHUNK.unpack_from(bitstream, position)
    if position + overhead + length > len(bitstream):
        raise BitstreamError(f"png: chunk {kind!r} at byte {position} is cut short")
    end = position + _CHUNK.size + length
    if zlib.crc32(memoryview(bitstream)[position + 4 : end]) != _CRC.unpack_from(bitstream, end)[0]:
        raise BitstreamError(f"png: checksum mismatch in chunk {kind!r} at byte {position}")
    return kind, memoryview(bitstream)[position + _CHUNK.size : end], end + _CRC.size


def _shape_from_header(content: memoryview) -> tuple[tuple[int, ...], int]:
    if len(content) != _HEADER.size:
        raise BitstreamError(f"png: IHDR has {len(content)} bytes, not {_HEADER.size}")
    width, height, depth, color, compression, filtering, interlace = _HEADER.unpack(content)
    if (depth, color) not in ((8, _GRAY), (8, _RGB), (16, _GRAY)) or compression or filtering or interlace:
        got = f"depth {depth}, color type {color}, interlace {interlace}"
        raise BitstreamError(f"png: {got}; depth 8 of color type 0 or 2, and 16 of 0 are read, not interlaced")
    if not 0 < width * height <= MAX_PIXELS:
        raise BitstreamError(f"png: {width}x{height} is not within 1..{MAX_PIXELS} pixels")
    return ((height, width) if color == _GRAY else (height, width, 3)), depth
