"""The `trajectory` evaluator runs SLAM on coded frames and measures the camera's path."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.errors import SlamError, Unsupported
from codecbench.core.contracts.evaluator import (
    CodedSequence,
    Context,
    Measurement,
    Outcome,
    PluginUse,
    SequenceEvaluator,
)
from codecbench.core.contracts.metric import Metric, Quantity
from codecbench.core.contracts.sequence import FrameSequence, Trajectory
from codecbench.core.contracts.slam import SlamRun
from codecbench.core.contracts.view import Drawing, View
from codecbench.core.simulation.delivery import delivery_of
from codecbench.plugins.evaluators.trajectory import files, path_drawing, pseudo_ground_truth, verdicts
from codecbench.plugins.evaluators.trajectory.accuracy import (
    Accuracy,
    fresh_fraction,
    live_errors,
    live_positions,
    newest_poses,
)
from codecbench.plugins.evaluators.trajectory.alignment import (
    Similarity,
    Undefined,
    align,
    associate,
    nearest_stamps,
)
from codecbench.plugins.evaluators.trajectory.errors import position_errors, rms
from codecbench.plugins.evaluators.trajectory.feed import Feed, architecture_of
from codecbench.plugins.evaluators.trajectory.metrics import ACCURACY, BEHAVIOUR, COMPARED, HELD, LIVE
from codecbench.plugins.evaluators.trajectory.params import TrajectoryParams


class TrajectoryEvaluator(SequenceEvaluator[TrajectoryParams]):
    """Accuracy and behaviour of monocular SLAM. A run that gets lost is a result too; see docs/metrics.md."""

    name = "trajectory"
    version = "4"
    params_type = TrajectoryParams
    metrics: ClassVar[tuple[Metric, ...]] = (*ACCURACY, *LIVE, *BEHAVIOUR, *COMPARED)
    views = (
        View("curve", "Rate and trajectory error", ("ate_rmse_m",)),
        View("curve", "Rate and distance from raw's path", ("raw_path_error_percent",)),
        View("curve", "Rate and tracked share", ("tracked_fraction",)),
        View("map", "Trajectories", note=path_drawing.NOTE),
    )
    needs = frozenset({"camera"})
    typical_ms_per_frame = 30.0

    @property
    def repeats(self) -> int:
        return len(self.params.start_offsets) * len(self.params.seeds)

    @property
    def uses(self) -> tuple[PluginUse, ...]:
        return (PluginUse("slam_backend", self.params.backend, self.params.backend_params), *self.params.link_uses)

    @property
    def requires(self) -> dict[str, Quantity]:
        return self.params.requires

    def repeat_identity(self, repeat: int) -> dict[str, Any]:
        offset, seed = self.params.repeat(repeat)
        excluded = {"start_offsets", "seeds", *verdicts.THRESHOLDS}
        shared = {name: value for name, value in self.params.identity().items() if name not in excluded}
        return {**shared, "start_offset": offset, "seed": seed}

    def evaluate(self, coded: CodedSequence, context: Context) -> Iterator[Measurement]:
        offset, seed = self.params.repeat(context.repeat)
        backend = context.plugins.create("slam_backend", self.params.backend, self.params.backend_params)
        architecture = architecture_of(coded.codec, self.params.architecture)
        if architecture not in backend.architectures:
            raise Unsupported(
                f"slam backend {self.params.backend} cannot run architecture {architecture}; "
                f"it runs {', '.join(sorted(backend.architectures))}"
            )
        params = self.params.with_measured_times(context.inputs)
        delivery = None if params.link is None else delivery_of(coded, params, context)
        feed = Feed(coded, architecture, offset, delivery, params.read_s)
        camera = coded.sequence.camera
        if camera is None:
            raise Unsupported(f"sequence {coded.sequence.name} has no camera; SLAM needs its calibration")
        run = feed.run(backend, camera, seed) if len(feed) else _EMPTY_RUN
        _check_run(run, feed.seen, self.params.backend)
        stamps_s = feed.stamps_s
        accuracy = Accuracy(run, coded.sequence, stamps_s, params.association_s, params.rpe_interval_s)
        yield from accuracy.measurements()
        yield from _behaviour_measurements(run, stamps_s)
        size_bytes = feed.sent_size_bytes()
        yield Measurement("sent_size_bytes", float(size_bytes))
        yield Measurement("sent_rate_kbps", 8e-3 * size_bytes * coded.sequence.frame_rate_hz / len(stamps_s))
        if delivery is not None:
            newest = newest_poses(run, feed.read_at, delivery.captured_s[offset:])
            yield Measurement("fresh_pose_fraction", fresh_fraction(run, newest, stamps_s))
            positions = live_positions(run, accuracy.before or accuracy.after, newest)
            yield from _live_measurements(positions, feed, coded.sequence.ground_truth, params.association_s)
            files.write_live(context.artifacts / files.LIVE, delivery, feed.read_at, positions, offset)
        _write_files(run, accuracy, coded.sequence, context)

    def compare(self, outcome: Outcome, baseline: list[Outcome]) -> Iterator[Measurement]:
        """Compare with the raw codec's runs, except over a link, where raw frames are no upper bound."""
        over_link = self.params.link is not None
        baseline = [] if over_link else baseline
        yield verdicts.success(outcome, baseline, self.params)
        if verdicts.raw_makes_no_map(baseline):
            yield from (Measurement(metric, math.nan, reason=verdicts.NO_MAP) for metric in HELD)
        same = next((raw for raw in baseline if raw.repeat == outcome.repeat), None)
        if same is None:
            reason = f"the raw codec has no finished repeat {outcome.repeat} on this sequence"
            reason = "runs over a link are not compared with the raw codec" if over_link else reason
            for metric in ("starts_in_time", pseudo_ground_truth.METRIC, "ate_to_raw_m", "ate_minus_raw_m"):
                yield Measurement(metric, math.nan, reason=reason)
            return
        yield pseudo_ground_truth.raw_path_error(outcome, baseline)
        yield verdicts.starts_in_time(outcome, same, self.params)
        yield _distance_to_raw(outcome, same)
        difference = outcome.value("ate_rmse_m") - same.value("ate_rmse_m")
        missing = "one of the two runs has no ATE" if math.isnan(difference) else None
        yield Measurement("ate_minus_raw_m", difference, reason=missing)

    def drawing(self, outcome: Outcome) -> Drawing | None:
        return path_drawing.draw(outcome)


