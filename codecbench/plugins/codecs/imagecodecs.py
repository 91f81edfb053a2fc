"""JPEG XL, JPEG-LS, High-Throughput JPEG 2000, WebP and AVIF through imagecodecs."""

from __future__ import annotations

import re
import struct
from inspect import signature
from typing import Any, Literal

from pydantic import Field

from codecbench.core.contracts.codec import Capabilities
from codecbench.core.contracts.errors import BitstreamError, Unsupported
from codecbench.core.contracts.params import Params
from codecbench.core.contracts.recipe import Recipe, Scene
from codecbench.plugins.codecs.enveloped import EnvelopedCodec, qualified_version
from codecbench.plugins.codecs.recipes import FFMPEG, GSTREAMER, ffmpeg, gstreamer, opencv, pixel_format

_MAX_NEAR = {8: 127, 16: 255}  # ITU-T T.87 C.2.3
_SIZ = struct.Struct(">HHHH8IH")


class JpegXlParams(Params):
    """Set libjxl's distance and effort."""

    distance: float = Field(1.0, ge=0, le=25, description="Butteraugli distance; 0 is lossless, 1 visually lossless")
    effort: int = Field(4, ge=1, le=9, description="encoding effort, 1 (fast) to 9 (small files)")


class JpegXl(EnvelopedCodec[JpegXlParams]):
    """JPEG XL (ISO/IEC 18181) by libjxl."""

    name = "jpegxl"
    version = qualified_version("1", "jpegxl", "libjxl 0.11.2")
    params_type = JpegXlParams
    examples = ({}, {"distance": 0})
    magic, function, decoding = b"ICxl", "jpegxl", {"numthreads": 1}

    def is_lossless(self) -> bool:
        return self.params.distance == 0

    def _arguments(self, bits: int) -> dict[str, Any]:
        lossless = self.is_lossless()
        return {"distance": self.params.distance, "lossless": lossless, "effort": self.params.effort, "numthreads": 1}

    def _other_recipes(self, scene: Scene) -> tuple[Recipe, ...]:
        params = self.params
        options = f"-c:v libjxl -pix_fmt {pixel_format(scene)} -distance {params.distance:g} -effort {params.effort}"
        note = "Frames depend on the release of libjxl: of 0.7 they had 0.91 to 0.96 of the bytes of 0.11."
        return (ffmpeg(scene, [options], "%06d.jxl", note),)


class JpegLsParams(Params):
    """Set the error bound of near-lossless coding."""

    near: int = Field(
        0, ge=0, le=255, description="largest error of any sample, in gray levels, up to 127 of 8 bits; 0 is lossless"
    )


class JpegLs(EnvelopedCodec[JpegLsParams]):
    """JPEG-LS (ITU-T T.87) by CharLS."""

    name = "jpegls"
    params_type = JpegLsParams
    examples = ({}, {"near": 3})
    magic, function = b"ICls", "jpegls"

    def is_lossless(self) -> bool:
        return self.params.near == 0

    def _arguments(self, bits: int) -> dict[str, Any]:
        if self.params.near > _MAX_NEAR[bits]:
            raise Unsupported(f"jpegls: near {self.params.near} exceeds {_MAX_NEAR[bits]}, the most of {bits} bits")
        offered = signature(self._library.jpegls_encode).parameters
        return {"level": self.params.near} | ({"spiff": True} if "spiff" in offered else {})  # older releases always do

    def _other_recipes(self, scene: Scene) -> tuple[Recipe, ...]:
        if not self.is_lossless():
            return (Recipe(FFMPEG, "sh", "", "FFmpeg's jpegls encoder is lossless only; it has no near."),)
        return (ffmpeg(scene, [f"-c:v jpegls -pix_fmt {pixel_format(scene)}"], "%06d.jls"),)


class Htj2kParams(Params):
    """Set OpenJPH's quantizer."""

    step: float = Field(
        0.01, ge=0, le=0.5, description="base step of the 9/7 wavelet; 0 is lossless, with the 5/3 wavelet"
    )


class Htj2k(EnvelopedCodec[Htj2kParams]):
    """High-Throughput JPEG 2000 (ITU-T T.814), encoded by OpenJPH and decoded by OpenJPEG.

    OpenJPH's binding wraps samples that overshoot black or white around; OpenJPEG clips them.
    """

    name = "htj2k"
    version = "2"
    params_type = Htj2kParams
    examples = ({}, {"step": 0})
    magic, function, decoder, decoding = b"ICht", "htj2k", "jpeg2k", {"numthreads": 1}

    def is_lossless(self) -> bool:
        return self.params.step == 0

    def _check_declared_size(self, content: bytes, shape: tuple[int, ...], bits: int) -> None:
        """Check SIZ (T.800 A.5.1), whose size OpenJPEG decodes: one tile, as OpenJPH writes it."""
        height, width, channels = (*shape, 1)[:3]
        declared = _SIZ.pack(0xFF4F, 0xFF51, _SIZ.size - 4 + 3 * channels, 0, *2 * (width, height, 0, 0), channels)
        declared += bytes((bits - 1, 1, 1)) * channels
        if content[:6] + content[8 : len(declared)] != declared[:6] + declared[8:]:  # bytes 6 and 7: the profile
            raise BitstreamError(f"{self.name}: the codestream does not declare one tile of {width}x{height} pixels")

    def _arguments(self, bits: int) -> dict[str, Any]:
        return {"reversible": True} if self.is_lossless() else {"reversible": False, "level": self.params.step}


