"""JPEG 2000 (ITU-T T.800) through glymur and OpenJPEG.

A bitstream is a JP2 file with one tile, a few consecutive layers and square code blocks. The decoder accepts nothing
else, which bounds its work. The format has no checksum, so a CRC-32 replaces OpenJPEG's name in the comment: the file
keeps its size, any decoder reads it, and ours detects damage.

OpenJPEG meets a ratio only roughly. `cr_percent` is a limit relative to the PNG, so it needs the PNG's size and a few
trials; `prepared` does both beforehand.
"""

from __future__ import annotations

import math
import struct
import tempfile
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field, model_validator

from codecbench.core.contracts.codec import Capabilities, Codec, Fragment, PartialImage
from codecbench.core.contracts.errors import BitstreamError, ImageError, Unsupported
from codecbench.core.contracts.image import Image, check_image, png_bytes
from codecbench.core.contracts.params import Params
from codecbench.core.contracts.recipe import Recipe, Scene
from codecbench.core.counting.trace import NULL_TRACE, Trace
from codecbench.plugins.codecs.jp2_syntax import (
    EOC,
    MAX_JP2_PIXELS,
    MAX_LAYERS,
    file_from_prefix,
    insert_checksum,
    read_shape,
)
from codecbench.plugins.codecs.openjpeg import lenient_decoding, load_glymur
from codecbench.plugins.codecs.recipes import FFMPEG, GSTREAMER, ffmpeg, gstreamer, opencv, pixel_format

_RESOLUTIONS = 6  # OpenJPEG's default: five decompositions if the image is large enough
_BLOCK_SIDES = (64, 32, 16)  # OpenJPEG's default code blocks, and finer ones
_LAYER_RATIO, _LAYER_DB = 2.0, 3.0  # from layer to layer
_TOLERANCE = 0.02
_MAX_TRIES = 10
_PARSER_ERRORS = (
    OSError,
    RuntimeError,
    ValueError,
    TypeError,
    LookupError,
    struct.error,
)  # what glymur's parser raises


class Jpeg2000Params(Params):
    """Set the rate by exactly one of `ratio`, `psnr_db`, `lossless` and `cr_percent`."""

    ratio: Annotated[float, Field(gt=1)] | None = Field(
        None, description="target of OpenJPEG's rate control: raw bytes, channels included, to coded bytes"
    )
    psnr_db: Annotated[float, Field(gt=0, le=100)] | None = Field(None, description="OpenJPEG's target PSNR, in dB")
    lossless: bool = Field(False, description="code every pixel exactly, with the 5/3 wavelet")
    cr_percent: Annotated[float, Field(gt=0, lt=100)] | None = Field(
        None, description="100 (1 - coded / PNG); the coded size is at most its target, and at most 2 % below it"
    )
    irreversible: bool = Field(
        True, description="use the real 9/7 wavelet instead of the 5/3; default: true unless lossless"
    )
    layers: int = Field(
        1,
        ge=1,
        le=MAX_LAYERS,
        description="quality layers, each of twice the bytes or 3 dB finer; cut files keep the first",
    )

    @model_validator(mode="before")
    @classmethod
    def _default_to_reversible(cls, values: Any) -> Any:
        return {"irreversible": False, **values} if isinstance(values, dict) and values.get("lossless") else values

    @model_validator(mode="after")
    def _check_rate(self) -> Self:
        rates = [name for name in ("ratio", "psnr_db", "cr_percent") if getattr(self, name) is not None]
        rates += ["lossless"] * self.lossless
        if len(rates) != 1:
            got = " and ".join(rates) or "none"
            raise ValueError(f"exactly one of ratio, psnr_db, lossless and cr_percent sets the rate, got {got}")
        if self.lossless and self.irreversible:
            raise ValueError("lossless needs the reversible 5/3 wavelet: leave irreversible out")
        if self.psnr_db is not None and self.psnr_db <= _LAYER_DB * (self.layers - 1):
            most = math.ceil(self.psnr_db / _LAYER_DB)
            fault = f"{self.layers} layers, {_LAYER_DB:g} dB apart, do not fit below psnr_db {self.psnr_db:g}"
            raise ValueError(f"{fault}; {most} or fewer do")
        return self


@dataclass(frozen=True)
class _Trial:
    """A file and the OpenJPEG settings that wrote it."""

    block_side: int
    """Side of a code block."""
    ratio: float
    file: bytes


