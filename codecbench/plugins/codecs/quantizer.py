"""Code 16-bit depth in fewer bits: map distances to codes before a codec, and codes back to distances after it.

Code 0 stands for pixels without distance. What the decoder needs travels in the bitstream, as a `DepthScale`.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, Final, Literal, Self, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from codecbench.core.contracts.errors import BitstreamError
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.params import Params

Kind = Literal["none", "linear", "log", "inverse"]
_KINDS: Final[tuple[Kind, ...]] = get_args(Kind)
_USED_BY: Final = {
    "near_m": ("linear", "log"), "far_m": _KINDS[1:], "shift_m": ("log",), "depth_quantization": ("inverse",),
    "depth_unit_m": _KINDS[1:], "depth_unknown": _KINDS[1:], "valid_from_m": _KINDS[1:],
}  # fmt: skip
_PIXELS: Final = 1 << 16

QuantizerKind = Annotated[Kind, Field(description="how 16-bit depth becomes codes; none sends the pixels themselves")]
DepthBits = Annotated[Literal[10, 12, 16], Field(description="bits of a code of depth")]
FarDistance = Annotated[
    float,
    Field(gt=0.0, description="distance of the last code and of all beyond; inverse: from here on depth is unknown"),
]
DepthQuantization = Annotated[
    float,
    Field(gt=0.0, le=1e3, description="inverse: distance in m at which a step is 1 m; a smaller one codes nearer"),
]


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
    valid_from_m: float = 0.0
    """Distance below which there is none: what noise makes of code 0."""

    RECORD = struct.Struct("<BBH5d")

    def to_bytes(self) -> bytes:
        """Serialize: kind (1), bits (1), unknown (2), the five other values as double precision, little-endian."""
        numbers = (self.unit_m, self.step, self.offset, self.shift_m, self.valid_from_m)
        return self.RECORD.pack(_KINDS.index(self.kind), self.bits, self.unknown, *numbers)

    @classmethod
    def parse(cls, data: bytes) -> Self:
        """Read what `to_bytes` wrote. Raises BitstreamError for anything else."""
        kind, bits, unknown, *numbers = cls.RECORD.unpack(data)
        is_valid = kind < len(_KINDS) and bits in (10, 12, 16) and unknown in (0, 0xFFFF)
        if not (is_valid and all(map(math.isfinite, numbers))):
            raise BitstreamError(f"the depth scale is damaged: kind {kind}, {bits} bits, unknown {unknown}, {numbers}")
        return cls(_KINDS[kind], bits, unknown, *numbers)

    def pixels(self, codes: Image) -> Image:
        """Return the 16-bit pixels of (H, W) uint16 codes."""
        return codes if self.kind == "none" else _pixel_table(self).take(codes, mode="clip")


class DepthParams(Params):
    """Quantize 16-bit depth, as LeRobot's datasets (log, linear) or ROS's 32FC1 transport (inverse).

    Subclasses set defaults that suit their codec.
    """

    quantizer: QuantizerKind = "log"
    depth_bits: DepthBits = 12
    near_m: float = Field(default=0.01, ge=0.0, description="log, linear: distance of code 0; nearer pixels get code 1")
    far_m: FarDistance = 65.535
    shift_m: float = Field(default=3.5, gt=0.0, description="log: added to distances; a larger one is closer to linear")
    valid_from_m: float = Field(default=0.0, ge=0.0, description="decoded distances below this are none")
    depth_quantization: DepthQuantization = 30.0
    depth_unit_m: float = Field(default=0.001, gt=0.0, le=1.0, description="meters of a step of the pixels")
    depth_unknown: Literal[0, 65535] = Field(default=0, description="value of pixels without distance")

    @model_validator(mode="after")
    def _check_depth(self) -> Self:
        if self.quantizer == "none" and self.depth_bits != 16:
            others = ", ".join(_KINDS[1:])
            raise ValueError(f"quantizer none takes 16 bits, not {self.depth_bits}; set quantizer to {others}")
        unused = [
            f"{name} is for {' and '.join(kinds)} depth"
            for name, kinds in _USED_BY.items()
            if self.quantizer not in kinds and getattr(self, name) != type(self).model_fields[name].default
        ]
        if unused:
            raise ValueError(f"quantizer is {self.quantizer}, but {', '.join(unused)}; leave it out")
        if self.near_m >= self.far_m:
            raise ValueError(f"near_m must be below far_m, got {self.near_m:g} and {self.far_m:g}")
        return self

    @property
    def depth_remark(self) -> str:
        """The quantizer in a few words, with its nearest and farthest distance; empty if there is none."""
        if self.quantizer == "none":
            return ""
        scale, near_m = self.depth_scale, self.near_m
        if self.quantizer == "inverse":
            near_m = scale.step / ((1 << self.depth_bits) - 1 - scale.offset)
        return f"depth is quantized ({self.quantizer}, {self.depth_bits} bits, {near_m:.3g} to {self.far_m:g} m)"

    @property
    def depth_scale(self) -> DepthScale:
        """The distances of its codes.

        Log and linear depth divide `near_m` to `far_m` in equal steps. For inverse depth A = Z0 (Z0 + 1) and
        B = 1 - A / far_m, where Z0 is `depth_quantization`.
        """
        is_log, steps = self.quantizer == "log", (1 << self.depth_bits) - 1
        shift_m = self.shift_m if is_log else 0.0
        near, far = (math.log(end_m + shift_m) if is_log else end_m for end_m in (self.near_m, self.far_m))
        step, offset = (far - near) / steps, near
        if self.quantizer == "inverse":
            z0 = np.float32(self.depth_quantization)
            a = z0 * (z0 + np.float32(1.0))
            step, offset = float(a), float(np.float32(1.0) - a / np.float32(self.far_m))
        meaning = (self.quantizer, self.depth_bits, self.depth_unknown, self.depth_unit_m)
        return DepthScale(*meaning, step, offset, shift_m, self.valid_from_m)

    def codes(self, image: Image) -> Image:
        """Return the uint16 codes of (H, W) uint16 pixels.

        Log and linear depth round to the nearest code, and clip to the codes from 1. Inverse depth truncates, gives
        code 0 from `far_m`, and the last code to what is too near, where ROS's cast has no defined result.
        """
        return image if self.quantizer == "none" else _code_table(self.depth_scale, self.far_m).take(image)


@lru_cache(maxsize=4)
def _code_table(scale: DepthScale, far_m: float) -> NDArray[np.uint16]:
    pixels, last = np.arange(_PIXELS), (1 << scale.bits) - 1
    with np.errstate(divide="ignore"):
        if scale.kind == "inverse":
            depth_m = pixels.astype(np.float32) * np.float32(scale.unit_m)
            codes = np.trunc(np.float32(scale.step) / depth_m + np.float32(scale.offset))
            codes = np.clip(np.where(depth_m < np.float32(far_m), codes, 0), 0, last)
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
    table[table * scale.unit_m < scale.valid_from_m] = scale.unknown
    table[0] = scale.unknown
    return table
