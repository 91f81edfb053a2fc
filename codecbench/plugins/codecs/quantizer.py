"""Code 16-bit depth in fewer bits: quantizers that map distances to codes before a codec, and codes back after it.

Code 0 stands for pixels without distance. What the decoder needs travels in the bitstream, as a `DepthScale`.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from codecbench.core.contracts.errors import BitstreamError
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.params import Params

Kind = Literal["none", "linear", "log", "inverse"]
_KINDS: Final[tuple[Kind, ...]] = ("none", "linear", "log", "inverse")
_BITS: Final = (10, 12, 16)
_PIXELS: Final = 1 << 16
_USED_BY: Final = {
    "near_m": ("linear", "log"), "far_m": _KINDS[1:], "shift_m": ("log",), "depth_quantization": ("inverse",),
    "unit_m": _KINDS[1:], "unknown": _KINDS[1:],
}  # fmt: skip
_USUAL_QUANTIZATION: Final = {10: 15.0, 12: 30.0, 16: 100.0}
"""Of inverse depth: ROS's default for 16 bits; with fewer bits it would begin at 2 m or more, these at 0.23 m."""


@dataclass(frozen=True)
class DepthScale:
    """The distance that each code stands for.

    In meters: `offset + step code` (linear), `exp(offset + step code) - shift` (log), `step / (code - offset)`
    (inverse, in single precision as ROS computes it).
    """

    kind: Kind
    bits: int
    unknown: int
    """Value of pixels without distance."""
    unit_m: float
    """Meters of a step of the pixels."""
    step: float
    offset: float
    shift_m: float

    RECORD = struct.Struct("<BBH4d")

    def to_bytes(self) -> bytes:
        """Serialize: kind (1), bits (1), unknown (2), the four other values as double precision, little-endian."""
        numbers = (self.unit_m, self.step, self.offset, self.shift_m)
        return self.RECORD.pack(_KINDS.index(self.kind), self.bits, self.unknown, *numbers)

    @classmethod
    def parse(cls, data: bytes) -> Self:
        """Read what `to_bytes` wrote. Raises BitstreamError for anything else."""
        kind, bits, unknown, *numbers = cls.RECORD.unpack(data)
        if (
            kind >= len(_KINDS)
            or bits not in _BITS
            or unknown not in (0, 0xFFFF)
            or not all(map(math.isfinite, numbers))
        ):
            raise BitstreamError(f"the depth scale is damaged: kind {kind}, {bits} bits, unknown {unknown}, {numbers}")
        return cls(_KINDS[kind], bits, unknown, *numbers)

    def pixels(self, codes: Image) -> Image:
        """Return the 16-bit pixels of (H, W) uint16 codes."""
        return codes if self.kind == "none" else _pixel_table(self).take(codes, mode="clip")


