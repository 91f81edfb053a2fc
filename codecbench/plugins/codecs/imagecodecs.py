"""JPEG XL, JPEG-LS, High-Throughput JPEG 2000, WebP and AVIF through imagecodecs.

Every bitstream is a file of its standard behind our header of 18 bytes, little-endian: magic, `IC` and two letters (4);
channels (1); reserved 0 (1); width (4); height (4); CRC-32 (4) of these and the file. The header detects damage, bounds
what a decoder allocates, and keeps gray images gray if the standard has only color.
"""

from __future__ import annotations

import re
import struct
import zlib
from abc import abstractmethod
from inspect import signature
from types import ModuleType
from typing import Any, ClassVar, Literal, TypeVar

import numpy as np
from pydantic import Field

from codecbench.core.contracts.codec import Capabilities, Codec
from codecbench.core.contracts.errors import BitstreamError, ImageError, Unsupported
from codecbench.core.contracts.image import MAX_PIXELS, Image, channel_count, check_image, gray_from_image
from codecbench.core.contracts.params import Params
from codecbench.core.contracts.recipe import Recipe, Scene
from codecbench.core.counting.trace import NULL_TRACE, Trace
from codecbench.plugins.codecs.recipes import FFMPEG, GSTREAMER, ffmpeg, gstreamer, opencv

_HEADER = struct.Struct("<4sBBII")
_CRC = struct.Struct("<I")
_CONTENT_START = _HEADER.size + _CRC.size
_SIZ = struct.Struct(">HHHH8IH")
P = TypeVar("P", bound=Params)


def _qualified_version(version: str, function: str, library: str) -> str:
    """Return `version` if `function` is of this library, such as `libavif 1.4.0`; else `version+` and its own library.

    For codecs whose rate or pixels change with the library, so that one run never mixes their results.
    """
    try:
        installed: str = getattr(_load_imagecodecs((function,)), f"{function}_version")()
    except Unsupported:
        return version
    return version if installed == library else f"{version}+{installed.replace(' ', '-')}"


def _load_imagecodecs(functions: tuple[str, ...]) -> ModuleType:
    try:
        import imagecodecs  # an optional extra
    except ImportError as error:
        raise Unsupported("imagecodecs is not installed; run: pip install 'codecbench[codecs]'") from error
    for function in functions:
        if not getattr(imagecodecs, function.upper()).available:
            raise Unsupported(f"this build of imagecodecs has no {function}; run: pip install --upgrade imagecodecs")
    return imagecodecs  # type: ignore[no-any-return]


