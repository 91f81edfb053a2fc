"""Sequences of frames and the datasets that open them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Literal, TypeAlias, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.image import Image, Layout, png_bytes
from codecbench.core.contracts.params import Configured, P

T = TypeVar("T")
CameraModel: TypeAlias = Literal["pinhole", "equidistant"]


@dataclass(frozen=True)
class Camera:
    """A camera. Lengths are in pixels; pixel centers are at integer coordinates."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """Coefficients in OpenCV's order, all zero for rectified images.

    `pinhole` (Brown-Conrady): k1, k2, p1, p2, k3, and k4, k5, k6 for the rational model. `equidistant`: k1, k2, k3, k4,
    0."""
    model: CameraModel = "pinhole"
    """`pinhole`, or `equidistant` for a fisheye (Kannala-Brandt)."""


@dataclass(frozen=True)
class Trajectory:
    """Camera poses over time."""

    timestamps_s: NDArray[np.float64]
    """(N,) seconds, strictly increasing."""
    world_from_camera: NDArray[np.float64]
    """(N, 4, 4) rigid transforms; translations in meters. Rotations are NaN if only positions are known."""

    def __len__(self) -> int:
        return len(self.timestamps_s)

    @property
    def positions_world(self) -> NDArray[np.float64]:
        """(N, 3) camera centers in meters."""
        return self.world_from_camera[:, :3, 3]

    @property
    def has_rotations(self) -> bool:
        """Whether rotations are known too."""
        return bool(np.isfinite(self.world_from_camera).all())


@dataclass(frozen=True)
class Frame:
    """One image of a sequence."""

    index: int
    """Index in the sequence as opened."""
    timestamp_s: float
    """Capture time in seconds."""
    image: Image = field(repr=False)
    cache: dict[Hashable, Any] = field(default_factory=dict, repr=False, compare=False, kw_only=True)
    """Results of `cached`, by key."""

    def cached(self, key: Hashable, compute: Callable[[Image], T]) -> T:
        """Return `compute(image)`, computed once for all settings of a codec while the frame is in memory.

        `key` must name the result and whatever else it depends on. The result is shared: do not write into it.
        """
        if key not in self.cache:
            self.cache[key] = compute(self.image)
        return cast(T, self.cache[key])

    @property
    def png_size_bytes(self) -> int:
        """Size of this frame as a PNG file in bytes."""
        return self.cached("png_size_bytes", lambda image: len(png_bytes(image)))


@dataclass(frozen=True)
class Origin:
    """What a sequence was opened from; `codecbench try` prints it in one line."""

    kind: str = ""
    """Such as `ROS 2 bag, topic /camera/image_raw`; empty for the summary of its dataset."""
    camera: str = ""
    """Source of the camera, such as `camera_info`."""
    sizes: tuple[tuple[int, int], ...] = ()
    """Distinct widths and heights of its frames in pixels, if they differ."""
    params: dict[str, Any] = field(default_factory=dict)
    """Parameters of its dataset, as JSON types, that suit the files better than those given."""


@dataclass(frozen=True)
class Depth:
    """What the pixels of a depth sequence mean: distances along the optical axis."""

    unit_m: float
    """Meters of a step: 0.001 for millimeters."""
    unknown: int = 0
    """Value of pixels whose distance is unknown."""


class FrameSequence(ABC):
    """Frames in order, read one at a time, with the camera and the ground truth if known."""

    name: str
    """Unique within a matrix."""
    timestamps_s: NDArray[np.float64]
    """(N,) capture times in seconds, strictly increasing."""
    frame_rate_hz: float
    """Nominal frame rate."""
    channels: int
    """1 gray, 3 RGB."""
    bits: int = 8
    """Bits of a sample, 8 or 16; frames of 16 bits are gray."""
    depth: Depth | None = None
    """What pixels mean if they are distances, which have 16 bits; None if they are intensities."""
    camera: Camera | None
    ground_truth: Trajectory | None
    fingerprint: str
    """Hex digest of all that determines frames, camera and ground truth; equal digests mean interchangeable
    sequences."""
    notes: tuple[str, ...] = ()
    """Sentences on changes to the frames or faults of the files; a run prints them first and beside its results."""
    origin: Origin = Origin()
    """What it was opened from."""
    as_calibrated: str = ""
    """If its camera is wrong on purpose, the fingerprint of the sequence with the right camera.

    A run that has both judges nothing by this one."""

    @property
    def layout(self) -> Layout:
        """Channels and bits of its frames."""
        return Layout(self.channels, self.bits)

    def __len__(self) -> int:
        return len(self.timestamps_s)

    @abstractmethod
    def read(self, index: int) -> Frame:
        """Return frame `index` in 0..len-1. Raises DatasetError, naming the file, if it cannot be read."""

    def __iter__(self) -> Iterator[Frame]:
        return (self.read(index) for index in range(len(self)))


class Dataset(Configured[P]):
    """A kind of sequence, on disk or synthetic; an instance is one sequence, not yet opened."""

    kernels: ClassVar[tuple[str, ...]] = ()
    """Packages and modules whose kernels a run compiles ahead."""
    catch_all: ClassVar[bool] = False
    """Takes whatever no other dataset recognizes."""

    @classmethod
    def recognise(cls, path: Path) -> dict[str, Any] | None:
        """Return parameters that open the recording at `path`, as JSON types; None if it is not of this kind.

        Look only at names and first bytes, for `codecbench try`; `open` checks whether the recording is complete.
        """
        return None

    @abstractmethod
    def open(self) -> FrameSequence:
        """Check the files and return the sequence. Raises DatasetError with file and line."""