class Quantizer(Params):
    """Code 16-bit depth in fewer bits: as LeRobot's datasets (log, linear) or as ROS's 32FC1 transport (inverse)."""

    kind: Kind = Field(default="log", description="how distances become codes; none sends the pixels themselves")
    bits: Literal[10, 12, 16] = Field(description="bits of a code; default: the most that the codec takes")
    near_m: float = Field(default=0.01, ge=0.0, description="log, linear: distance of code 0; nearer pixels get code 1")
    far_m: float = Field(
        default=10.0,
        gt=0.0,
        description="log, linear: distance of the last code and of all beyond; inverse: unknown from here",
    )
    shift_m: float = Field(default=3.5, gt=0.0, description="log: added to distances; a larger one is closer to linear")
    depth_quantization: float | None = Field(
        default=None,
        gt=0.0,
        description="inverse: distance in m at which a step is 1 m; default: 100, 30 or 15 (16, 12, 10 bits)",
    )
    unit_m: float = Field(default=0.001, gt=0.0, description="meters of a step of the pixels")
    unknown: Literal[0, 65535] = Field(default=0, description="value of pixels without distance")

    @model_validator(mode="before")
    @classmethod
    def _fill_in_quantization(cls, values: Any) -> Any:
        if not isinstance(values, dict) or values.get("kind") != "inverse" or values.get("bits") not in _BITS:
            return values
        z0 = values.get("depth_quantization")
        return {**values, "depth_quantization": _USUAL_QUANTIZATION[values["bits"]] if z0 is None else z0}

    @model_validator(mode="after")
    def _check_use(self) -> Self:
        if self.kind == "none" and self.bits != 16:
            raise ValueError(f"kind none keeps 16 bits, not {self.bits}; set kind to {', '.join(_KINDS[1:])}")
        defaults = {name: field.default for name, field in type(self).model_fields.items()}
        unused = [name for name, kinds in _USED_BY.items() if self.kind not in kinds]
        unused = [name for name in unused if getattr(self, name) != defaults[name]]
        if unused:
            raise ValueError(f"kind {self.kind} does not use {', '.join(unused)}; leave it out")
        if self.near_m >= self.far_m:
            raise ValueError(f"near_m must be below far_m, got {self.near_m:g} and {self.far_m:g}")
        return self

    def __str__(self) -> str:
        near = "" if self.kind == "inverse" else f"{self.near_m:g} to "
        return f"{self.kind}, {self.bits} bits, {near}{self.far_m:g} m"

    @property
    def scale(self) -> DepthScale:
        """The distances of its codes.

        Log and linear depth divide `near_m` to `far_m` in equal steps. For inverse depth A = Z0 (Z0 + 1) and
        B = 1 - A / far_m, where Z0 is `depth_quantization`.
        """
        steps, shift_m = (1 << self.bits) - 1, self.shift_m if self.kind == "log" else 0.0
        ends = [math.log(end_m + shift_m) if self.kind == "log" else end_m for end_m in (self.near_m, self.far_m)]
        step, offset = (ends[1] - ends[0]) / steps, ends[0]
        if self.kind == "inverse":
            z0 = np.float32(self.depth_quantization)
            a = z0 * (z0 + np.float32(1.0))
            step, offset = float(a), float(np.float32(1.0) - a / np.float32(self.far_m))
        return DepthScale(self.kind, self.bits, self.unknown, self.unit_m, step, offset, shift_m)

    def codes(self, image: Image) -> Image:
        """Return the uint16 codes of (H, W) uint16 pixels.

        Log and linear depth round to the nearest code, and clip to the codes from 1. Inverse depth truncates, gives
        code 0 from `far_m`, and the last code to what is too near, where ROS's cast has no defined result.
        """
        return image if self.kind == "none" else _code_table(self).take(image)


@lru_cache(maxsize=4)
def _code_table(quantizer: Quantizer) -> NDArray[np.uint16]:
    scale, pixels, last = quantizer.scale, np.arange(_PIXELS), (1 << quantizer.bits) - 1
    with np.errstate(divide="ignore"):
        if scale.kind == "inverse":
            depth_m = pixels.astype(np.float32) * np.float32(scale.unit_m)
            codes = np.trunc(np.float32(scale.step) / depth_m + np.float32(scale.offset))
            codes = np.clip(np.where(depth_m < np.float32(quantizer.far_m), codes, 0), 0, last)
        else:
            places = pixels * scale.unit_m
            places = np.log(places + scale.shift_m) if scale.kind == "log" else places
            codes = np.clip(np.rint((places - scale.offset) / scale.step), 1, last)
    table: NDArray[np.uint16] = codes.astype(np.uint16)
    table[scale.unknown] = 0
    return table


@lru_cache(maxsize=4)
def _pixel_table(scale: DepthScale) -> NDArray[np.uint16]:
    codes = np.arange(1 << scale.bits, dtype=np.float64)
    with np.errstate(all="ignore"):  # the numbers may be a damaged bitstream's
        if scale.kind == "inverse":
            depth_m = np.float32(scale.step) / (codes.astype(np.float32) - np.float32(scale.offset))
            pixels = np.rint(depth_m.astype(np.float64) / scale.unit_m)
        else:
            depth_m = scale.offset + scale.step * codes
            depth_m = np.exp(depth_m) - scale.shift_m if scale.kind == "log" else depth_m
            pixels = np.rint(depth_m / scale.unit_m)
    lowest = int(scale.unknown == 0)  # no distance may become the value of pixels without distance
    table: NDArray[np.uint16] = np.clip(np.nan_to_num(pixels), lowest, lowest + _PIXELS - 2).astype(np.uint16)
    table[0] = scale.unknown
    return table
