"""Compressors of bytes and of arrays of numbers through imagecodecs: Zstandard, LZ4, LERC and ZFP."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from codecbench.core.contracts.codec import Capabilities
from codecbench.core.contracts.errors import BitstreamError
from codecbench.core.contracts.params import Params
from codecbench.plugins.codecs.enveloped import EnvelopedCodec, P

_MODE_BIT, _REVERSIBLE, _LAST_ACCURACY = 84, 2176, 4094
"""Place of the 12-bit mode in a header of ZFP, and the modes that we write: reversible, then fixed accuracies."""
_MAX_BLOCK_BYTES = 2100
"""Upper bound of a block of ZFP: 16,658 bits."""


class _Bytes(EnvelopedCodec[P]):
    """Base class of codecs of bytes: the samples row by row, those of 16 bits little-endian."""

    capabilities = Capabilities(bits=(8, 16), lossless=True)

    def _arguments(self, bits: int) -> dict[str, Any]:
        return self.params.model_dump()

    def _decode(self, content: bytes, shape: tuple[int, ...], dtype: str) -> NDArray[Any]:
        size = math.prod(shape) * np.dtype(dtype).itemsize
        samples = np.empty(size + 1, np.uint8)  # LZ4 fills what there is and does not tell of more
        decoded = getattr(self._library, f"{self.function}_decode")(content, out=samples)
        if len(decoded) != size:
            raise BitstreamError(f"{self.name}: {len(decoded)} bytes or more are not an image of shape {shape}")
        return samples[:size].view(dtype).reshape(shape)


class ZstdParams(Params):
    """Set Zstandard's effort."""

    level: int = Field(3, ge=1, le=22, description="compression level, 1 (fast) to 22 (small)")


class Zstd(_Bytes[ZstdParams]):
    """Zstandard (RFC 8878), as bags and middleware compress any message."""

    name = "zstd"
    params_type = ZstdParams
    examples = ({}, {"level": 19})
    magic, function = b"ICzs", "zstd"


class Lz4Params(Params):
    """Set LZ4's effort."""

    level: int = Field(0, ge=0, le=12, description="compression level, 0 (fast) to 12 (small)")


class Lz4(_Bytes[Lz4Params]):
    """LZ4 in its frame format, as bags and middleware compress any message."""

    name = "lz4"
    params_type = Lz4Params
    examples = ({}, {"level": 12})
    magic, function = b"ICl4", "lz4f"


class MaxErrorParams(Params):
    """Set the error bound."""

    max_error: int = Field(
        0, ge=0, le=65535, description="largest error of a pixel, in its steps: mm if depth is in mm; 0 is lossless"
    )


class _Bounded(EnvelopedCodec[MaxErrorParams]):
    """Base class of codecs of 16-bit frames that bound the error of every pixel."""

    params_type = MaxErrorParams
    capabilities = Capabilities(channels=(1,), bits=(16,))
    examples = ({}, {"max_error": 5})

    def is_lossless(self) -> bool:
        return self.params.max_error == 0


class Lerc(_Bounded):
    """LERC, Limited Error Raster Compression by Esri, of 16-bit frames.

    Of 8-bit frames its Huffman coder leaves four bytes undefined, so equal frames would give other bytes.
    """

    name = "lerc"
    magic, function = b"ICle", "lerc"

    def _arguments(self, bits: int) -> dict[str, Any]:
        return {"level": self.params.max_error}


class Zfp(_Bounded):
    """ZFP (Lindstrom 2014, doi:10.1109/TVCG.2014.2346458) of 16-bit frames as float32 numbers, which it needs.

    Lossless in its reversible mode, else of fixed accuracy and rounded. Pixels come closer than `max_error`, which ZFP
    rounds down to a power of two.
    """

    name = "zfp"
    magic, function, stored_as = b"ICzf", "zfp", "float32"

    def _arguments(self, bits: int) -> dict[str, Any]:
        return {"mode": "reversible"} if self.is_lossless() else {"level": self.params.max_error, "mode": "accuracy"}

    def _check_declared_size(self, content: bytes, shape: tuple[int, ...], bits: int) -> None:
        mode = int.from_bytes(content[:12], "little") >> _MODE_BIT & 0xFFF
        if not _REVERSIBLE <= mode <= _LAST_ACCURACY:
            raise BitstreamError(f"zfp: mode {mode} is neither reversible nor of fixed accuracy")

    def _decode(self, content: bytes, shape: tuple[int, ...], dtype: str) -> NDArray[Any]:
        """Decode with zeros behind the content, because ZFP does not see its end: of each block it reads a bit more."""
        blocks = math.ceil(shape[0] / 4) * math.ceil(shape[1] / 4)
        numbers = super()._decode(content + bytes(blocks // 8 + _MAX_BLOCK_BYTES), shape, self.stored_as)
        samples: NDArray[Any] = np.clip(np.rint(np.nan_to_num(numbers)), 0, np.iinfo(dtype).max).astype(dtype)
        return samples
