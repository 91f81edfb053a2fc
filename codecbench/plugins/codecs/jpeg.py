"""JPEG (ITU-T T.81) by libjpeg-turbo through OpenCV.

A bitstream is a plain JFIF file without a checksum. Its marker structure is checked strictly, so truncated files are
always refused. A flipped bit inside the entropy-coded data gives wrong pixels that the format cannot reveal.

With `restart` the scan has restart markers, as cameras and RTP (RFC 2435) write them: the rows between two of them
decode independently. Missing rows are interpolated between the nearest received ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, Self

import numpy as np
from pydantic import Field, model_validator

from codecbench.core.contracts.codec import Capabilities, Codec, Fragment, PartialImage
from codecbench.core.contracts.errors import BitstreamError, ImageError
from codecbench.core.contracts.image import MAX_PIXELS, Image, check_image
from codecbench.core.contracts.params import Params
from codecbench.core.contracts.recipe import Recipe, Scene
from codecbench.core.counting.trace import NULL_TRACE, Trace
from codecbench.plugins.codecs.jfif import (
    SOF_BASELINE,
    SOF_EXTENDED,
    SOF_PROGRESSIVE,
    SOS,
    check_plausible,
    read_frame_header,
    read_segments,
)
from codecbench.plugins.codecs.jpeg_restart import salvage
from codecbench.plugins.codecs.opencv import Options, flags, library_versions, read_image, write_image
from codecbench.plugins.codecs.recipes import (
    CONVERSION,
    FFMPEG,
    FULL_RANGE,
    compressed_image_transport,
    gstreamer,
    opencv,
    sentences,
)

_MAX_SIDE = 65500  # libjpeg's JPEG_MAX_DIMENSION
_MAX_SCANS = 32  # libjpeg's own progressive script takes 10; each scan costs a pass over the whole image
_MAX_PIXELS_OF_SCANS = MAX_PIXELS // 2
"""libjpeg holds all coefficients of an image in several scans; this keeps them below half a gigabyte."""
_EXACT_BELOW = 95  # finer, the rounding of a color conversion shows in the size
_GSTREAMER_FORMATS = {"444": "Y444", "422": "Y42B", "420": "I420"}


class JpegParams(Params):
    """Set libjpeg's quality, chroma subsampling, Huffman tables, scans and restart markers."""

    quality: int = Field(75, ge=1, le=100, description="libjpeg's quality, 1 to 100")
    subsampling: Literal["444", "422", "420"] = Field(
        "420", description="chroma subsampling of color images; gray images have no chroma"
    )
    optimize: bool = Field(
        False, description="compute Huffman tables for each image (T.81 K.2) instead of using the example tables"
    )
    progressive: bool = Field(False, description="use progressive scans, which always have optimized tables")
    restart: int = Field(
        0, ge=0, le=8, description="rows of MCUs (8 or 16 pixels high) from one restart marker to the next, 0 for none"
    )

    @model_validator(mode="after")
    def _check_restart(self) -> Self:
        if self.restart and self.progressive:
            raise ValueError("restart needs sequential JPEG: a lost part of a progressive file affects every row")
        return self


