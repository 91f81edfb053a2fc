"""Features of images, and the sessions that code them: the device extracts them, and the server never sees an image.

The features of one image are a set, `Features`. A session codes the sets of one sequence in order, one packet each,
with or without prediction from earlier sets; `Packet` and LOST are those of `stream`.
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
"""Angle error in radians allowed to lossless codecs: far below what moves an angle to another of 30 histogram bins."""


@dataclass(frozen=True)
class Features:
    """The binary features of one image; N may be 0.

    Raises ValueError for arrays of another shape or type, positions outside the image, angles that are not finite, or
    levels below 0.
    """

    size: tuple[int, int]
    """Width and height of the image in pixels."""
    pixels: NDArray[np.float64] = field(repr=False)
    """(N, 2) x and y in pixels, with lens distortion; (0, 0) is the center of the first pixel."""
    octaves: NDArray[np.int32] = field(repr=False)
    """(N,) levels of the pyramid; 0 is the image itself."""
    angles: NDArray[np.float64] = field(repr=False)
    """(N,) radians."""
    responses: NDArray[np.float64] = field(repr=False)
    """(N,) detector responses; NaN if unknown."""
    descriptors: NDArray[np.uint8] = field(repr=False)
    """(N, 32) bytes: 256 bits each."""

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
            raise ValueError(f"features: the size is {self.size}; it must be an image's width and height")
        if count and not (self.pixels.min() >= -0.5 and (self.pixels - self.size).max() <= -0.5):
            raise ValueError(f"features: a position is outside the image of {self.size[0]}x{self.size[1]}")
        if not np.isfinite(self.angles).all() or self.octaves.min(initial=0) < 0:
            raise ValueError("features: an angle is not finite, or a level is below 0")

    def __len__(self) -> int:
        return len(self.pixels)

    @classmethod
    def none(cls, size: tuple[int, int]) -> Self:
        """Return the empty set, of an image without features."""
        nothing = np.zeros(0)
        return cls(
            size, np.zeros((0, 2)), np.zeros(0, np.int32), nothing, nothing, np.zeros((0, DESCRIPTOR_BYTES), np.uint8)
        )


@dataclass(frozen=True)
class FeatureSet:
    """The features that a decoder returns for one frame."""

    frame: int
    """Number of the frame in the session."""
    features: Features | None = field(repr=False)
    """None if they are missing."""


@dataclass(frozen=True)
class FeatureFrame:
    """A frame of a sequence of which only the features are available."""

    index: int
    """Index in the sequence as opened."""
    timestamp_s: float
    """Capture time in seconds."""
    features: Features = field(repr=False)


class FeatureEncoder(ABC):
    """An encoding session for the feature sets of one sequence."""

    @abstractmethod
    def push(self, features: Features) -> Packet:
        """Encode the next set into one packet, without writing to it; sets are numbered from 0.

        Raises ValueError if the set cannot be coded, for example if it has too many features.
        """


class FeatureDecoder(ABC):
    """A decoding session for one stream. It starts at a keyframe; sets before it are missing."""

    @abstractmethod
    def push(self, packet: Packet | Loss) -> FeatureSet:
        """Decode the next packet, or LOST in its place; the set of a lost packet is missing.

        A set that depends on a missing one is missing too: nothing is concealed. Raises BitstreamError for damaged or
        foreign bytes; the session resumes at the next packet that `starts`.
        """