class WebpParams(Params):
    """Set libwebp's quality and method."""

    quality: float = Field(75, ge=0, le=100, description="libwebp's quality, with 4:2:0 chroma; unused if lossless")
    lossless: bool = Field(False, description="code every pixel exactly")
    method: int = Field(4, ge=0, le=6, description="encoding effort, 0 (fast) to 6 (small files)")


class Webp(EnvelopedCodec[WebpParams]):
    """WebP (RFC 9649) by libwebp. Gray is coded as color, because the format has nothing else."""

    name = "webp"
    params_type = WebpParams
    examples = ({}, {"lossless": True})
    capabilities = Capabilities()
    magic, function, color_only, max_side = b"ICwp", "webp", True, 16383

    def is_lossless(self) -> bool:
        return self.params.lossless

    def _arguments(self, bits: int) -> dict[str, Any]:
        quality = 75 if self.params.lossless else self.params.quality
        return {"level": quality, "lossless": self.params.lossless, "method": self.params.method, "numthreads": 1}

    def _other_recipes(self, scene: Scene) -> tuple[Recipe, ...]:
        params = self.params
        lossless = "true" if params.lossless else "false"
        element = f"webpenc preset=none quality={params.quality:g} speed={params.method} lossless={lossless}"
        options = f"-c:v libwebp -pix_fmt bgra -quality {params.quality:g} -compression_level {params.method}"
        flag = 101 if params.lossless else round(params.quality)
        method = "" if params.method == 4 else "OpenCV always uses method 4, so frames are a little larger or smaller."
        method = "" if params.lossless else method
        return (
            gstreamer(scene, "format=RGB", element, "%06d.webp"),
            ffmpeg(scene, [options, f"-lossless {int(params.lossless)}"], "%06d.webp"),
            opencv(scene, ".webp", {"IMWRITE_WEBP_QUALITY": max(flag, 1)}, method),
        )


class AvifParams(Params):
    """Set libavif's quality, speed and chroma subsampling."""

    quality: int = Field(60, ge=0, le=99, description="libavif's quality; every value is lossy")
    speed: int = Field(8, ge=0, le=10, description="encoding speed, 0 (small files) to 10 (fast)")
    subsampling: Literal["444", "422", "420"] = Field("420", description="chroma subsampling")


class Avif(EnvelopedCodec[AvifParams]):
    """AVIF (AV1 still pictures) by libavif. Gray is coded as color: the binding codes gray only losslessly."""

    name = "avif"
    version = qualified_version("1", "avif", "libavif 1.4.0")
    params_type = AvifParams
    examples = ({}, {"subsampling": "444", "quality": 90})
    capabilities = Capabilities()
    magic, function, color_only, decoding = b"ICav", "avif", True, {"numthreads": 1}

    def _check_declared_size(self, content: bytes, shape: tuple[int, ...], bits: int) -> None:
        """Check the property `ispe` (ISO/IEC 23008-12, 6.5.3), for whose size libavif allocates up to 2^28 pixels."""
        declared = {content[at.end() : at.end() + 12] for at in re.finditer(b"ispe", content.partition(b"mdat")[0])}
        if struct.pack(">III", 0, shape[1], shape[0]) not in declared or len(declared) > 1:
            raise BitstreamError(f"{self.name}: the file does not declare {shape[1]}x{shape[0]} pixels")

    def _arguments(self, bits: int) -> dict[str, Any]:
        params = self.params
        chroma = self._library.AVIF.PIXEL_FORMAT[f"YUV{params.subsampling}"]  # releases spell its text differently
        return {"level": params.quality, "speed": params.speed, "pixelformat": chroma, "numthreads": 1}

    def _other_recipes(self, scene: Scene) -> tuple[Recipe, ...]:
        options = {"IMWRITE_AVIF_QUALITY": self.params.quality, "IMWRITE_AVIF_SPEED": self.params.speed}
        is_same = self.params.subsampling == "420"
        note = "" if is_same else "It codes chroma as 4:2:0, so frames are smaller."
        return (
            opencv(scene, ".avif", options, note),
            Recipe(f"{GSTREAMER} and {FFMPEG}", "sh", "", "Their quality scales of AV1 differ from libavif's."),
        )
