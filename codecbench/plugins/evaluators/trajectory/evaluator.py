"""The `trajectory` evaluator: runs SLAM on what a codec leaves of a sequence and judges the path."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np

from codecbench.core.contracts.errors import SlamError, Unsupported
from codecbench.core.contracts.evaluator import (
    CodedSequence,
    Context,
    Measurement,
    Outcome,
    PluginUse,
    SequenceEvaluator,
)
from codecbench.core.contracts.metric import Metric
from codecbench.core.contracts.sequence import Sequence
from codecbench.core.contracts.slam import SlamRun
from codecbench.core.contracts.view import Drawing, View
from codecbench.plugins.evaluators.trajectory import drawn, files, verdicts
from codecbench.plugins.evaluators.trajectory.accuracy import Accuracy
from codecbench.plugins.evaluators.trajectory.alignment import (
    Similarity,
    Undefined,
    align,
    associate,
    nearest_stamps,
)
from codecbench.plugins.evaluators.trajectory.errors import position_errors, rms
from codecbench.plugins.evaluators.trajectory.feed import Feed
from codecbench.plugins.evaluators.trajectory.metrics import ACCURACY, BEHAVIOUR, COMPARED
from codecbench.plugins.evaluators.trajectory.params import TrajectoryParams


class TrajectoryEvaluator(SequenceEvaluator[TrajectoryParams]):
    """Accuracy and behaviour of monocular SLAM. A run that loses its way is a result; docs/metrics.md says which."""

    name = "trajectory"
    version = "2"
    params_type = TrajectoryParams
    metrics: ClassVar[tuple[Metric, ...]] = (*ACCURACY, *BEHAVIOUR, *COMPARED)
    views = (
        View("curve", "Rate and trajectory error", ("ate_rmse_m",)),
        View("curve", "Rate and tracked share", ("tracked_fraction",)),
        View("map", "Trajectories", note=drawn.NOTE),
    )
    needs = frozenset({"camera"})
    typical_ms_per_frame = 30.0

    @property
    def repeats(self) -> int:
        return len(self.params.start_offsets) * len(self.params.seeds)

    @property
    def uses(self) -> tuple[PluginUse, ...]:
        return (PluginUse("slam_backend", self.params.backend, self.params.backend_params),)

    def repeat_identity(self, repeat: int) -> dict[str, Any]:
        offset, seed = self.params.repeat(repeat)
        listed = {"start_offsets", "seeds", *verdicts.THRESHOLDS}
        shared = {name: value for name, value in self.params.identity().items() if name not in listed}
        return {**shared, "start_offset": offset, "seed": seed}

    def evaluate(self, coded: CodedSequence, context: Context) -> Iterator[Measurement]:
        offset, seed = self.params.repeat(context.repeat)
        backend = context.plugins.create("slam_backend", self.params.backend, self.params.backend_params)
        if self.params.architecture not in backend.architectures:
            raise Unsupported(
                f"slam backend {self.params.backend} cannot run architecture {self.params.architecture}; "
                f"it runs {', '.join(sorted(backend.architectures))}"
            )
        feed = Feed(coded, self.params.architecture, offset)
        camera = coded.sequence.camera
        if camera is None:
            raise Unsupported(f"sequence {coded.sequence.name} has no camera; SLAM needs its calibration")
        run = backend.run(feed.frames(), camera, seed=seed, keyframe_image=feed.keyframe_image)
        _check(run, len(feed), self.params.backend)
        accuracy = Accuracy(run, coded.sequence, self.params.association_s, self.params.rpe_interval_s)
        yield from accuracy.measurements()
        yield from _behaviour(run)
        size_bytes = feed.sent_size_bytes()
        yield Measurement("sent_size_bytes", float(size_bytes))
        yield Measurement("sent_rate_kbps", 8e-3 * size_bytes * coded.sequence.frame_rate_hz / len(feed))
        _save(run, accuracy, coded.sequence, context)

    def compare(self, outcome: Outcome, baseline: list[Outcome]) -> Iterator[Measurement]:
        yield verdicts.success(outcome, baseline, self.params)
        same = next((raw for raw in baseline if raw.repeat == outcome.repeat), None)
        if same is None:
            reason = f"the raw codec has no finished repeat {outcome.repeat} on this sequence"
            for metric in ("starts_in_time", "ate_to_raw_m", "ate_minus_raw_m"):
                yield Measurement(metric, math.nan, reason=reason)
            return
        yield verdicts.starts_in_time(outcome, same, self.params)
        yield _distance(outcome, same)
        difference = outcome.value("ate_rmse_m") - same.value("ate_rmse_m")
        missing = "one of the two runs has no ATE" if math.isnan(difference) else None
        yield Measurement("ate_minus_raw_m", difference, reason=missing)

    def drawing(self, outcome: Outcome) -> Drawing | None:
        return drawn.drawing(outcome)


def _check(run: SlamRun, frames: int, backend: str) -> None:
    """Raise SlamError where a backend's answer cannot be of these frames."""
    if not isinstance(run, SlamRun):
        raise SlamError(f"slam backend {backend} returned {type(run).__name__}; it returns a SlamRun")
    if len(run.frames) != frames:
        raise SlamError(f"slam backend {backend} answered for {len(run.frames)} frames of {frames}")
    if run.points_world.ndim != 2 or run.points_world.shape[1] != 3 or not np.isfinite(run.points_world).all():
        raise SlamError(f"slam backend {backend}: points_world has shape {run.points_world.shape} or is not finite")
    for name, trajectory in (("trajectory", run.trajectory), ("trajectory_before_loops", run.trajectory_before_loops)):
        if trajectory.world_from_camera.shape != (len(trajectory), 4, 4):
            shape = trajectory.world_from_camera.shape
            raise SlamError(f"slam backend {backend}: {name} has poses {shape} for {len(trajectory)} stamps")
        if not np.isfinite(trajectory.world_from_camera).all():
            raise SlamError(f"slam backend {backend}: {name} has poses that are not finite")
        if len(trajectory) > frames:
            raise SlamError(f"slam backend {backend}: {name} has {len(trajectory)} poses for {frames} frames")
        if not np.all(np.diff(trajectory.timestamps_s, prepend=-np.inf) > 0):
            raise SlamError(f"slam backend {backend}: timestamps of {name} do not increase")


