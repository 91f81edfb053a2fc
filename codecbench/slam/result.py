"""What a run leaves behind: a state for each frame, trajectories, map points, closed loops, merged maps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

State = Literal["not_initialized", "tracked", "lost", "refused"]


@dataclass(frozen=True)
class FrameState:
    """What happened to one frame: its state and the reason for it, the map points that support its pose, whether it
    became a keyframe, and the map that it is in; in a Result, the one that this has become part of."""

    index: int
    timestamp_s: float
    state: State
    inliers: int = 0
    keyframe: bool = False
    map_index: int = 0
    reason: str = ""


@dataclass(frozen=True)
class ClosedLoop:
    """A loop closed at `frame_index` with the keyframe of `matched_frame_index`, on `inliers` matches."""

    frame_index: int
    matched_frame_index: int
    inliers: int


@dataclass(frozen=True)
class MergedMaps:
    """Map `gone_map_index` became part of map `map_index` at `frame_index`, which showed the place of the keyframe of
    `matched_frame_index`, on `inliers` matches."""

    frame_index: int
    matched_frame_index: int
    inliers: int
    map_index: int
    gone_map_index: int


@dataclass(frozen=True)
class FrameTrajectory:
    """The poses of tracked frames: `frame_indices` (N,), counted from the first frame that was processed,
    `timestamps_s` (N,), `world_from_camera` (N, 4, 4) in the map's unit."""

    frame_indices: NDArray[np.int64]
    timestamps_s: NDArray[np.float64]
    world_from_camera: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.timestamps_s)


@dataclass(frozen=True)
class MapResult:
    """One map of a run: `trajectory` after all corrections, `trajectory_before_loops` as tracked, `keyframe_indices`
    (K,) frame indices of the keyframes that are left, `points_world` (P, 3)."""

    index: int
    trajectory: FrameTrajectory
    trajectory_before_loops: FrameTrajectory
    keyframe_indices: NDArray[np.int64]
    points_world: NDArray[np.float64]


_NOTHING = FrameTrajectory(np.empty(0, np.int64), np.empty(0), np.empty((0, 4, 4)))


@dataclass(frozen=True)
class Result:
    """A run: a state for each frame, the loops, and the maps that are left, the one with most frames first; `merges`:
    which others became part of these."""

    frames: tuple[FrameState, ...]
    loops: tuple[ClosedLoop, ...]
    maps: tuple[MapResult, ...]
    merges: tuple[MergedMaps, ...] = ()

    @property
    def main(self) -> MapResult:
        """The map with most frames; one without frames or points when no map was started."""
        return self.maps[0] if self.maps else MapResult(0, _NOTHING, _NOTHING, np.empty(0, np.int64), np.empty((0, 3)))

    @property
    def trajectory(self) -> FrameTrajectory:
        """The main map's trajectory after all corrections."""
        return self.main.trajectory

    @property
    def trajectory_before_loops(self) -> FrameTrajectory:
        """The main map's trajectory as it was tracked."""
        return self.main.trajectory_before_loops

    @property
    def keyframe_indices(self) -> NDArray[np.int64]:
        """Frame indices (K,) of the main map's keyframes."""
        return self.main.keyframe_indices

    @property
    def points_world(self) -> NDArray[np.float64]:
        """Points (P, 3) of the main map."""
        return self.main.points_world