class Jpeg(Codec[JpegParams]):
    """JPEG, the codec of most cameras and the BD-rate anchor."""

    name = "jpeg"
    version = "1"
    params_type = JpegParams
    capabilities = Capabilities(partial_decoding=True)
    reference = "anchor"
    examples = (
        {},
        {"quality": 1, "subsampling": "444", "optimize": True},
        {"quality": 100, "subsampling": "422"},
        {"progressive": True},
        {"quality": 50, "restart": 1},
    )

    def encode(self, image: Image, *, trace: Trace = NULL_TRACE) -> bytes:
        image = check_image(image)
        height, width = image.shape[:2]
        params = self.params
        most = _MAX_PIXELS_OF_SCANS if params.progressive else MAX_PIXELS
        if max(height, width) > _MAX_SIDE or height * width > most:
            raise ImageError(f"jpeg: {width}x{height} exceeds {_MAX_SIDE} a side or {most} pixels")
        return write_image(image, ".jpg", flags(self._options(width, is_gray=image.ndim == 2)))

    def _options(self, width: int, *, is_gray: bool) -> Options:
        """Options for OpenCV."""
        params = self.params
        options: Options = {"IMWRITE_JPEG_QUALITY": params.quality}
        options |= {"IMWRITE_JPEG_OPTIMIZE": 1} if params.optimize else {}
        options |= {"IMWRITE_JPEG_PROGRESSIVE": 1} if params.progressive else {}
        options["IMWRITE_JPEG_SAMPLING_FACTOR"] = f"IMWRITE_JPEG_SAMPLING_FACTOR_{params.subsampling}"
        if params.restart:
            pixels = 8 if is_gray or params.subsampling == "444" else 16
            options["IMWRITE_JPEG_RST_INTERVAL"] = params.restart * -(-width // pixels)
        return options

    def recipes(self, scene: Scene) -> tuple[Recipe, ...]:
        params, is_gray = self.params, scene.channels == 1
        gaps = []
        if params.progressive:
            gaps.append("It writes sequential frames, not progressive ones, so they are a few percent larger.")
        elif params.optimize:
            gaps.append("It uses the standard's Huffman tables, not the frame's, so frames are larger.")
        if params.restart:
            gaps.append("It writes no restart markers, so a lost packet destroys the rest of the frame.")
        chroma = ""
        if not is_gray and params.subsampling != "420":
            chroma = f"It codes chroma as 4:2:0, not {':'.join(params.subsampling)}, so frames are smaller."
        finest = CONVERSION if not is_gray and params.quality > _EXACT_BELOW else ""
        element = f"jpegenc idct-method=islow quality={params.quality}"
        caps = "format=GRAY8" if is_gray else f"format={_GSTREAMER_FORMATS[params.subsampling]},{FULL_RANGE}"
        return (
            compressed_image_transport(
                {"format": "jpeg", "jpeg_quality": params.quality}, sentences(chroma, *gaps)
            ),
            gstreamer(scene, caps, element, "%06d.jpg", sentences(*gaps, finest)),
            opencv(scene, ".jpg", self._options(scene.width, is_gray=is_gray)),
            Recipe(
                FFMPEG, "sh", "",
                "FFmpeg's mjpeg encoder has its own quantizer scale (-q:v), not libjpeg's quality: use another stack.",
            ),
        )  # fmt: skip

    def decode(self, bitstream: bytes, *, trace: Trace = NULL_TRACE) -> Image:
        return read_image(bitstream, _read_shape(bitstream), "jpeg")

    def decode_partial(self, fragments: Sequence[Fragment], *, trace: Trace = NULL_TRACE) -> PartialImage:
        """Decode the rows of complete restart intervals and interpolate the rows between them.

        Raises BitstreamError for files without `restart` too: any missing part makes them undecodable.
        """
        if len(fragments) == 1 and fragments[0].offset == 0 and fragments[0].data.endswith(b"\xff\xd9"):
            return PartialImage.of_whole(self.decode(fragments[0].data))
        partial = salvage(fragments, "jpeg")
        strip = self.decode(partial.file)
        is_received = np.zeros(partial.header.height, dtype=bool)
        is_received[partial.rows] = True
        whole = is_received.copy()
        if len({component.v for component in partial.header.components}) > 1:  # chroma is smoothed across rows
            whole[1:] &= is_received[:-1]
            whole[:-1] &= is_received[1:]
        image = _interpolate_rows(strip, partial.rows, partial.header.height)
        return PartialImage(image, np.repeat(whole[:, None], partial.header.width, axis=1))

    def libraries(self) -> dict[str, str]:
        return library_versions("JPEG", "libjpeg-turbo")


def _read_shape(bitstream: bytes) -> tuple[int, ...]:
    """Check the marker structure of a JPEG file from end to end and return the shape that it promises."""
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


def _interpolate_rows(strip: Image, rows: Sequence[int], height: int) -> Image:
    """Place the rows of `strip` at `rows` and interpolate the others linearly; the outermost rows are repeated."""
    image = np.empty((height, *strip.shape[1:]), np.uint8)
    image[rows] = strip
    missing = np.setdiff1d(np.arange(height), rows)
    place = np.interp(missing, rows, np.arange(len(rows)))
    above = place.astype(np.int64)
    share = (place - above).reshape(-1, *[1] * (strip.ndim - 1))
    below = np.minimum(above + 1, len(rows) - 1)
    image[missing] = np.rint((1.0 - share) * strip[above] + share * strip[below])
    return image
