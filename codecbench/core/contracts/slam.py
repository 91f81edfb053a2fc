"""The SLAM contract: frames and a camera go in, a SlamRun comes out. A backend never sees ground truth or codecs."""

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
"""`refused`: the backend could not process the frame at all, for example because of its size; see its reason."""


@dataclass(frozen=True)
class TrackedFrame:
    """Tracking of one frame."""

    index: int
    """Index of the frame in the sequence."""
    timestamp_s: float
    state: FrameState
    inliers: int = 0
    """Number of map points that support its pose."""
    keyframe: bool = False
    """Whether it became a keyframe of the map."""
    map_id: int = 0
    """The map that it is in."""
    reason: str = ""
    """Why it was not tracked."""
    elapsed_ms: float = float("nan")
    """Processing time in milliseconds."""


@dataclass(frozen=True)
class LoopEvent:
    """A loop closure, or a merge of two maps."""

    frame: int
    """Index of the frame at which it happened."""
    matched_frame: int
    """Index of the earlier keyframe's frame that was matched."""
    inliers: int
    """Number of matches that support it."""
    merged_maps: bool = False
    """Whether two maps were merged."""


@dataclass(frozen=True)
class SlamRun:
    """Result of a backend on a sequence. Positions are in the map's own unit: monocular scale is free."""

    frames: tuple[TrackedFrame, ...]
    """One entry for each input frame."""
    trajectory: Trajectory
    """Every tracked frame of the largest map, after all corrections (the paper's "optimised")."""
    trajectory_before_loops: Trajectory
    """The same frames as tracked, before loop closure moved them (the paper's "estimated")."""
    keyframe_indices: NDArray[np.int64]
    """(K,) frame indices."""
    points_world: NDArray[np.float64]
    """(M, 3) map points."""
    loops: tuple[LoopEvent, ...]
    """Loop closures and map merges."""
    maps: int
    """Number of maps that were started and remain."""


class SlamBackend(Configured[P]):
    """A monocular SLAM system."""

    architectures: ClassVar[frozenset[Literal["cta", "atc", "features"]]]
    """Inputs that it supports: `cta`, one image a frame; `atc`, a second image of keyframes; `features`, no image."""
    kernels: ClassVar[tuple[str, ...]] = ()
    """Packages and modules whose kernels a run compiles ahead."""

    @abstractmethod
    def run(
        self,
        frames: Iterable[Frame],
        camera: Camera,
        *,
        seed: int,
        keyframe_image: Callable[[int], Image] | None = None,
    ) -> SlamRun:
        """Track all frames in order. Draw all randomness that can be seeded from `seed`.

        `keyframe_image` selects analyze-then-compress: given a frame index, it returns the decoded image that mapping
        and loop closing see when that frame becomes a keyframe. Tracking loss is a state with a reason, not an
        exception. Raises SlamError if no frame of the input can be used.
        """

    def run_features(self, frames: Iterable[FeatureFrame], camera: Camera, *, seed: int) -> SlamRun:
        """Run on features extracted elsewhere; for backends whose `architectures` include `features`.

        Raises Unsupported for features of another pyramid than its own.
        """
        raise Unsupported(f"slam backend {self.name} accepts images, not features")