def _check_run(run: SlamRun, frames: int, backend: str) -> None:
    """Raise SlamError if a backend's run cannot be of these frames."""
    if not isinstance(run, SlamRun):
        raise SlamError(f"slam backend {backend} returned {type(run).__name__}, not a SlamRun")
    if len(run.frames) != frames:
        raise SlamError(f"slam backend {backend} returned {len(run.frames)} states for {frames} frames")
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


_NO_POSES = Trajectory(np.zeros(0), np.zeros((0, 4, 4)))
_EMPTY_RUN = SlamRun((), _NO_POSES, _NO_POSES, np.zeros(0, np.int64), np.zeros((0, 3)), (), 0)
"""The run for a sequence of no frames."""


def _live_measurements(
    positions: NDArray[np.float64], feed: Feed, truth: Trajectory | None, tolerance_s: float
) -> Iterator[Measurement]:
    """Metrics of the newest known position at each capture. positions: (M, 3), NaN if none is known."""
    stamps_s = feed.stamps_s
    yield Measurement("delivered_fraction", feed.seen / len(stamps_s))
    known_s = stamps_s[~np.isnan(positions[:, 0])]
    first_s = known_s[0] - stamps_s[0] if len(known_s) else None
    yield _or_missing("first_pose_s", first_s, "SLAM gave no pose")
    reason = "the sequence has no ground truth" if truth is None else "no frame has ground truth"
    errors_m = np.full(1, np.nan) if truth is None else live_errors(positions, stamps_s, truth, tolerance_s)
    is_known = ~np.isnan(errors_m)
    known = errors_m[is_known]
    yield _or_missing("live_position_error_m", rms(known) if len(known) else None, reason)
    nothing = np.full((len(known), 3), np.nan)
    idle_m = (
        rms(live_errors(nothing, stamps_s[is_known], truth, tolerance_s)) if truth is not None and len(known) else None
    )
    yield _or_missing("idle_error_m", idle_m, reason)
    yield _or_missing("live_error_max_m", known.max() if len(known) else None, reason)


