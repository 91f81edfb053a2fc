"""JPEG 2000 (ITU-T T.800) through glymur and OpenJPEG.

A bitstream is a JP2 file with one tile, one layer and OpenJPEG's default code blocks, and the decoder takes
nothing else, which bounds its work. The format has no checksum, so a CRC-32 stands in the comment in which OpenJPEG
names itself: the file keeps its size, any decoder reads it, and ours notices damage.
"""

from __future__ import annotations

import os
import struct
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, model_validator

from codecbench.core.contracts.codec import Capabilities, Codec
from codecbench.core.contracts.errors import BitstreamError, ImageError, Unsupported
from codecbench.core.contracts.image import Image, check_image, png_bytes
from codecbench.core.contracts.params import Params
from codecbench.core.instrument.trace import NULL_TRACE, Trace
from codecbench.plugins.codecs.jp2_syntax import MAX_JP2_PIXELS, checked_shape, with_checksum
from codecbench.plugins.codecs.openjpeg import load_glymur

_RESOLUTIONS = 6  # OpenJPEG's default: five decompositions, where the image is large enough
_TOLERANCE = 0.02
_MAX_TRIES = 12
_UNREADABLE = (OSError, RuntimeError, ValueError, TypeError, LookupError, struct.error)  # what glymur's parser raises


class Jpeg2000Params(Params):
    """Exactly one of `ratio`, `psnr_db`, `lossless` and `cr_percent` sets the rate.

    `ratio`: raw bytes, channels included, to coded bytes, as OpenJPEG's rate control reaches it. `psnr_db`: its
    target quality. `lossless`: every pixel. `cr_percent`: 100 (1 - coded / PNG), reached to within 2 % of the
    size and never exceeding it. `irreversible`: the 9/7 wavelet with real arithmetic, else the 5/3; left out,
    it follows from `lossless`.
    """

    ratio: Annotated[float, Field(gt=1)] | None = None
    psnr_db: Annotated[float, Field(gt=0, le=100)] | None = None
    lossless: bool = False
    cr_percent: Annotated[float, Field(gt=0, lt=100)] | None = None
    irreversible: bool = True

    @model_validator(mode="before")
    @classmethod
    def _lossless_is_reversible(cls, values: Any) -> Any:
        return {"irreversible": False, **values} if isinstance(values, dict) and values.get("lossless") else values

    @model_validator(mode="after")
    def _one_rate(self) -> Self:
        given = [name for name in ("ratio", "psnr_db", "cr_percent") if getattr(self, name) is not None]
        given += ["lossless"] * self.lossless
        if len(given) != 1:
            got = " and ".join(given) or "none"
            raise ValueError(f"exactly one of ratio, psnr_db, lossless and cr_percent sets the rate, got {got}")
        if self.lossless and self.irreversible:
            raise ValueError("lossless needs the reversible 5/3 wavelet: leave irreversible out")
        return self


class Jpeg2000(Codec[Jpeg2000Params]):
    """The wavelet standard. Not thread-safe, because glymur keeps OpenJPEG's messages in one place."""

    name = "jpeg2000"
    version = "1"
    params_type = Jpeg2000Params
    capabilities = Capabilities(thread_safe=False, in_memory=False)

    def __init__(self, params: Jpeg2000Params) -> None:
        super().__init__(params)
        self._glymur = load_glymur()

    def is_lossless(self) -> bool:
        return self.params.lossless

    def encode(self, image: Image, *, trace: Trace = NULL_TRACE) -> bytes:
        image = check_image(image)
        if image.shape[0] * image.shape[1] > MAX_JP2_PIXELS:
            raise ImageError(f"jpeg2000: an image of shape {image.shape} exceeds {MAX_JP2_PIXELS} pixels")
        params = self.params
        if params.cr_percent is not None:
            target_bytes = int(len(png_bytes(image)) * (1 - params.cr_percent / 100))
            return self._encode_within(image, target_bytes)
        if params.ratio is not None:
            return self._write(image, cratios=[params.ratio])
        if params.psnr_db is not None:
            return self._write(image, psnr=[params.psnr_db])
        return self._write(image)

    def decode(self, bitstream: bytes, *, trace: Trace = NULL_TRACE) -> Image:
        shape = checked_shape(bitstream)
        with _scratch_file() as path:
            path.write_bytes(bitstream)
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    pixels = self._glymur.Jp2k(path)[:]
            except _UNREADABLE as error:
                raise BitstreamError(f"jpeg2000: OpenJPEG cannot read the file: {error}") from error
        if pixels.shape != shape or pixels.dtype != np.uint8:
            raise BitstreamError(f"jpeg2000: the header promises {shape}, OpenJPEG read {pixels.shape} {pixels.dtype}")
        return np.asarray(pixels, dtype=np.uint8)

    def libraries(self) -> dict[str, str]:
        return {"glymur": self._glymur.__version__, "openjpeg": self._glymur.lib.openjp2.version()}

    def _encode_within(self, image: Image, target_bytes: int) -> bytes:
        """The largest file of at most `target_bytes` that a few corrections of OpenJPEG's budget find.

        The file is smaller than the tolerance allows only where coding the image in full takes no more.
        Raises Unsupported where even the smallest file exceeds the target.
        """
        aim = (1 - _TOLERANCE / 2) * target_bytes
        fits, exceeds, budget = 0, image.size, max(target_bytes, 1)
        best, smallest = b"", image.size
        for _ in range(_MAX_TRIES):
            bitstream = self._write(image, cratios=[max(image.size / budget, 1.0)])
            smallest = min(smallest, len(bitstream))
            if len(bitstream) > target_bytes:
                exceeds = budget
            else:
                fits = budget
                best = max(best, bitstream, key=len)
            if len(best) >= (1 - _TOLERANCE) * target_bytes or exceeds - fits <= 1:
                break
            budget += round(aim - len(bitstream))
            if not fits < budget < exceeds:
                budget = (fits + exceeds) // 2
        if not best:
            raise Unsupported(f"jpeg2000: cr_percent allows {target_bytes} bytes, this frame takes {smallest} or more")
        return best

    def _write(self, image: Image, **rate: Any) -> bytes:
        resolutions = min(_RESOLUTIONS, min(image.shape[:2]).bit_length())
        with _scratch_file() as path:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                self._glymur.Jp2k(path, data=image, irreversible=self.params.irreversible, numres=resolutions, **rate)
            return with_checksum(path.read_bytes())


@contextmanager
def _scratch_file() -> Iterator[Path]:
    """The path of a file that does not exist yet, in memory where the system offers it, removed in any case."""
    shared_memory = "/dev/shm"
    folder = shared_memory if os.access(shared_memory, os.W_OK | os.X_OK) else None
    with tempfile.TemporaryDirectory(prefix="codecbench-", dir=folder) as name:
        yield Path(name) / "frame.jp2"
