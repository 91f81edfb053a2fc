"""Where a robot thinks it is at each moment, beside where it is."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.metric import FRESH_S
from codecbench.core.contracts.sequence import Trajectory
from codecbench.core.contracts.slam import SlamRun
from codecbench.plugins.evaluators.trajectory.alignment import Similarity, nearest_stamps


def newest_poses(run: SlamRun, read_at: Mapping[int, float], moments_s: NDArray[np.float64]) -> NDArray[np.int64]:
    """(M,) which pose of tracking is the newest that is known at each moment, -1 before there is one.

    read_at: when the pose of a frame was known, by its index, in the time of `moments_s`.
    """
    stamps_s = np.array([frame.timestamp_s for frame in run.frames])
    frames = nearest_stamps(run.trajectory_before_loops.timestamps_s, stamps_s, 0.0)
    known_s = np.array([read_at[run.frames[frame].index] for frame in frames])
    return np.asarray(np.searchsorted(known_s, moments_s + 1e-9, side="right") - 1)


def live_positions(run: SlamRun, world_from_map: Similarity | None, newest: NDArray[np.int64]) -> NDArray[np.float64]:
    """(M, 3) the newest position that is known at each moment, NaN before there is one.

    Poses are those of tracking, before anything corrected them later.
    """
    positions = np.full((len(newest), 3), np.nan)
    if world_from_map is not None:
        tracked = world_from_map.trajectory(run.trajectory_before_loops)
        positions[newest >= 0] = tracked.positions_world[newest[newest >= 0]]
    return positions


def fresh_fraction(run: SlamRun, newest: NDArray[np.int64], stamps_s: NDArray[np.float64]) -> float:
    """The share of the moments at which a pose of the last half second is known.

    stamps_s: (M,) of the moments, in the time of the frames.
    """
    known = newest >= 0
    ages_s = stamps_s[known] - run.trajectory_before_loops.timestamps_s[newest[known]]
    return float(np.count_nonzero(ages_s <= FRESH_S + 1e-6)) / len(newest)


def live_errors(
    positions: NDArray[np.float64], stamps_s: NDArray[np.float64], truth: Trajectory, tolerance_s: float
) -> NDArray[np.float64]:
    """(M,) how far from the truth each position is, metres; NaN where no truth is near in time, or none is known yet.

    stamps_s: (M,) of the moments, in the time of the truth. Where none is ever known, the middle of the true path
    stands in for it, so that a robot that never knows has the spread of its path as error.
    """
    nearest = nearest_stamps(stamps_s, truth.timestamps_s, tolerance_s)
    true = np.where((nearest >= 0)[:, None], truth.positions_world[nearest], np.nan)
    if np.isnan(true).all():
        return np.full(len(stamps_s), np.nan)
    if np.isnan(positions).all():
        positions = np.nanmean(true, axis=0)
    return np.asarray(np.linalg.norm(positions - true, axis=1))
