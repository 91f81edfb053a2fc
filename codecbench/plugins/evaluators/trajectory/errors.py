"""Errors of an estimated trajectory against the true one, by several definitions."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from codecbench.core.contracts.sequence import Trajectory
from codecbench.plugins.evaluators.trajectory.alignment import (
    MIN_POSES,
    Pairs,
    Similarity,
    Undefined,
    align_any_turn,
    nearest_stamps,
)


class RelativeErrors(NamedTuple):
    """RMS errors of the motion over an interval: of the position, and of the rotation angle."""

    trans_m: float
    rot_deg: float


class HeldErrors(NamedTuple):
    """Parts of the ATE with last-pose hold, in metres, whose squares add up to the square of the whole."""

    waiting_m: float
    """Of frames before the first pose."""
    tracked_m: float
    """Of frames with a pose."""
    lost_m: float
    """Of frames without a pose after the first one."""

    @property
    def whole_m(self) -> float:
        """RMS over all frames."""
        return math.hypot(*self)


def position_errors(pairs: Pairs, similarity: Similarity) -> NDArray[np.float64]:
    """(N,) distances in metres between true positions and aligned estimates."""
    estimated = similarity.points(pairs.estimate.positions_world)
    return np.asarray(np.linalg.norm(estimated - pairs.reference.positions_world, axis=1))


def rms(values: NDArray[np.float64]) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def first_frame_rmse(pairs: Pairs) -> float:
    """The error of MATLAB's monocular SLAM example, metres.

    Both trajectories are expressed in the coordinates of their own first pose; the estimate is scaled by the median
    over the poses of |true position| / |estimated position|. Nothing is rotated or shifted to fit. Poses at the first
    position have no ratio and are left out of the median. Raises Undefined for fewer than MIN_POSES.
    """
    if len(pairs) < MIN_POSES:
        raise Undefined(f"{len(pairs)} tracked frame(s) have ground truth; {MIN_POSES} are needed")
    _require_rotations(pairs)
    true, estimated = _from_first(pairs.reference), _from_first(pairs.estimate)
    true_norms, estimated_norms = np.linalg.norm(true, axis=1), np.linalg.norm(estimated, axis=1)
    moved = estimated_norms > 0.0
    if not moved.any():
        raise Undefined("the estimate never leaves its first position, so it has no scale")
    scale = np.median(true_norms[moved] / estimated_norms[moved])
    return rms(np.linalg.norm(scale * estimated - true, axis=1))


def relative_errors(pairs: Pairs, similarity: Similarity, interval_s: float, tolerance_s: float) -> RelativeErrors:
    """Relative pose errors over `interval_s` (Sturm et al., IROS 2012, doi:10.1109/IROS.2012.6385773, eqs. 2 and 4).

    Every pose is paired with the one nearest to `interval_s` later, if one is within `tolerance_s`; gaps are skipped.
    The estimate has the scale of `similarity`. Raises Undefined if no two poses pair.
    """
    _require_rotations(pairs)
    stamps_s = pairs.estimate.timestamps_s
    ends = nearest_stamps(stamps_s + interval_s, stamps_s, tolerance_s)
    starts = np.flatnonzero(ends > np.arange(len(ends)))
    if len(starts) == 0:
        raise Undefined(f"no two tracked frames are {interval_s:g} s apart")
    ends = ends[starts]
    true = _motions(pairs.reference.world_from_camera, starts, ends)
    estimated = _motions(similarity.trajectory(pairs.estimate).world_from_camera, starts, ends)
    errors = np.linalg.inv(true) @ estimated
    angles = np.asarray(Rotation.from_matrix(errors[:, :3, :3]).magnitude())
    return RelativeErrors(rms(np.linalg.norm(errors[:, :3, 3], axis=1)), float(np.degrees(rms(angles))))


def _require_rotations(pairs: Pairs) -> None:
    if not pairs.reference.has_rotations:
        raise Undefined("the ground truth has positions only")


def scale_drift(pairs: Pairs) -> float:
    """|ln(s_late / s_early)|: the change of the map's scale between the first and the last third of the poses.

    Raises Undefined for fewer than three poses in a third, or if the camera does not move in one.
    """
    third = len(pairs) // 3
    early, late = part_scales(pairs, (slice(0, third), slice(len(pairs) - third, len(pairs))))
    return abs(late - early)


def part_scales(pairs: Pairs, parts: tuple[slice, ...]) -> list[float]:
    """ln of the scale of each part, the ratio of the spreads of true and estimated positions about their means.

    This is the symmetric scale of Horn, JOSA A 4(4), 1987, doi:10.1364/JOSAA.4.000629, section 2.E.
    """
    if min(part.stop - part.start for part in parts) < MIN_POSES:
        raise Undefined(f"{len(pairs)} tracked frame(s) have ground truth; {MIN_POSES} are needed in each part")
    true = [spread(pairs.reference.positions_world[part]) for part in parts]
    estimated = [spread(pairs.estimate.positions_world[part]) for part in parts]
    if min(*true, *estimated) == 0.0:
        raise Undefined("the camera does not move in a part of the path")
    return [float(np.log(of_truth / of_estimate)) for of_truth, of_estimate in zip(true, estimated, strict=True)]


def held_errors(stamps_s: NDArray[np.float64], true_positions: NDArray[np.float64], estimate: Trajectory) -> HeldErrors:
    """The ATE with last-pose hold over all frames that have ground truth, tracked or not, in its parts.

    stamps_s, true_positions: (N,) and (N, 3) of these frames. estimate: the tracked frames' poses. An untracked frame
    counts with the last known position, and before there is one with the first. The error is the least under any
    similarity. So if all positions are one, or there is none, it is the spread of the true ones, which is the maximum.
    """
    # Stamps are seconds since 1970 to the microsecond: a double holds them to 0.2 microseconds.
    last = np.searchsorted(estimate.timestamps_s, stamps_s + 1e-6, side="right") - 1
    held = estimate.positions_world[np.maximum(last, 0)] if len(estimate) else np.zeros_like(true_positions)
    squares = np.sum((align_any_turn(held, true_positions).points(held) - true_positions) ** 2, axis=1)
    tracked = nearest_stamps(stamps_s, estimate.timestamps_s, 0.0) >= 0
    part = np.select([tracked, last < 0], [1, 0], 2)
    return HeldErrors(*np.sqrt(np.bincount(part, squares, minlength=3) / len(stamps_s)).tolist())


def _from_first(trajectory: Trajectory) -> NDArray[np.float64]:
    """(N, 3) positions in the coordinates of the first camera."""
    poses = trajectory.world_from_camera
    first = poses[0]
    return np.asarray((poses[:, :3, 3] - first[:3, 3]) @ first[:3, :3])


def _motions(poses: NDArray[np.float64], starts: NDArray[np.int64], ends: NDArray[np.int64]) -> NDArray[np.float64]:
    """(M, 4, 4) start_from_end."""
    return np.asarray(np.linalg.inv(poses[starts]) @ poses[ends])


def spread(positions: NDArray[np.float64]) -> float:
    """RMS distance of positions (N, 3) from their mean."""
    return rms(np.linalg.norm(positions - positions.mean(axis=0), axis=1))
