"""Features of images, and the sessions that code them: the device finds them, and the server never sees a picture.

What the device finds of one image is a set, `Features`. Sessions code the sets of one sequence in order, one packet for
each, alone or after those before; `Packet` and LOST are those of `stream`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Self

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.stream import Loss, Packet

DESCRIPTOR_BYTES = 32
ANGLE_TOLERANCE_RAD = 1e-8
"""A thousand times less than what separates two thirtieths of a turn in practice."""


@dataclass(frozen=True)
class Features:
    """The binary features of one image; N may be 0.

    size: width and height of the image in pixels. pixels: (N, 2) float64, x and y in it before anything is known of the
    lens; (0, 0) is the middle of the first pixel. octaves: (N,) int32, the level of the pyramid, 0 the image itself.
    angles: (N,) float64, radians. responses: (N,) float64, how strong each is; NaN where that is not told. descriptors:
    (N, 32) uint8, 256 bits. Raises ValueError for arrays of another shape or type, and for positions outside of the
    image, angles that are not finite, or levels below 0.
    """

    size: tuple[int, int]
    pixels: NDArray[np.float64] = field(repr=False)
    octaves: NDArray[np.int32] = field(repr=False)
    angles: NDArray[np.float64] = field(repr=False)
    responses: NDArray[np.float64] = field(repr=False)
    descriptors: NDArray[np.uint8] = field(repr=False)

    def __post_init__(self) -> None:
        count = len(self.pixels)
        for name, kind, shape in (
            ("pixels", np.float64, (count, 2)),
            ("octaves", np.int32, (count,)),
            ("angles", np.float64, (count,)),
            ("responses", np.float64, (count,)),
            ("descriptors", np.uint8, (count, DESCRIPTOR_BYTES)),
        ):
            values = getattr(self, name)
            if not isinstance(values, np.ndarray) or values.dtype != kind or values.shape != shape:
                got = f"{getattr(values, 'dtype', type(values).__name__)} {getattr(values, 'shape', '')}".strip()
                raise ValueError(f"features: {name} are {got}; of {count} features they are {kind.__name__} {shape}")
        if len(self.size) != 2 or min(self.size) < 1:
            raise ValueError(f"features: the size is {self.size}; it is width and height of an image")
        if count and not (self.pixels.min() >= -0.5 and (self.pixels - self.size).max() <= -0.5):
            raise ValueError(f"features: a position is outside the image of {self.size[0]}x{self.size[1]}")
        if not np.isfinite(self.angles).all() or self.octaves.min(initial=0) < 0:
            raise ValueError("features: an angle is not finite, or a level is below 0")

    def __len__(self) -> int:
        return len(self.pixels)

    @classmethod
    def none(cls, size: tuple[int, int]) -> Self:
        """What there is in an image without a corner."""
        nothing = np.zeros(0)
        return cls(
            size, np.zeros((0, 2)), np.zeros(0, np.int32), nothing, nothing, np.zeros((0, DESCRIPTOR_BYTES), np.uint8)
        )


@dataclass(frozen=True)
class FeatureSet:
    """What a decoder has of one frame of the session; `features` is None where they are missing."""

    frame: int
    features: Features | None = field(repr=False)


@dataclass(frozen=True)
class FeatureFrame:
    """A frame of which the features are all that is there; `index` and `timestamp_s` as a Frame has them."""

    index: int
    timestamp_s: float
    features: Features = field(repr=False)


class FeatureEncoder(ABC):
    """The sets of one sequence being encoded."""

    @abstractmethod
    def push(self, features: Features) -> Packet:
        """The packet of a set, which is left untouched; sets are counted from 0 in the order in which they are pushed.

        Raises ValueError for a set that cannot be coded, such as one of too many features.
        """


class FeatureDecoder(ABC):
    """One stream being decoded, from a packet that `starts` on; sets before it are missing."""

    @abstractmethod
    def push(self, packet: Packet | Loss) -> FeatureSet:
        """The set of a packet, or what is known when the next packet is LOST: that its set is missing.

        A set that depends on one that is missing is missing too: nothing is made up. Raises BitstreamError for damaged
        and foreign bytes; the session goes on with the next packet that `starts`.
        """
