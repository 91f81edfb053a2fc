"""A whole codec: fewer bits a sample, then deflate. The shape and the checksum travel in the bitstream."""

import struct
import zlib

import numpy as np
from pydantic import Field

from codecbench import NULL_TRACE, BitstreamError, Capabilities, Codec, Image, Params, Trace, check_image

_HEADER = struct.Struct("<4sHHBBI")  # magic, height, width, channels, bits, CRC-32 of the samples


class PosterizeParams(Params):
    bits: int = Field(default=4, ge=1, le=8, description="bits kept of each sample")


class Posterize(Codec[PosterizeParams]):
    name = "posterize"
    version = "1"
    params_type = PosterizeParams
    capabilities = Capabilities()

    def encode(self, image: Image, *, trace: Trace = NULL_TRACE) -> bytes:
        image = check_image(image)
        samples = (image >> (8 - self.params.bits)).tobytes()
        channels = 1 if image.ndim == 2 else 3
        header = _HEADER.pack(b"PSTR", *image.shape[:2], channels, self.params.bits, zlib.crc32(samples))
        return header + zlib.compress(samples)

    def decode(self, bitstream: bytes, *, trace: Trace = NULL_TRACE) -> Image:
        if len(bitstream) < _HEADER.size or bitstream[:4] != b"PSTR":
            raise BitstreamError("not a posterize bitstream")
        _, height, width, channels, bits, crc = _HEADER.unpack_from(bitstream)
        size = height * width * channels
        inflate = zlib.decompressobj()
        try:
            samples = inflate.decompress(bitstream[_HEADER.size :], size + 1)
        except zlib.error as error:
            raise BitstreamError(f"damaged: {error}") from None
        if channels not in (1, 3) or not 1 <= bits <= 8 or len(samples) != size or zlib.crc32(samples) != crc:
            raise BitstreamError("damaged header or samples")
        if inflate.unused_data or not inflate.eof:
            raise BitstreamError("truncated, or followed by foreign bytes")
        values = np.frombuffer(samples, np.uint8).reshape((height, width, 3) if channels == 3 else (height, width))
        step = 256 >> bits
        return (values * step + step // 2).astype(np.uint8)