def _behaviour(run: SlamRun) -> Iterator[Measurement]:
    """What SLAM did, whatever the truth is."""
    stamps_s = run.trajectory.timestamps_s
    states = [frame.state for frame in run.frames]
    lost = sum(before == "tracked" and now != "tracked" for before, now in pairwise(states))
    yield Measurement("tracked_fraction", len(stamps_s) / len(run.frames))
    yield from _since_map(run)
    tracked = (frame.index for frame in run.frames if len(stamps_s) and frame.timestamp_s >= stamps_s[0] - 1e-6)
    yield _or_missing("first_tracked_frame", next(tracked, None), "no frame was tracked")
    yield Measurement("times_lost", float(lost))
    yield Measurement("maps", float(run.maps))
    yield Measurement("keyframes", float(len(run.keyframe_indices)))
    points = None if len(stamps_s) and not len(run.points_world) else len(run.points_world)
    yield _or_missing("map_points", points, "the backend does not give its points")
    closed = [loop.frame for loop in run.loops if not loop.merged_maps]
    yield Measurement("maps_merged", float(len(run.loops) - len(closed)))
    yield Measurement("loops_closed", float(len(closed)))
    yield _or_missing("loop_frame", min(closed, default=None), "no loop was closed")
    inliers = [frame.inliers for frame in run.frames if frame.state == "tracked"]
    yield _or_missing("mean_inliers", np.mean(inliers) if inliers else None, "no frame was tracked")
    elapsed = [frame.elapsed_ms for frame in run.frames if math.isfinite(frame.elapsed_ms)]
    yield _or_missing("slam_ms_per_frame", np.mean(elapsed) if elapsed else None, "the backend does not time itself")


def _since_map(run: SlamRun) -> Iterator[Measurement]:
    """How long the first map took, whichever map was kept in the end, and how much of the rest has a pose."""
    before = next((place for place, frame in enumerate(run.frames) if frame.state == "tracked"), len(run.frames))
    yield Measurement("initialisation_frames", float(before))
    if before == len(run.frames):
        yield Measurement("tracked_since_map_fraction", math.nan, reason="there never was a map")
        return
    tracked = np.count_nonzero(run.trajectory.timestamps_s >= run.frames[before].timestamp_s - 1e-6)
    yield Measurement("tracked_since_map_fraction", tracked / (len(run.frames) - before))


def _or_missing(metric: str, value: float | np.floating | None, reason: str) -> Measurement:
    return Measurement(metric, math.nan, reason=reason) if value is None else Measurement(metric, float(value))


def _distance(outcome: Outcome, raw: Outcome) -> Measurement:
    """The outcome's trajectory against the raw codec's, frame by frame, after Sim(3) alignment."""
    estimate, reference = (files.read_tum(run.artifacts / files.TRAJECTORY) for run in (outcome, raw))
    pairs = associate(estimate, reference, 0.0)
    try:
        return Measurement("ate_to_raw_m", rms(position_errors(pairs, align(pairs))))
    except Undefined:
        return Measurement("ate_to_raw_m", math.nan, reason=f"the two runs share {len(pairs)} tracked frame(s)")


def _save(run: SlamRun, accuracy: Accuracy, sequence: Sequence, context: Context) -> None:
    """Leave the run beside the record, in metres and the true frame where there is ground truth."""
    folder = context.artifacts
    after = accuracy.after or Similarity(1.0, np.eye(3), np.zeros(3))
    before = accuracy.before or after
    kept = set(run.keyframe_indices.tolist())
    keyframe_stamps_s = np.array([frame.timestamp_s for frame in run.frames if frame.index in kept])
    final = after.trajectory(run.trajectory)
    keyframes = nearest_stamps(final.timestamps_s, keyframe_stamps_s, 0.0) >= 0
    files.write_tum(folder / files.TRAJECTORY, final)
    files.write_tum(folder / files.TRAJECTORY_BEFORE_LOOPS, before.trajectory(run.trajectory_before_loops))
    files.write_tum(folder / files.KEYFRAMES, files.selected(final, keyframes))
    files.write_points(folder / files.MAP_POINTS, after.points(run.points_world))
    files.write_states(folder / files.STATES, run.frames)
    files.write_loops(folder / files.LOOPS, run.loops)
    if sequence.ground_truth is not None:
        files.write_tum(folder / files.GROUND_TRUTH, sequence.ground_truth)
