"""The files that a trajectory cell writes beside its record."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from codecbench.core.contracts.sequence import Trajectory
from codecbench.core.contracts.slam import LoopEvent, TrackedFrame
from codecbench.core.simulation.delivery import Delivery

TRAJECTORY: Final = "trajectory.txt"
TRAJECTORY_BEFORE_LOOPS: Final = "trajectory_before_loops.txt"
KEYFRAMES: Final = "keyframes.txt"
GROUND_TRUTH: Final = "ground_truth.txt"
MAP_POINTS: Final = "map_points.ply"
STATES: Final = "states.csv"
LOOPS: Final = "loops.csv"
LIVE: Final = "live.csv"


def write_tum(path: Path | BinaryIO, trajectory: Trajectory) -> None:
    """Poses as lines `timestamp tx ty tz qx qy qz qw` (TUM's format): seconds, world_from_camera.

    Unknown rotations become 0 0 0 1, because the format has no poses without rotation.
    """
    poses = trajectory.world_from_camera
    if not trajectory.has_rotations:
        poses = np.where(np.isnan(poses), np.eye(4), poses)
    quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat() if len(poses) else np.empty((0, 4))
    rows = np.column_stack([trajectory.timestamps_s, poses[:, :3, 3], quaternions])
    np.savetxt(path, rows, fmt=["%.6f"] + ["%.9g"] * 7, header="timestamp_s tx ty tz qx qy qz qw")


def read_tum(path: Path) -> Trajectory:
    """The trajectory that `write_tum` wrote."""
    lines = [line for line in path.read_text().splitlines() if line and not line.startswith("#")]
    rows = np.array([line.split() for line in lines], dtype=np.float64).reshape(-1, 8)
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    if len(rows):
        poses[:, :3, :3] = Rotation.from_quat(rows[:, 4:]).as_matrix()
        poses[:, :3, 3] = rows[:, 1:4]
    return Trajectory(rows[:, 0], poses)


def select(trajectory: Trajectory, mask: NDArray[np.bool_]) -> Trajectory:
    """The poses for which `mask` (N,) is true."""
    return Trajectory(trajectory.timestamps_s[mask], trajectory.world_from_camera[mask])


def write_points(path: Path, points: NDArray[np.float64]) -> None:
    """(M, 3) points as a binary PLY file of float32 x, y, z."""
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(points)}\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    )
    path.write_bytes(header.encode("ascii") + np.ascontiguousarray(points, dtype="<f4").tobytes())


def write_states(path: Path, frames: tuple[TrackedFrame, ...]) -> None:
    """The tracking state of each frame, one line a frame; without times, so that equal runs write equal files."""
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["frame", "timestamp_s", "state", "inliers", "keyframe", "map_id", "reason"])
        for frame in frames:
            stamp = f"{frame.timestamp_s:.6f}"
            tracking = (frame.inliers, int(frame.keyframe), frame.map_id)
            writer.writerow([frame.index, stamp, frame.state, *tracking, frame.reason])


def write_loops(path: Path, loops: tuple[LoopEvent, ...]) -> None:
    """The closed loops, one line a loop."""
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["frame", "matched_frame", "inliers", "merged_maps"])
        for loop in loops:
            writer.writerow([loop.frame, loop.matched_frame, loop.inliers, int(loop.merged_maps)])


def write_live(
    path: Path, delivery: Delivery, read_at: Mapping[int, float], positions: NDArray[np.float64], offset: int
) -> None:
    """The delivery outcome of each frame from `offset` on, and the newest known position at its capture.

    Times are in seconds from the first frame of the sequence; positions (M, 3) are empty if none was known.
    """
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow(["frame", "taken_s", "fate", "delivered_s", "read_s", "x", "y", "z"])
        for frame, position in enumerate(positions.tolist(), offset):
            times = (float(delivery.handed_s[frame]), read_at.get(frame, math.inf))
            columns = [f"{time_s:.6f}" if math.isfinite(time_s) else "" for time_s in times]
            coordinates = ["" if math.isnan(value) else f"{value:.9g}" for value in position]
            writer.writerow(
                [frame, f"{delivery.captured_s[frame]:.6f}", delivery.outcomes[frame], *columns, *coordinates]
            )


@dataclass(frozen=True)
class Live:
    """The content of a file of `write_live`; arrays have one row for each of M frames."""

    frames: NDArray[np.int64]
    taken_s: NDArray[np.float64]
    """Capture times."""
    outcomes: list[str]
    positions: NDArray[np.float64]
    """(M, 3) newest known position at capture; NaN if there was none."""


def read_live(path: Path) -> Live:
    """Read a file that `write_live` wrote."""
    with path.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    return Live(
        np.array([int(row["frame"]) for row in rows], np.int64),
        np.array([float(row["taken_s"]) for row in rows]),
        [row["fate"] for row in rows],
        np.array([[float(row[axis] or "nan") for axis in "xyz"] for row in rows], np.float64).reshape(-1, 3),
    )
