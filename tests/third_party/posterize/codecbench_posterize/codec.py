"""A codec: fewer bits per sample, deflated."""

import struct
import zlib

import numpy as np
from pydantic import Field

from codecbench import NULL_TRACE, BitstreamError, Capabilities, Codec, Image, ImageError, Params, Trace, check_image

_HEADER = struct.Struct("<4sHHBB")  # magic, height, width, channels, bits
_CRC_BYTES = 4
_MAX_SIDE = 0xFFFF
_MAX_SAMPLES = 1 << 27


class PosterizeParams(Params):
    bits: int = Field(default=4, ge=1, le=8, description="bits kept of each sample")


class Posterize(Codec[PosterizeParams]):
    name = "posterize"
    version = "1"
    params_type = PosterizeParams
    capabilities = Capabilities()
    examples = ({}, {"bits": 1}, {"bits": 8})

    def is_lossless(self) -> bool:
        return self.params.bits == 8

    def encode(self, image: Image, *, trace: Trace = NULL_TRACE) -> bytes:
        image = check_image(image)
        height, width = image.shape[:2]
        if max(height, width) > _MAX_SIDE or image.size > _MAX_SAMPLES:
            raise ImageError(f"posterize: shape {image.shape} exceeds {_MAX_SIDE} a side or {_MAX_SAMPLES} samples")
        samples = image >> (8 - self.params.bits)
        header = _HEADER.pack(b"PSTR", height, width, 1 if image.ndim == 2 else 3, self.params.bits)
        content = header + zlib.compress(samples.tobytes())
        return content + _crc(content)

    def decode(self, bitstream: bytes, *, trace: Trace = NULL_TRACE) -> Image:
        content = bitstream[:-_CRC_BYTES]
        if len(content) < _HEADER.size or content[:4] != b"PSTR" or bitstream[-_CRC_BYTES:] != _crc(content):
            raise BitstreamError("posterize: damaged, truncated or foreign")
        _, height, width, channels, bits = _HEADER.unpack_from(content)
        size = height * width * channels
        if channels not in (1, 3) or not 1 <= bits <= 8 or not 0 < size <= _MAX_SAMPLES:
            raise BitstreamError(f"posterize: {bits} bits of {width}x{height}x{channels} are not allowed")
        inflate = zlib.decompressobj()
        try:
            samples = inflate.decompress(content[_HEADER.size :], size + 1)
        except zlib.error as error:
            raise BitstreamError(f"posterize: {error}") from None
        if len(samples) != size or not inflate.eof or inflate.unused_data:
            raise BitstreamError(f"posterize: the content is not {size} samples")
        values = np.frombuffer(samples, np.uint8).reshape((height, width, 3) if channels == 3 else (height, width))
        step = 256 >> bits
        return (values * step + step // 2).astype(np.uint8)


def _crc(content: bytes) -> bytes:
    return zlib.crc32(content).to_bytes(_CRC_BYTES, "little")