class _EnvelopedCodec(Codec[P]):
    """Base class of the codecs below. Subclasses name their functions in imagecodecs and choose the arguments."""

    version = "1"
    capabilities = Capabilities()
    magic: ClassVar[bytes]
    function: ClassVar[str]
    decoder: ClassVar[str] = ""
    """Function that decodes, if it is not of the library that encodes."""
    color_only: ClassVar[bool] = False
    max_side: ClassVar[int] = 65535
    decoding: ClassVar[dict[str, Any]] = {}
    """Keyword arguments of the decoding function."""

    def __init__(self, params: P) -> None:
        super().__init__(params)
        self._functions = tuple(name for name in (self.function, self.decoder) if name)
        self._library = _load_imagecodecs(self._functions)

    @abstractmethod
    def _arguments(self) -> dict[str, Any]:
        """Keyword arguments of the encoding function."""

    def recipes(self, scene: Scene) -> tuple[Recipe, ...]:
        """The call of imagecodecs, and recipes of other stacks."""
        layout = "gray" if scene.channels == 1 else "rgb"
        values = {name: int(value) if isinstance(value, int) else value for name, value in self._arguments().items()}
        arguments = "".join(f", {name}={value}" for name, value in values.items())
        stored = "gray[:, :, None].repeat(3, axis=2)" if self.color_only and layout == "gray" else layout
        text = f"import imagecodecs\n\n\ndef encode({layout}):\n"
        text += f"    return bytes(imagecodecs.{self.function}_encode({stored}{arguments}))"
        python = Recipe(
            f"Python, imagecodecs {self._library.__version__}", "python", text, "Another release may give other bytes."
        )
        return (*self._other_recipes(scene), python)

    def _other_recipes(self, scene: Scene) -> tuple[Recipe, ...]:
        """Recipes of stacks other than imagecodecs."""
        return (
            Recipe(
                f"{GSTREAMER} and {FFMPEG}", "sh", "", f"Neither has a known element that codes {self.name} this way."
            ),
        )

    def encode(self, image: Image, *, trace: Trace = NULL_TRACE) -> bytes:
        image = check_image(image)
        height, width = image.shape[:2]
        channels = channel_count(image)
        if max(height, width) > self.max_side or height * width > MAX_PIXELS:
            raise ImageError(f"{self.name}: {width}x{height} exceeds {self.max_side} a side or {MAX_PIXELS} pixels")
        if channels == 1 and self.color_only:
            image = np.repeat(image[:, :, None], 3, axis=2)
        image = image.copy()  # libwebp's binding wants it writable, with the strides of its shape
        content = bytes(getattr(self._library, f"{self.function}_encode")(image, **self._arguments()))
        header = _HEADER.pack(self.magic, channels, 0, width, height)
        return header + _CRC.pack(zlib.crc32(content, zlib.crc32(header))) + content

    def decode(self, bitstream: bytes, *, trace: Trace = NULL_TRACE) -> Image:
        shape = self._read_shape(bitstream)
        self._check_declared_size(bitstream[_CONTENT_START:], shape)
        stored = (*shape[:2], 3) if self.color_only else shape
        pixels: Image = np.empty(stored, np.uint8)
        try:
            decode = getattr(self._library, f"{self._functions[-1]}_decode")
            decode(bitstream[_CONTENT_START:], out=pixels, **self.decoding)
        except (RuntimeError, ValueError, TypeError) as error:
            raise BitstreamError(f"{self.name}: the library cannot read the file: {error}") from error
        return pixels if stored == shape else gray_from_image(pixels)

    def _check_declared_size(self, content: bytes, shape: tuple[int, ...]) -> None:
        """Raise BitstreamError if the file declares another size than the header; a library would allocate for it.

        The libraries of JPEG XL, JPEG-LS and WebP compare the size with the output's before they decode.
        """

    def libraries(self) -> dict[str, str]:
        versions = (getattr(self._library, f"{name}_version")().partition(" ") for name in self._functions)
        return {"imagecodecs": self._library.__version__, **{name: version for name, _, version in versions}}

    def _read_shape(self, bitstream: bytes) -> tuple[int, ...]:
        if len(bitstream) <= _CONTENT_START:
            raise BitstreamError(f"{self.name}: {len(bitstream)} bytes are too few for a header and an image")
        magic, channels, reserved, width, height = _HEADER.unpack_from(bitstream)
        if magic != self.magic or channels not in (1, 3) or reserved:
            raise BitstreamError(f"{self.name}: not a bitstream of this codec (magic {magic!r}, {channels} channels)")
        crc = zlib.crc32(memoryview(bitstream)[_CONTENT_START:], zlib.crc32(bitstream[: _HEADER.size]))
        if crc != _CRC.unpack_from(bitstream, _HEADER.size)[0]:
            raise BitstreamError(f"{self.name}: checksum mismatch, the bitstream is damaged")
        if not 0 < width * height <= MAX_PIXELS:
            raise BitstreamError(f"{self.name}: {width}x{height} is not within 1..{MAX_PIXELS} pixels")
        return (height, width) if channels == 1 else (height, width, 3)


class JpegXlParams(Params):
    """Set libjxl's distance and effort."""

    distance: float = Field(1.0, ge=0, le=25, description="Butteraugli distance; 0 is lossless, 1 visually lossless")
    effort: int = Field(4, ge=1, le=9, description="encoding effort, 1 (fast) to 9 (small files)")


class JpegXl(_EnvelopedCodec[JpegXlParams]):
    """JPEG XL (ISO/IEC 18181) by libjxl."""

    name = "jpegxl"
    version = _qualified_version("1", "jpegxl", "libjxl 0.11.2")
    params_type = JpegXlParams
    examples = ({}, {"distance": 0})
    magic, function, decoding = b"ICxl", "jpegxl", {"numthreads": 1}

    def is_lossless(self) -> bool:
        return self.params.distance == 0

    def _arguments(self) -> dict[str, Any]:
        lossless = self.is_lossless()
        return {"distance": self.params.distance, "lossless": lossless, "effort": self.params.effort, "numthreads": 1}

    def _other_recipes(self, scene: Scene) -> tuple[Recipe, ...]:
        layout = "gray" if scene.channels == 1 else "rgb24"
        options = f"-c:v libjxl -pix_fmt {layout} -distance {self.params.distance:g} -effort {self.params.effort}"
        note = "Frames depend on the release of libjxl: of 0.7 they had 0.91 to 0.96 of the bytes of 0.11."
        return (ffmpeg(scene, [options], "%06d.jxl", note),)