class Jpeg2000(Codec[Jpeg2000Params]):
    """The wavelet codec JPEG 2000. It is not thread-safe: glymur keeps OpenJPEG's messages in one place."""

    name = "jpeg2000"
    version = "1"
    params_type = Jpeg2000Params
    capabilities = Capabilities(bits=(8, 16), thread_safe=False, partial_decoding=True)
    examples = (
        {"ratio": 8},
        {"psnr_db": 35},
        {"lossless": True},
        {"cr_percent": 60, "irreversible": False},
        {"ratio": 12, "layers": 4},
    )

    def __init__(self, params: Jpeg2000Params) -> None:
        super().__init__(params)
        self._glymur = load_glymur()
        self._trial: _Trial | None = None

    def prepared(self, image: Image) -> Self:
        """With `cr_percent`, return an instance with the ratio and the code blocks for this image."""
        if self.params.cr_percent is None:
            return self
        prepared = type(self)(self.params)
        prepared._trial = self._largest_file_within(_check_size(image), self.params.cr_percent)
        return prepared

    def is_lossless(self) -> bool:
        return self.params.lossless

    def encode(self, image: Image, *, trace: Trace = NULL_TRACE) -> bytes:
        image = _check_size(image)
        params = self.params
        if self._trial is not None:
            return self._write(image, self._trial.block_side, cratios=[self._trial.ratio])
        if params.cr_percent is not None:
            return self._largest_file_within(image, params.cr_percent).file
        return self._write(image, _BLOCK_SIDES[0], **self._rate())

    def _rate(self) -> dict[str, list[float]]:
        """Rate options for OpenJPEG if no search is needed."""
        if self.params.ratio is not None:
            return {"cratios": [self.params.ratio]}
        return {} if self.params.psnr_db is None else {"psnr": [self.params.psnr_db]}

    def recipes(self, scene: Scene) -> tuple[Recipe, ...]:
        """The call of glymur and recipes of other stacks; `cr_percent` is a search that only codecbench does."""
        params = self.params
        if params.cr_percent is not None:
            note = "Only codecbench searches the ratio for each frame; measure ratio, which FFmpeg supports."
            return tuple(replace(recipe, note=note) for recipe in super().recipes(scene))
        settings = {**self._settings((scene.height, scene.width)), **self._layer_rates(self._rate())}
        layout = "gray" if scene.channels == 1 else "rgb"
        text = "import tempfile\nfrom pathlib import Path\n\nimport glymur\n\n\n"
        text += f"def encode({layout}):\n    with tempfile.TemporaryDirectory() as folder:\n"
        text += f'        path = Path(folder) / "frame.jp2"\n        glymur.Jp2k(path, data={layout}, **{settings})\n'
        text += "        return path.read_bytes()"
        python = Recipe("Python, glymur 0.14 with OpenJPEG 2.5", "python", text)
        if params.lossless and params.layers == 1:
            gray = "format=GRAY8" if scene.bits == 8 else "format=GRAY16_LE"
            caps = gray if scene.channels == 1 else "format=xRGB"
            return gstreamer(scene, caps, "openjpegenc", "%06d.jp2"), python
        return (*self._ratio_recipes(scene), python)

    def _ratio_recipes(self, scene: Scene) -> Iterator[Recipe]:
        params = self.params
        yield Recipe(GSTREAMER, "sh", "", "openjpegenc has no property for a rate: it is lossless only.")
        if params.ratio is None:
            yield Recipe(f"{FFMPEG} and OpenCV", "sh", "", "They support a ratio, but no target PSNR and no layers.")
            return
        note = "" if params.layers == 1 else "It writes one layer, so a cut frame loses fine detail everywhere."
        level = round(params.ratio / 2)  # FFmpeg asks OpenJPEG for twice this ratio
        layout = pixel_format(scene)
        options = f"-c:v libopenjpeg -pix_fmt {layout} -compression_level {level} -irreversible {params.irreversible:d}"
        if level == params.ratio / 2:
            yield ffmpeg(scene, [options], "%06d.jp2", note)
        else:
            yield Recipe(FFMPEG, "sh", "", "FFmpeg supports even ratios only.")
        yield opencv(scene, ".jp2", {"IMWRITE_JPEG2000_COMPRESSION_X1000": round(1000 / params.ratio)}, note)

    def decode(self, bitstream: bytes, *, trace: Trace = NULL_TRACE) -> Image:
        return self._read(bitstream, *read_shape(bitstream))

    def decode_partial(self, fragments: Sequence[Fragment], *, trace: Trace = NULL_TRACE) -> PartialImage:
        """Decode what comes before the first gap: layer by layer, coarse resolutions first.

        No pixel is `whole`: each depends on the finest resolution of the last layer, whose packets come last. Raises
        Unsupported if OpenJPEG is older than 2.5.
        """
        first = fragments[0]
        if len(fragments) == 1 and first.offset == 0 and first.data.endswith(EOC.to_bytes(2, "big")):
            return PartialImage.of_whole(self.decode(first.data))  # no data have these two bytes, T.800 A.1
        file, (shape, bits) = file_from_prefix(first.data if first.offset == 0 else b"")
        with lenient_decoding(self._glymur):
            image = self._read(file, shape, bits)
        return PartialImage(image, np.zeros(shape[:2], dtype=bool))

    def _read(self, bitstream: bytes, shape: tuple[int, ...], bits: int) -> Image:
        with _scratch_file() as path:
            path.write_bytes(bitstream)
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    pixels = self._glymur.Jp2k(path)[:]
            except _PARSER_ERRORS as error:
                raise BitstreamError(f"jpeg2000: OpenJPEG cannot read the file: {error}") from error
        if pixels.shape != shape or pixels.dtype != f"uint{bits}":
            got = f"OpenJPEG read {pixels.shape} {pixels.dtype}"
            raise BitstreamError(f"jpeg2000: the header declares {shape} uint{bits}, {got}")
        return np.asarray(pixels, dtype=f"uint{bits}")

    def libraries(self) -> dict[str, str]:
        return {"glymur": self._glymur.__version__, "openjpeg": self._glymur.lib.openjp2.version()}

    def _largest_file_within(self, image: Image, cr_percent: float) -> _Trial:
        """Search the largest file that `cr_percent` allows.

        The file is below the tolerance only if coding the image in full takes no more. At high compression one coding
        pass of a code block is several per cent of the file; smaller blocks then reach sizes in between. Raises
        Unsupported if even the smallest file exceeds the target.
        """
        target_bytes = int(len(png_bytes(image)) * (1 - cr_percent / 100))
        best, smallest = None, image.nbytes
        for block_side in _BLOCK_SIDES:
            trial, least, in_full = self._search(image, target_bytes, block_side)
            best, smallest = _larger(best, trial), min(smallest, least)
            if in_full or best is None or len(best.file) >= (1 - _TOLERANCE) * target_bytes:
                break
        if best is None:
            raise Unsupported(f"jpeg2000: cr_percent allows {target_bytes} bytes, this frame needs {smallest} or more")
        return best

    def _search(self, image: Image, target_bytes: int, block_side: int) -> tuple[_Trial | None, int, bool]:
        """Adjust OpenJPEG's byte budget until the file is within the tolerance below the target.

        Returns the largest file that fits, the smallest size met, and whether no budget was too large.
        """
        aim = (1 - _TOLERANCE / 2) * target_bytes
        fits, exceeds, budget = 0, image.nbytes, max(target_bytes, 1)
        best, smallest = None, image.nbytes
        for _ in range(_MAX_TRIES):
            ratio = max(image.nbytes / budget, 1.0)
            trial = _Trial(block_side, ratio, self._write(image, block_side, cratios=[ratio]))
            size = len(trial.file)
            smallest = min(smallest, size)
            if size > target_bytes:
                exceeds = budget
            else:
                fits, best = budget, _larger(best, trial)
            if (best is not None and len(best.file) >= (1 - _TOLERANCE) * target_bytes) or exceeds - fits <= 1:
                break
            budget += round(aim - size)
            if not fits < budget < exceeds:
                budget = (fits + exceeds) // 2
        return best, smallest, exceeds == image.nbytes

    def _write(self, image: Image, block_side: int = _BLOCK_SIDES[0], **rate: list[float]) -> bytes:
        settings = self._settings(image.shape, block_side)
        with _scratch_file() as path:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                self._glymur.Jp2k(path, data=image, **settings, **self._layer_rates(rate))
            return insert_checksum(path.read_bytes())

    def _settings(self, shape: tuple[int, ...], block_side: int = _BLOCK_SIDES[0]) -> dict[str, Any]:
        resolutions = min(_RESOLUTIONS, min(shape[:2]).bit_length())
        return {"irreversible": self.params.irreversible, "numres": resolutions, "cbsize": (block_side, block_side)}

    def _layer_rates(self, rate: dict[str, list[float]]) -> dict[str, Any]:
        """Rate options for each layer, the coarsest first; the last layer has the rate of the whole file.

        Packet lengths (PLT) are written too, so that a truncated file decodes up to its last complete packet.
        """
        if self.params.layers == 1:
            return rate
        finer = range(self.params.layers - 1, -1, -1)
        if "psnr" in rate:
            return {"psnr": [rate["psnr"][0] - _LAYER_DB * steps for steps in finer], "plt": True}
        (ratio,) = rate.get("cratios", [1.0])  # OpenJPEG takes 1 for everything there is
        return {"cratios": [ratio * _LAYER_RATIO**steps for steps in finer], "plt": True}


def _check_size(image: Image) -> Image:
    image = check_image(image, bits=(8, 16))
    if image.shape[0] * image.shape[1] > MAX_JP2_PIXELS:
        raise ImageError(f"jpeg2000: an image of shape {image.shape} exceeds {MAX_JP2_PIXELS} pixels")
    return image


def _larger(best: _Trial | None, trial: _Trial | None) -> _Trial | None:
    """Return the trial with the larger file, the first if they are equal."""
    if best is None or trial is None:
        return best or trial
    return max(best, trial, key=lambda either: len(either.file))


@contextmanager
def _scratch_file() -> Iterator[Path]:
    """Yield the path of a new file in a temporary folder of this process, which is removed with its worker."""
    with tempfile.TemporaryDirectory(prefix="codecbench-") as name:
        yield Path(name) / "frame.jp2"
