"""The quality at which a JPEG file was written, read from its quantisation table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.errors import BitstreamError
from codecbench.plugins.codecs.dct.tables import LUMINANCE, ZIGZAG
from codecbench.plugins.codecs.jfif.markers import DQT, read_segments


@dataclass(frozen=True)
class JpegQuality:
    """libjpeg's quality, 1 to 100, whose luminance table is nearest, and whether it is that table exactly."""

    quality: int
    is_exact: bool

    def __str__(self) -> str:
        if self.is_exact:
            return f"JPEG of quality {self.quality} (libjpeg's table)"
        return f"JPEG of about quality {self.quality} (the nearest of libjpeg's tables)"


def quality_from_jpeg(bitstream: bytes) -> JpegQuality | None:
    """The quality of a JPEG file by its table 0, that of luminance; None where it has none that can be read.

    Nearest is by the mean ratio of steps. Source of the scale: jpeg_quality_scaling of libjpeg.
    """
    table = _table_zero(bitstream)
    if table is None:
        return None
    scaled = np.stack([libjpeg_steps(quality) for quality in range(1, 101)])
    distances = np.abs(np.log(scaled / table)).mean(axis=1)
    best = int(distances.argmin())
    return JpegQuality(best + 1, bool((scaled[best] == table).all()))


def libjpeg_steps(quality: int) -> NDArray[np.int64]:
    """libjpeg's luminance steps (64,) in zigzag order at a quality from 1 to 100, in its baseline range."""
    percent = 5000 // quality if quality < 50 else 200 - 2 * quality
    steps = (LUMINANCE.reshape(64).astype(np.int64) * percent + 50) // 100
    return np.asarray(np.clip(steps, 1, 255)[ZIGZAG])


def _table_zero(bitstream: bytes) -> NDArray[np.int64] | None:
    try:
        segments = read_segments(bitstream.rstrip(b"\0"), "jpeg")
    except BitstreamError:
        return None
    for segment in segments:
        content = segment.content if segment.code == DQT else b""
        while content:
            wide, number = content[0] >> 4, content[0] & 15
            length = 128 if wide else 64
            table = np.frombuffer(content[1 : 1 + length], ">u2" if wide else np.uint8).astype(np.int64)
            content = content[1 + length :]
            if number == 0:
                return table if len(table) == 64 and table.min() > 0 else None
    return None
