"""Sequences of frames and the datasets that open them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Literal, TypeAlias, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.image import Image, png_bytes
from codecbench.core.contracts.params import Configured, P

T = TypeVar("T")
CameraModel: TypeAlias = Literal["pinhole", "equidistant"]


@dataclass(frozen=True)
class Camera:
    """A camera; lengths in pixels, pixel centres at integers.

    model: `pinhole`, with Brown-Conrady distortion k1, k2, p1, p2, k3 as OpenCV orders them, all zero for rectified
    images, or these and k4, k5, k6 of OpenCV's rational model; or `equidistant`, a fisheye (Kannala-Brandt) with k1,
    k2, k3, k4, 0.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    model: CameraModel = "pinhole"


@dataclass(frozen=True)
class Trajectory:
    """Camera poses over time.

    timestamps_s: (N,) seconds, strictly increasing. world_from_camera: (N, 4, 4) rigid transforms, metres.
    """

    timestamps_s: NDArray[np.float64]
    world_from_camera: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.timestamps_s)

    @property
    def positions_world(self) -> NDArray[np.float64]:
        """(N, 3) camera centres in metres."""
        return self.world_from_camera[:, :3, 3]


@dataclass(frozen=True)
class Frame:
    """One image: its index in the sequence as opened, its time in seconds, its pixels."""

    index: int
    timestamp_s: float
    image: Image = field(repr=False)
    cache: dict[Hashable, Any] = field(default_factory=dict, repr=False, compare=False, kw_only=True)

    def cached(self, key: Hashable, compute: Callable[[Image], T]) -> T:
        """What `compute` makes of the pixels, computed once for all settings of a codec while the frame is kept.

        `key` must name the result and whatever else it depends on. What is returned belongs to all who ask: do not
        write into it.
        """
        if key not in self.cache:
            self.cache[key] = compute(self.image)
        return cast(T, self.cache[key])

    @property
    def png_size_bytes(self) -> int:
        """Size of this frame as PNG."""
        return self.cached("png_size_bytes", lambda image: len(png_bytes(image)))


@dataclass(frozen=True)
class Origin:
    """What a sequence was opened from, for `codecbench try`, which tells it in a line.

    kind: such as `ROS 2 bag, topic /camera/image_raw`; empty: what its dataset is said to be. camera: what the camera
    was taken from, such as `camera_info`. sizes: width and height of its frames in pixels, each once, where they
    differ. params: parameters of its dataset, as JSON types, that suit what was found better than those given.
    """

    kind: str = ""
    camera: str = ""
    sizes: tuple[tuple[int, int], ...] = ()
    params: dict[str, Any] = field(default_factory=dict)


class FrameSequence(ABC):
    """Frames in order, read one at a time, with whatever is known about the camera and its true path.

    Attributes that every sequence sets: `name`, unique within a matrix; `timestamps_s` (N,) strictly
    increasing; `frame_rate_hz`, nominal; `channels`, 1 or 3; `camera` and `ground_truth` or None;
    `fingerprint`, a hex digest of everything that determines the frames, the camera and the ground truth:
    two sequences with equal fingerprints are interchangeable. `notes`: sentences on what was done to the frames or is
    wrong with the files, which a run says before it begins and beside its results. `origin`: what it was opened from.
    `as_calibrated`: of one whose camera is wrong on purpose, the fingerprint of the same with the right one, beside
    which a run judges nothing by it.
    """

    name: str
    timestamps_s: NDArray[np.float64]
    frame_rate_hz: float
    channels: int
    camera: Camera | None
    ground_truth: Trajectory | None
    fingerprint: str
    notes: tuple[str, ...] = ()
    origin: Origin = Origin()
    as_calibrated: str = ""

    def __len__(self) -> int:
        return len(self.timestamps_s)

    @abstractmethod
    def read(self, index: int) -> Frame:
        """Frame `index` in 0..len-1. Raises DatasetError, naming the file, where it cannot be read."""

    def __iter__(self) -> Iterator[Frame]:
        return (self.read(index) for index in range(len(self)))


class Dataset(Configured[P]):
    """A kind of sequence on disk or made by code; an instance is one sequence, not yet opened.

    kernels: the packages and modules whose listed kernels it calls, which a run compiles ahead. catch_all: it takes
    what no other dataset recognises.
    """

    kernels: ClassVar[tuple[str, ...]] = ()
    catch_all: ClassVar[bool] = False

    @classmethod
    def recognise(cls, path: Path) -> dict[str, Any] | None:
        """Parameters that open the recording at `path`, as JSON types; None where it is not of this kind.

        A look at names and first bytes, for `codecbench try`: whether all of it is there is for `open` to say.
        """
        return None

    @abstractmethod
    def open(self) -> FrameSequence:
        """Check what is there and return the sequence. Raises DatasetError with file and line."""
