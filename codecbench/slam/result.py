"""Results of a run: frame states, trajectories, map points, closed loops and merged maps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

State = Literal["not_initialized", "tracked", "lost", "refused"]


@dataclass(frozen=True)
class FrameState:
    """State of one frame."""

    index: int
    timestamp_s: float
    state: State
    inliers: int = 0
    """Map points that support the pose."""
    keyframe: bool = False
    """Whether the frame became a keyframe."""
    map_index: int = 0
    """Index of the frame's map; in a Result, of the map that this one became part of."""
    reason: str = ""
    """Why the frame has this state; empty if it is tracked."""


@dataclass(frozen=True)
class ClosedLoop:
    """A loop that was closed."""

    frame_index: int
    """Frame at which the loop was closed."""
    matched_frame_index: int
    """Frame of the older keyframe that shows the same place."""
    inliers: int
    """Matches that support the loop."""


@dataclass(frozen=True)
class MergedMaps:
    """A merge of two maps."""

    frame_index: int
    """Frame that showed a place of the other map."""
    matched_frame_index: int
    """Frame of the other map's keyframe that shows the same place."""
    inliers: int
    """Matches that support the merge."""
    map_index: int
    """Index of the merged map."""
    gone_map_index: int
    """Index of the map that became part of it."""


@dataclass(frozen=True)
class FrameTrajectory:
    """Poses of tracked frames."""

    frame_indices: NDArray[np.int64]
    """Indices (N,), counted from the first frame that was processed."""
    timestamps_s: NDArray[np.float64]
    """Times (N,), seconds."""
    world_from_camera: NDArray[np.float64]
    """Poses (N, 4, 4) in the map's unit."""

    def __len__(self) -> int:
        return len(self.timestamps_s)


@dataclass(frozen=True)
class MapResult:
    """One map of a run."""

    index: int
    trajectory: FrameTrajectory
    """Trajectory after all corrections."""
    trajectory_before_loops: FrameTrajectory
    """Trajectory as tracked."""
    keyframe_indices: NDArray[np.int64]
    """Frame indices (K,) of the keyframes that are left."""
    points_world: NDArray[np.float64]
    """Map points (P, 3)."""


_EMPTY_TRAJECTORY = FrameTrajectory(np.empty(0, np.int64), np.empty(0), np.empty((0, 4, 4)))


@dataclass(frozen=True)
class Result:
    """Result of a run."""

    frames: tuple[FrameState, ...]
    """A state for each frame."""
    loops: tuple[ClosedLoop, ...]
    maps: tuple[MapResult, ...]
    """The maps that are left, the one with most frames first."""
    merges: tuple[MergedMaps, ...] = ()
    """Which maps became part of others."""

    @property
    def main(self) -> MapResult:
        """The map with most frames; an empty one if no map was started."""
        return (
            self.maps[0]
            if self.maps
            else MapResult(0, _EMPTY_TRAJECTORY, _EMPTY_TRAJECTORY, np.empty(0, np.int64), np.empty((0, 3)))
        )

    @property
    def trajectory(self) -> FrameTrajectory:
        """The main map's trajectory after all corrections."""
        return self.main.trajectory

    @property
    def trajectory_before_loops(self) -> FrameTrajectory:
        """The main map's trajectory as tracked."""
        return self.main.trajectory_before_loops

    @property
    def keyframe_indices(self) -> NDArray[np.int64]:
        """Frame indices (K,) of the main map's keyframes."""
        return self.main.keyframe_indices

    @property
    def points_world(self) -> NDArray[np.float64]:
        """Points (P, 3) of the main map."""
        return self.main.points_world
