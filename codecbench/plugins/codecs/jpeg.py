"""JPEG (ITU-T T.81) as the world writes it: libjpeg-turbo through OpenCV.

A bitstream is a plain JFIF file, so it carries no checksum. Its marker structure is checked strictly, and a
cut file never passes, but a flipped bit inside the entropy-coded data gives wrong pixels that nothing in the
format can reveal.
"""

from __future__ import annotations

from typing import Literal

import cv2
from pydantic import Field

from codecbench.core.contracts.codec import Capabilities, Codec
from codecbench.core.contracts.errors import BitstreamError, ImageError
from codecbench.core.contracts.image import MAX_PIXELS, Image, check_image
from codecbench.core.contracts.params import Params
from codecbench.core.counting.trace import NULL_TRACE, Trace
from codecbench.plugins.codecs.jfif.markers import (
    SOF_BASELINE,
    SOF_EXTENDED,
    SOF_PROGRESSIVE,
    SOS,
    check_plausible,
    read_frame_header,
    read_segments,
)
from codecbench.plugins.codecs.opencv import library_versions, read_image, write_image

_MAX_SIDE = 65500  # libjpeg's JPEG_MAX_DIMENSION
_MAX_SCANS = 32  # libjpeg's own progressive script takes 10; each scan costs a pass over the whole image
_MAX_PIXELS_OF_SCANS = MAX_PIXELS // 2
"""libjpeg holds all coefficients of a picture in several scans, and that must stay below half a gigabyte."""
_SAMPLING_FACTORS = {
    "444": cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444,
    "422": cv2.IMWRITE_JPEG_SAMPLING_FACTOR_422,
    "420": cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420,
}


class JpegParams(Params):
    """What libjpeg lets one choose."""

    quality: int = Field(75, ge=1, le=100, description="libjpeg's quality, 1 to 100")
    subsampling: Literal["444", "422", "420"] = Field("420", description="chroma of colour images; gray has none")
    optimize: bool = Field(False, description="Huffman tables made for the image (T.81 K.2), not the example ones")
    progressive: bool = Field(False, description="progressive scans, which always have optimised tables")


class Jpeg(Codec[JpegParams]):
    """The codec that cameras use."""

    name = "jpeg"
    version = "1"
    params_type = JpegParams
    capabilities = Capabilities()
    reference = "anchor"
    examples = (
        {},
        {"quality": 1, "subsampling": "444", "optimize": True},
        {"quality": 100, "subsampling": "422"},
        {"progressive": True},
    )

    def encode(self, image: Image, *, trace: Trace = NULL_TRACE) -> bytes:
        image = check_image(image)
        height, width = image.shape[:2]
        params = self.params
        most = _MAX_PIXELS_OF_SCANS if params.progressive else MAX_PIXELS
        if max(height, width) > _MAX_SIDE or height * width > most:
            raise ImageError(f"jpeg: {width}x{height} exceeds {_MAX_SIDE} a side or {most} pixels")
        options = [cv2.IMWRITE_JPEG_QUALITY, params.quality]
        options += [cv2.IMWRITE_JPEG_OPTIMIZE, int(params.optimize), cv2.IMWRITE_JPEG_PROGRESSIVE, params.progressive]
        options += [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, _SAMPLING_FACTORS[params.subsampling]]
        return write_image(image, ".jpg", options)

    def decode(self, bitstream: bytes, *, trace: Trace = NULL_TRACE) -> Image:
        return read_image(bitstream, _checked_shape(bitstream), "jpeg")

    def libraries(self) -> dict[str, str]:
        return library_versions("JPEG", "libjpeg-turbo")


def _checked_shape(bitstream: bytes) -> tuple[int, ...]:
    """The shape that a JPEG file promises, once its marker structure has been checked from end to end."""
    segments = read_segments(bitstream, "jpeg")
    header = read_frame_header(segments, "jpeg")
    if header.code not in (SOF_BASELINE, SOF_EXTENDED, SOF_PROGRESSIVE):
        raise BitstreamError(f"jpeg: frame type FF{header.code:02X}; baseline, extended and progressive are read")
    scans = sum(segment.code == SOS for segment in segments)
    if not 1 <= scans <= _MAX_SCANS:
        raise BitstreamError(f"jpeg: {scans} scans; 1 to {_MAX_SCANS} are read")
    if (scans > 1 or header.code == SOF_PROGRESSIVE) and header.width * header.height > _MAX_PIXELS_OF_SCANS:
        raise BitstreamError(f"jpeg: {header.width}x{header.height} in scans exceeds {_MAX_PIXELS_OF_SCANS} pixels")
    check_plausible(header, segments, "jpeg")
    return header.shape
