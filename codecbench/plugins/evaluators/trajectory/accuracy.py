"""Accuracy of a SLAM run against the ground truth, at the end of the run and live at each moment."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.evaluator import Measurement
from codecbench.core.contracts.metric import FRESH_S
from codecbench.core.contracts.sequence import FrameSequence, Trajectory
from codecbench.core.contracts.slam import SlamRun
from codecbench.plugins.evaluators.trajectory import errors
from codecbench.plugins.evaluators.trajectory.alignment import (
    Pairs,
    Similarity,
    Undefined,
    align,
    associate,
    nearest_stamps,
)
from codecbench.plugins.evaluators.trajectory.metrics import ACCURACY, HELD, SPREAD


class Accuracy:
    """Compares one run with the ground truth of its sequence.

    after, before: world_from_map of the final trajectory and of the one before loop closing; None if there is no ground
    truth or too little was tracked.
    """

    def __init__(
        self,
        run: SlamRun,
        sequence: FrameSequence,
        stamps_s: NDArray[np.float64],
        association_s: float,
        interval_s: float,
    ) -> None:
        """stamps_s: of all frames, whether SLAM saw them or not."""
        self._run = run
        self._stamps_s = stamps_s
        self._truth = sequence.ground_truth
        self._association_s = association_s
        self._interval_s = interval_s
        self._half_frame_s = max(association_s, 0.5 / sequence.frame_rate_hz)
        self.after: Similarity | None = None
        self.before: Similarity | None = None

    def measurements(self) -> Iterator[Measurement]:
        """All metrics of ACCURACY, each with a value or a reason."""
        truth = self._truth
        if truth is None:
            for metric in ACCURACY:
                yield Measurement(metric.name, math.nan, reason="the sequence has no ground truth")
            return
        pairs = associate(self._run.trajectory, truth, self._association_s)
        yield from _measure_or_explain(("ate_rmse_m", "ate_median_m"), lambda: self._absolute(pairs))
        yield from _measure_or_explain(("ate_rmse_first_frame_m",), lambda: (errors.first_frame_rmse(pairs),))
        yield from _measure_or_explain(("ate_before_loops_m",), lambda: (self._before_loops(truth),))
        yield from _measure_or_explain((*HELD, SPREAD), lambda: self._last_pose_hold(truth))
        yield from _measure_or_explain(("rpe_trans_m", "rpe_rot_deg"), lambda: self._relative(pairs))
        yield from _measure_or_explain(("scale_drift",), lambda: (errors.scale_drift(pairs),))

    def _absolute(self, pairs: Pairs) -> tuple[float, ...]:
        self.after = align(pairs)
        distances_m = errors.position_errors(pairs, self.after)
        return errors.rms(distances_m), float(np.median(distances_m))

    def _before_loops(self, truth: Trajectory) -> float:
        pairs = associate(self._run.trajectory_before_loops, truth, self._association_s)
        self.before = align(pairs)
        return errors.rms(errors.position_errors(pairs, self.before))

    def _last_pose_hold(self, truth: Trajectory) -> tuple[float, ...]:
        stamps_s = self._stamps_s
        nearest = nearest_stamps(stamps_s, truth.timestamps_s, self._association_s)
        if not (nearest >= 0).any():
            raise Undefined("no frame has ground truth")
        true = truth.positions_world[nearest[nearest >= 0]]
        parts = errors.held_errors(stamps_s[nearest >= 0], true, self._run.trajectory)
        return parts.whole_m, *parts, errors.spread(true)

    def _relative(self, pairs: Pairs) -> tuple[float, ...]:
        similarity = self.after or align(pairs)
        return errors.relative_errors(pairs, similarity, self._interval_s, self._half_frame_s)


def _measure_or_explain(names: tuple[str, ...], compute: Callable[[], tuple[float, ...]]) -> Iterator[Measurement]:
    """One measurement for each name, or NaN with the reason if the values are undefined."""
    try:
        values = compute()
    except Undefined as why:
        yield from (Measurement(name, math.nan, reason=str(why)) for name in names)
        return
    yield from (Measurement(name, value) for name, value in zip(names, values, strict=True))


def newest_poses(run: SlamRun, read_at: Mapping[int, float], moments_s: NDArray[np.float64]) -> NDArray[np.int64]:
    """(M,) index of the newest tracked pose that is known at each moment, -1 before there is one.

    read_at: by frame index, when the pose of the frame was known, on the clock of `moments_s`.
    """
    stamps_s = np.array([frame.timestamp_s for frame in run.frames])
    frames = nearest_stamps(run.trajectory_before_loops.timestamps_s, stamps_s, 0.0)
    known_s = np.array([read_at[run.frames[frame].index] for frame in frames])
    return np.asarray(np.searchsorted(known_s, moments_s + 1e-9, side="right") - 1)


def live_positions(run: SlamRun, world_from_map: Similarity | None, newest: NDArray[np.int64]) -> NDArray[np.float64]:
    """(M, 3) newest known position at each moment, NaN before there is one.

    Poses are as tracked, without later corrections.
    """
    positions = np.full((len(newest), 3), np.nan)
    if world_from_map is not None:
        tracked = world_from_map.trajectory(run.trajectory_before_loops)
        positions[newest >= 0] = tracked.positions_world[newest[newest >= 0]]
    return positions


def fresh_fraction(run: SlamRun, newest: NDArray[np.int64], stamps_s: NDArray[np.float64]) -> float:
    """The share of the moments at which a pose from the last half second is known.

    stamps_s: (M,) the moments, on the clock of the frames.
    """
    known = newest >= 0
    ages_s = stamps_s[known] - run.trajectory_before_loops.timestamps_s[newest[known]]
    return float(np.count_nonzero(ages_s <= FRESH_S + 1e-6)) / len(newest)


def live_errors(
    positions: NDArray[np.float64], stamps_s: NDArray[np.float64], truth: Trajectory, tolerance_s: float
) -> NDArray[np.float64]:
    """(M,) distance in metres of each position from the truth; NaN if no truth is near in time or no position is known.

    stamps_s: (M,) the moments, on the clock of the truth. If no position is ever known, the mean true position is taken
    instead, so the error of a robot without any pose is the spread of its path.
    """
    nearest = nearest_stamps(stamps_s, truth.timestamps_s, tolerance_s)
    true = np.where((nearest >= 0)[:, None], truth.positions_world[nearest], np.nan)
    if np.isnan(true).all():
        return np.full(len(stamps_s), np.nan)
    if np.isnan(positions).all():
        positions = np.nanmean(true, axis=0)
    return np.asarray(np.linalg.norm(positions - true, axis=1))
