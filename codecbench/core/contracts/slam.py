"""The SLAM contract: frames and a camera in, a SlamRun out. A backend never sees ground truth or codecs."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.errors import Unsupported
from codecbench.core.contracts.features import FeatureFrame
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.params import Configured, P
from codecbench.core.contracts.sequence import Camera, Frame, Trajectory

FrameState = Literal["not_initialized", "tracked", "lost", "refused"]
"""`refused`: the backend could not look at the frame at all (another size, say); the reason says why."""


@dataclass(frozen=True)
class TrackedFrame:
    """What happened to one frame. inliers: map points that support its pose. map_id: which map it is in."""

    index: int
    timestamp_s: float
    state: FrameState
    inliers: int = 0
    keyframe: bool = False
    map_id: int = 0
    reason: str = ""
    elapsed_ms: float = float("nan")


@dataclass(frozen=True)
class LoopEvent:
    """A loop that was closed: at which frame, onto which earlier keyframe's frame, with how many matches; or, with
    `merged_maps`, two maps that became one there."""

    frame: int
    matched_frame: int
    inliers: int
    merged_maps: bool = False


@dataclass(frozen=True)
class SlamRun:
    """What a backend made of a sequence. Positions are in the map's own unit: monocular scale is free.

    frames: one entry a frame given. trajectory: every tracked frame of the largest map, after all
    corrections (the paper's "optimised"). trajectory_before_loops: the same frames as tracked, before loop
    closing moved them (the paper's "estimated"). keyframe_indices: (K,) frame indices. points_world: (M, 3).
    loops: closed loops and merged maps. maps: number of maps that were started and are left.
    """

    frames: tuple[TrackedFrame, ...]
    trajectory: Trajectory
    trajectory_before_loops: Trajectory
    keyframe_indices: NDArray[np.int64]
    points_world: NDArray[np.float64]
    loops: tuple[LoopEvent, ...]
    maps: int


class SlamBackend(Configured[P]):
    """A monocular SLAM system.

    architectures: what it can be given: `cta`, a frame's one image; `atc`, another image of keyframes; `features`, no
    image. kernels: the packages and modules whose listed kernels it calls, compiled ahead.
    """

    architectures: ClassVar[frozenset[Literal["cta", "atc", "features"]]]
    kernels: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def run(
        self,
        frames: Iterable[Frame],
        camera: Camera,
        *,
        seed: int,
        keyframe_image: Callable[[int], Image] | None = None,
    ) -> SlamRun:
        """Track all frames in order. `seed` is where all randomness comes from that can be seeded.

        `keyframe_image` makes it analyze-then-compress: given a frame index it returns the decoded image
        that mapping and loop closing see when that frame becomes a keyframe. Losing track is a state with a
        reason, not an exception; SlamError is for input that no frame of can be used.
        """

    def run_features(self, frames: Iterable[FeatureFrame], camera: Camera, *, seed: int) -> SlamRun:
        """`run` on what was found in the frames elsewhere; for backends whose `architectures` have `features`.

        Raises Unsupported for features that are not those of its own pyramid.
        """
        raise Unsupported(f"slam backend {self.name} takes images, not features")
