"""A SLAM run against the truth, where the sequence has it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.evaluator import Measurement
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

    after, before: world_from_map of the final trajectory and of the one before loop closing; None where there is no
    ground truth or too little was tracked.
    """

    def __init__(
        self,
        run: SlamRun,
        sequence: FrameSequence,
        stamps_s: NDArray[np.float64],
        association_s: float,
        interval_s: float,
    ) -> None:
        """stamps_s: of all frames that there were, whether SLAM saw them or not."""
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
        yield from _defined(("ate_rmse_m", "ate_median_m"), lambda: self._absolute(pairs))
        yield from _defined(("ate_rmse_first_frame_m",), lambda: (errors.first_frame_rmse(pairs),))
        yield from _defined(("ate_before_loops_m",), lambda: (self._before_loops(truth),))
        yield from _defined((*HELD, SPREAD), lambda: self._held(truth))
        yield from _defined(("rpe_trans_m", "rpe_rot_deg"), lambda: self._relative(pairs))
        yield from _defined(("scale_drift",), lambda: (errors.scale_drift(pairs),))

    def _absolute(self, pairs: Pairs) -> tuple[float, ...]:
        self.after = align(pairs)
        distances_m = errors.position_errors(pairs, self.after)
        return errors.rms(distances_m), float(np.median(distances_m))

    def _before_loops(self, truth: Trajectory) -> float:
        pairs = associate(self._run.trajectory_before_loops, truth, self._association_s)
        self.before = align(pairs)
        return errors.rms(errors.position_errors(pairs, self.before))

    def _held(self, truth: Trajectory) -> tuple[float, ...]:
        stamps_s = self._stamps_s
        nearest = nearest_stamps(stamps_s, truth.timestamps_s, self._association_s)
        if not (nearest >= 0).any():
            raise Undefined("no frame has ground truth")
        true = truth.positions_world[nearest[nearest >= 0]]
        held = errors.held_errors(stamps_s[nearest >= 0], true, self._run.trajectory)
        return held.whole_m, *held, errors.spread(true)

    def _relative(self, pairs: Pairs) -> tuple[float, ...]:
        similarity = self.after or align(pairs)
        return errors.relative_errors(pairs, similarity, self._interval_s, self._half_frame_s)


def _defined(names: tuple[str, ...], compute: Callable[[], tuple[float, ...]]) -> Iterator[Measurement]:
    """The values under their names, or the reason why there are none."""
    try:
        values = compute()
    except Undefined as why:
        yield from (Measurement(name, math.nan, reason=str(why)) for name in names)
        return
    yield from (Measurement(name, value) for name, value in zip(names, values, strict=True))