class JpegLsParams(Params):
    """Set the error bound of near-lossless coding."""

    near: int = Field(0, ge=0, le=127, description="largest error of any sample, in gray levels; 0 is lossless")


class JpegLs(_EnvelopedCodec[JpegLsParams]):
    """JPEG-LS (ITU-T T.87) by CharLS."""

    name = "jpegls"
    params_type = JpegLsParams
    examples = ({}, {"near": 3})
    magic, function = b"ICls", "jpegls"

    def is_lossless(self) -> bool:
        return self.params.near == 0

    def _arguments(self) -> dict[str, Any]:
        offered = signature(self._library.jpegls_encode).parameters
        return {"level": self.params.near} | ({"spiff": True} if "spiff" in offered else {})  # older releases always do

    def _other_recipes(self, scene: Scene) -> tuple[Recipe, ...]:
        if not self.is_lossless():
            return (Recipe(FFMPEG, "sh", "", "FFmpeg's jpegls encoder is lossless only; it has no near."),)
        return (ffmpeg(scene, [f"-c:v jpegls -pix_fmt {'gray' if scene.channels == 1 else 'rgb24'}"], "%06d.jls"),)


class Htj2kParams(Params):
    """Set OpenJPH's quantizer."""

    step: float = Field(
        0.01, ge=0, le=0.5, description="base step of the 9/7 wavelet; 0 is lossless, with the 5/3 wavelet"
    )


class Htj2k(_EnvelopedCodec[Htj2kParams]):
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

    def _check_declared_size(self, content: bytes, shape: tuple[int, ...]) -> None:
        """Check SIZ (T.800 A.5.1), whose size OpenJPEG decodes: one tile of 8-bit components, as OpenJPH writes it."""
        height, width, channels = (*shape, 1)[:3]
        declared = _SIZ.pack(0xFF4F, 0xFF51, _SIZ.size - 4 + 3 * channels, 0, *2 * (width, height, 0, 0), channels)
        declared += b"\x07\x01\x01" * channels
        if content[:6] + content[8 : len(declared)] != declared[:6] + declared[8:]:  # bytes 6 and 7: the profile
            raise BitstreamError(f"{self.name}: the codestream does not declare one tile of {width}x{height} pixels")

    def _arguments(self) -> dict[str, Any]:
        return {"reversible": True} if self.is_lossless() else {"reversible": False, "level": self.params.step}


class WebpParams(Params):
    """Set libwebp's quality and method."""

    quality: float = Field(75, ge=0, le=100, description="libwebp's quality, with 4:2:0 chroma; unused if lossless")
    lossless: bool = Field(False, description="code every pixel exactly")
    method: int = Field(4, ge=0, le=6, description="encoding effort, 0 (fast) to 6 (small files)")


class Webp(_EnvelopedCodec[WebpParams]):
    """WebP (RFC 9649) by libwebp. Gray is coded as color, because the format has nothing else."""

    name = "webp"
    params_type = WebpParams
    examples = ({}, {"lossless": True})
    magic, function, color_only, max_side = b"ICwp", "webp", True, 16383

    def is_lossless(self) -> bool:
        return self.params.lossless

    def _arguments(self) -> dict[str, Any]:
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


class Avif(_EnvelopedCodec[AvifParams]):
    """AVIF (AV1 still pictures) by libavif. Gray is coded as color: the binding codes gray only losslessly."""

    name = "avif"
    version = _qualified_version("1", "avif", "libavif 1.4.0")
    params_type = AvifParams
    examples = ({}, {"subsampling": "444", "quality": 90})
    magic, function, color_only, decoding = b"ICav", "avif", True, {"numthreads": 1}

    def _check_declared_size(self, content: bytes, shape: tuple[int, ...]) -> None:
        """Check the property `ispe` (ISO/IEC 23008-12, 6.5.3), for whose size libavif allocates up to 2^28 pixels."""
        declared = {content[at.end() : at.end() + 12] for at in re.finditer(b"ispe", content.partition(b"mdat")[0])}
        if struct.pack(">III", 0, shape[1], shape[0]) not in declared or len(declared) > 1:
            raise BitstreamError(f"{self.name}: the file does not declare {shape[1]}x{shape[0]} pixels")

    def _arguments(self) -> dict[str, Any]:
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
