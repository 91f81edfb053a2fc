"""Compressed data of bags, expanded to no more than is allowed."""

from __future__ import annotations

import bz2
import sys
from typing import Any, Final

from lz4.frame import LZ4FrameDecompressor

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

MOST_BYTES: Final = 1 << 28
"""256 MiB: the largest message and the largest compressed chunk that are read, whatever a file says of itself."""

ZSTD_MAGIC: Final = b"\x28\xb5\x2f\xfd"

_DECOMPRESSORS: dict[str, Any] = {
    "bz2": bz2.BZ2Decompressor,
    "lz4": LZ4FrameDecompressor,
    "zstd": zstd.ZstdDecompressor,
}
COMPRESSIONS: Final = ("", "none", *_DECOMPRESSORS)


def expanded(data: bytes, compression: str, most_bytes: int = MOST_BYTES) -> bytes:
    """The first `most_bytes` of what `data` expands to; fewer where the data end early or are damaged after some."""
    if compression in ("", "none"):
        return data[:most_bytes]
    decompressor = _DECOMPRESSORS[compression]()
    try:
        return bytes(decompressor.decompress(data, max_length=most_bytes))
    except (OSError, RuntimeError, EOFError, ValueError, zstd.ZstdError):
        return b""
