"""Convert the files and the log of ORB-SLAM3 to a SlamRun."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from codecbench.core.contracts.sequence import Trajectory
from codecbench.core.contracts.slam import LoopEvent, SlamRun, TrackedFrame

STAMP_TOLERANCE_S: Final = 1e-3
"""Saved stamps are rounded; frames are further apart than this."""

LOOP: Final = b"*Loop detected"
MERGE: Final = b"*Merge detected"
NEW_MAP: Final = b"New Map created"
"""Lines that ORB-SLAM3 prints."""
UNKNOWN_FRAME: Final = -1
"""The matched frame of a loop, which the log does not name."""


class PrintedEvents:
    """Reads closed loops and the number of started maps from a growing log, the only report of them."""

    def __init__(self, log: Path) -> None:
        self._log = log
        self._position = 0
        self.loops: list[LoopEvent] = []
        self.maps_started = 0

    def read(self, frame: int) -> None:
        """Read the complete lines printed since the last call, which belong to the time of `frame`."""
        if not self._log.exists():
            return
        with self._log.open("rb") as stream:
            stream.seek(self._position)
            text = stream.read()
        whole = text.rfind(b"\n") + 1
        self._position += whole
        for line in text[:whole].splitlines():
            if LOOP in line or MERGE in line:
                self.loops.append(LoopEvent(frame, UNKNOWN_FRAME, 0, merged_maps=MERGE in line))
            self.maps_started += NEW_MAP in line


@dataclass(frozen=True)
class TrackedPose:
    """The pose of a frame when it was tracked."""

    timestamp_s: float
    world_from_camera: list[list[float]]
    """4x4."""


def run_from_files(
    folder: Path, states: list[TrackedFrame], poses: list[TrackedPose], events: PrintedEvents
) -> SlamRun:
    """The run whose trajectories ORB-SLAM3 saved as frames.txt (nanoseconds) and keyframes.txt (seconds)."""
    stamps_s = np.array([frame.timestamp_s for frame in states])
    saved = _read_rows(folder / "frames.txt")
    saved[:, 0] *= 1e-9
    indices, rows = _match_frames(saved, stamps_s)
    final = Trajectory(stamps_s[indices], _poses(rows))
    final_stamps_s = set(final.timestamps_s.tolist())
    as_tracked = [pose for pose in poses if pose.timestamp_s in final_stamps_s]
    before = Trajectory(
        np.array([pose.timestamp_s for pose in as_tracked]),
        np.array([pose.world_from_camera for pose in as_tracked]).reshape(-1, 4, 4),
    )
    keyframes, _ = _match_frames(_read_rows(folder / "keyframes.txt"), stamps_s)
    is_keyframe = set(keyframes.tolist())
    return SlamRun(
        frames=tuple(replace(frame, keyframe=position in is_keyframe) for position, frame in enumerate(states)),
        trajectory=final,
        trajectory_before_loops=before,
        keyframe_indices=np.array([states[position].index for position in keyframes], dtype=np.int64),
        points_world=np.empty((0, 3)),
        loops=tuple(events.loops),
        maps=events.maps_started,
    )


def _read_rows(path: Path) -> NDArray[np.float64]:
    """(N, 8) stamp, position, quaternion x y z w; empty if nothing was saved."""
    lines = path.read_text().splitlines() if path.exists() else []
    rows = [line.split() for line in lines if line.strip() and not line.startswith("#")]
    return np.array(rows, dtype=np.float64).reshape(-1, 8)


def _match_frames(
    rows: NDArray[np.float64], stamps_s: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Indices of the frames to which rows belong, increasing and without repeats, and those rows."""
    if len(rows) == 0 or len(stamps_s) == 0:
        return np.empty(0, np.int64), np.empty((0, 8))
    nearest = np.abs(rows[:, :1] - stamps_s[None]).argmin(axis=1)
    near = np.abs(rows[:, 0] - stamps_s[nearest]) <= STAMP_TOLERANCE_S
    positions, first = np.unique(nearest[near], return_index=True)
    return positions.astype(np.int64), rows[near][first]


def _poses(rows: Sequence[Sequence[float]] | NDArray[np.float64]) -> NDArray[np.float64]:
    table = np.asarray(rows, dtype=np.float64).reshape(-1, 8)
    poses = np.tile(np.eye(4), (len(table), 1, 1))
    if len(table):
        poses[:, :3, :3] = Rotation.from_quat(table[:, 4:]).as_matrix()
        poses[:, :3, 3] = table[:, 1:4]
    return poses
