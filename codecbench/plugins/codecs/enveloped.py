"""What the codecs of imagecodecs share: calls of the library, and an envelope around its files.

Every bitstream is what the library writes, a file of its standard if there is one, behind our header of 18 bytes,
little-endian: magic, `IC` and two letters (4); channels (1); bits of a sample (1), 16, or 0 for 8; width (4); height
(4); CRC-32 (4) of these and the file. The header detects damage, bounds what a decoder allocates, and keeps gray images
gray if the standard has only color.
"""

from __future__ import annotations

import struct
import zlib
from abc import abstractmethod
from types import ModuleType
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.codec import Capabilities, Codec
from codecbench.core.contracts.errors import BitstreamError, ImageError, Unsupported
from codecbench.core.contracts.image import MAX_PIXELS, Image, Layout, check_image, gray_from_image, layout_of
from codecbench.core.contracts.params import Params
from codecbench.core.contracts.recipe import Recipe, Scene
from codecbench.core.counting.trace import NULL_TRACE, Trace
from codecbench.plugins.codecs.recipes import FFMPEG, GSTREAMER

_HEADER = struct.Struct("<4sBBII")
_CRC = struct.Struct("<I")
_CONTENT_START = _HEADER.size + _CRC.size
P = TypeVar("P", bound=Params)


def qualified_version(version: str, function: str, library: str) -> str:
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
        if not getattr(getattr(imagecodecs, function.upper(), None), "available", False):  # older ones lack the name
            raise Unsupported(f"this build of imagecodecs has no {function}; run: pip install --upgrade imagecodecs")
    return imagecodecs  # type: ignore[no-any-return]


class EnvelopedCodec(Codec[P]):
    """Base class of the codecs of imagecodecs. Subclasses name its functions and choose their arguments."""

    version = "1"
    capabilities = Capabilities(bits=(8, 16))
    magic: ClassVar[bytes]
    function: ClassVar[str]
    decoder: ClassVar[str] = ""
    """Function that decodes, if it is not of the library that encodes."""
    color_only: ClassVar[bool] = False
    stored_as: ClassVar[str] = ""
    """Type of the numbers that the library takes, if it is not that of the samples."""
    max_side: ClassVar[int] = 65535
    decoding: ClassVar[dict[str, Any]] = {}
    """Keyword arguments of the decoding function."""

    def __init__(self, params: P) -> None:
        super().__init__(params)
        self._functions = tuple(name for name in (self.function, self.decoder) if name)
        self._library = _load_imagecodecs(self._functions)

    @abstractmethod
    def _arguments(self, bits: int) -> dict[str, Any]:
        """Keyword arguments of the encoding function for samples of 8 or 16 bits. Raises Unsupported if none fit."""

    def recipes(self, scene: Scene) -> tuple[Recipe, ...]:
        """The call of imagecodecs, and recipes of other stacks."""
        layout = "gray" if scene.channels == 1 else "rgb"
        arguments = self._arguments(scene.bits)
        values = {name: int(value) if isinstance(value, int) else value for name, value in arguments.items()}
        keywords = "".join(f", {name}={value!r}" for name, value in values.items())
        stored = "gray[:, :, None].repeat(3, axis=2)" if self.color_only and layout == "gray" else layout
        stored += f".astype({self.stored_as!r})" if self.stored_as else ""
        text = f"import imagecodecs\n\n\ndef encode({layout}):\n"
        text += f"    return bytes(imagecodecs.{self.function}_encode({stored}{keywords}))"
        python = Recipe(
            f"Python, imagecodecs {self._library.__version__}", "python", text, "Another release may give other bytes."
        )
        return (*self._other_recipes(scene), python)

    def _other_recipes(self, scene: Scene) -> tuple[Recipe, ...]:
        """Recipes of stacks other than imagecodecs."""
        note = f"Neither has a known element that codes {self.name} this way."
        return (Recipe(f"{GSTREAMER} and {FFMPEG}", "sh", "", note),)

    def encode(self, image: Image, *, trace: Trace = NULL_TRACE) -> bytes:
        image = check_image(image, self.capabilities.channels, self.capabilities.bits)
        height, width = image.shape[:2]
        channels, bits = layout_of(image)
        if max(height, width) > self.max_side or height * width > MAX_PIXELS:
            raise ImageError(f"{self.name}: {width}x{height} exceeds {self.max_side} a side or {MAX_PIXELS} pixels")
        if channels == 1 and self.color_only:
            image = np.repeat(image[:, :, None], 3, axis=2)
        image = image.copy()  # libwebp's binding wants it writable, with the strides of its shape
        stored = image.astype(self.stored_as) if self.stored_as else image
        content = bytes(getattr(self._library, f"{self.function}_encode")(stored, **self._arguments(bits)))
        header = _HEADER.pack(self.magic, channels, 0 if bits == 8 else bits, width, height)
        return header + _CRC.pack(zlib.crc32(content, zlib.crc32(header))) + content

    def decode(self, bitstream: bytes, *, trace: Trace = NULL_TRACE) -> Image:
        shape, bits = self._read_shape(bitstream)
        content = bitstream[_CONTENT_START:]
        self._check_declared_size(content, shape, bits)
        stored = (*shape[:2], 3) if self.color_only else shape
        try:
            pixels = self._decode(content, stored, f"uint{bits}")
        except (RuntimeError, ValueError, TypeError) as error:
            raise BitstreamError(f"{self.name}: the library cannot read the file: {error}") from error
        return pixels if stored == shape else gray_from_image(pixels)

    def _decode(self, content: bytes, shape: tuple[int, ...], dtype: str) -> NDArray[Any]:
        """Decode a file to an array of this shape and type. May raise RuntimeError, ValueError or TypeError."""
        pixels = np.empty(shape, dtype)
        getattr(self._library, f"{self._functions[-1]}_decode")(content, out=pixels, **self.decoding)
        return pixels

    def _check_declared_size(self, content: bytes, shape: tuple[int, ...], bits: int) -> None:
        """Raise BitstreamError if the file declares another size than the header; a library would allocate for it.

        The libraries of JPEG XL, JPEG-LS, WebP, LERC and ZFP compare the size with the output's before they decode.
        """

    def libraries(self) -> dict[str, str]:
        versions = (getattr(self._library, f"{name}_version")().partition(" ") for name in self._functions)
        return {"imagecodecs": self._library.__version__, **{name: version for name, _, version in versions}}

    def _read_shape(self, bitstream: bytes) -> tuple[tuple[int, ...], int]:
        if len(bitstream) <= _CONTENT_START:
            raise BitstreamError(f"{self.name}: {len(bitstream)} bytes are too few for a header and an image")
        magic, channels, depth, width, height = _HEADER.unpack_from(bitstream)
        bits = {0: 8, 16: 16}.get(depth, 0)
        if magic != self.magic or Layout(channels, bits) not in self.capabilities.layouts:
            got = f"magic {magic!r}, {channels} channels, depth {depth}"
            raise BitstreamError(f"{self.name}: not a bitstream of this codec ({got})")
        crc = zlib.crc32(memoryview(bitstream)[_CONTENT_START:], zlib.crc32(bitstream[: _HEADER.size]))
        if crc != _CRC.unpack_from(bitstream, _HEADER.size)[0]:
            raise BitstreamError(f"{self.name}: checksum mismatch, the bitstream is damaged")
        if not 0 < width * height <= MAX_PIXELS:
            raise BitstreamError(f"{self.name}: {width}x{height} is not within 1..{MAX_PIXELS} pixels")
        return ((height, width) if channels == 1 else (height, width, 3)), bits