def _behaviour_measurements(run: SlamRun, all_stamps_s: NDArray[np.float64]) -> Iterator[Measurement]:
    """Metrics of tracking, without ground truth. all_stamps_s: of all frames, whether SLAM saw them or not."""
    stamps_s = run.trajectory.timestamps_s
    states = [frame.state for frame in run.frames]
    lost = sum(before == "tracked" and now != "tracked" for before, now in pairwise(states))
    yield Measurement("tracked_fraction", len(stamps_s) / len(all_stamps_s))
    yield from _measurements_since_map(run, all_stamps_s)
    tracked = (frame.index for frame in run.frames if len(stamps_s) and frame.timestamp_s >= stamps_s[0] - 1e-6)
    yield _or_missing("first_tracked_frame", next(tracked, None), "no frame was tracked")
    yield Measurement("times_lost", float(lost))
    yield Measurement("maps", float(run.maps))
    yield Measurement("keyframes", float(len(run.keyframe_indices)))
    points = None if len(stamps_s) and not len(run.points_world) else len(run.points_world)
    yield _or_missing("map_points", points, "the backend reports no map points")
    closed = [loop.frame for loop in run.loops if not loop.merged_maps]
    yield Measurement("maps_merged", float(len(run.loops) - len(closed)))
    yield Measurement("loops_closed", float(len(closed)))
    yield _or_missing("loop_frame", min(closed, default=None), "no loop was closed")
    inliers = [frame.inliers for frame in run.frames if frame.state == "tracked"]
    yield _or_missing("mean_inliers", np.mean(inliers) if inliers else None, "no frame was tracked")
    elapsed = [frame.elapsed_ms for frame in run.frames if math.isfinite(frame.elapsed_ms)]
    yield _or_missing("slam_ms_per_frame", np.mean(elapsed) if elapsed else None, "the backend reports no times")


def _measurements_since_map(run: SlamRun, all_stamps_s: NDArray[np.float64]) -> Iterator[Measurement]:
    """How long the first map took, whichever map is final, and the share of later frames that have a pose."""
    first_s = next((frame.timestamp_s for frame in run.frames if frame.state == "tracked"), math.inf)
    before = np.count_nonzero(all_stamps_s < first_s - 1e-6)
    yield Measurement("initialisation_frames", float(before))
    if before == len(all_stamps_s):
        yield Measurement("tracked_since_map_fraction", math.nan, reason="SLAM made no map")
        return
    tracked = np.count_nonzero(run.trajectory.timestamps_s >= first_s - 1e-6)
    yield Measurement("tracked_since_map_fraction", tracked / (len(all_stamps_s) - before))


def _or_missing(metric: str, value: float | np.floating | None, reason: str) -> Measurement:
    return Measurement(metric, math.nan, reason=reason) if value is None else Measurement(metric, float(value))


def _distance_to_raw(outcome: Outcome, raw: Outcome) -> Measurement:
    """RMS distance of the outcome's trajectory from the raw codec's, frame by frame, after Sim(3) alignment."""
    estimate, reference = (files.read_tum(run.artifacts / files.TRAJECTORY) for run in (outcome, raw))
    pairs = associate(estimate, reference, 0.0)
    try:
        return Measurement("ate_to_raw_m", rms(position_errors(pairs, align(pairs))))
    except Undefined:
        return Measurement("ate_to_raw_m", math.nan, reason=f"the two runs share {len(pairs)} tracked frame(s)")


def _write_files(run: SlamRun, accuracy: Accuracy, sequence: FrameSequence, context: Context) -> None:
    """Write the files of a run, in metres and true coordinates if there is ground truth."""
    folder = context.artifacts
    after = accuracy.after or Similarity(1.0, np.eye(3), np.zeros(3))
    before = accuracy.before or after
    keyframe_indices = set(run.keyframe_indices.tolist())
    keyframe_stamps_s = np.array([frame.timestamp_s for frame in run.frames if frame.index in keyframe_indices])
    final = after.trajectory(run.trajectory)
    keyframes = nearest_stamps(final.timestamps_s, keyframe_stamps_s, 0.0) >= 0
    files.write_tum(folder / files.TRAJECTORY, final)
    files.write_tum(folder / files.TRAJECTORY_BEFORE_LOOPS, before.trajectory(run.trajectory_before_loops))
    files.write_tum(folder / files.KEYFRAMES, files.select(final, keyframes))
    files.write_points(folder / files.MAP_POINTS, after.points(run.points_world))
    files.write_states(folder / files.STATES, run.frames)
    files.write_loops(folder / files.LOOPS, run.loops)
    if sequence.ground_truth is not None:
        files.write_tum(folder / files.GROUND_TRUTH, sequence.ground_truth)
