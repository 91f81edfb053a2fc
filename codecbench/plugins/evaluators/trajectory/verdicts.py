"""Verdicts on a run in comparison with the raw codec's runs."""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from codecbench.core.contracts.evaluator import Measurement, Outcome
from codecbench.plugins.evaluators.trajectory import pseudo_ground_truth
from codecbench.plugins.evaluators.trajectory.metrics import SPREAD
from codecbench.plugins.evaluators.trajectory.params import TrajectoryParams

THRESHOLDS: Final = ("tracked_to_raw", "ate_to_raw", "ate_limit_m", "raw_agrees_percent", "delay_frames")
"""Parameters that only verdicts read, so that no run depends on them."""
_SMALL_M: Final = 0.1
"""Lengths below this are given in millimetres."""
NO_MAP: Final = "raw frames give no map here, so codecs cannot be judged"
_OUTDATED: Final = "a run of an older version has no {}; measure it again"


def raw_makes_no_map(baseline: list[Outcome]) -> bool:
    """Whether there are runs of the raw codec, but none of them tracked a frame."""
    return bool(baseline) and all(raw.value("tracked_fraction") == 0.0 for raw in baseline)


def success(outcome: Outcome, baseline: list[Outcome], params: TrajectoryParams) -> Measurement:
    """Whether enough is tracked from the first map on, and the error is within the limit.

    Both are relative to the medians of the raw codec's runs, because single runs differ by factors between start
    offsets. Without such runs all frames must be tracked. The value is missing, with the reason, if raw frames give no
    map either, if there is no error to compare with, or if the limit would pass an estimate without any information.
    """
    if reason := NO_MAP if raw_makes_no_map(baseline) else _no_reference(outcome, baseline, params):
        return _missing("success", reason)
    if outcome.value("tracked_fraction") == 0.0:
        return Measurement("success", 0.0, reason="no frame is tracked")
    tracked = outcome.value("tracked_since_map_fraction")
    raw_tracked = _median(baseline, "tracked_since_map_fraction") if baseline else 1.0
    if math.isnan(tracked) or math.isnan(raw_tracked):
        return _missing("success", _OUTDATED.format("tracked_since_map_fraction"))
    least = params.tracked_to_raw * raw_tracked
    requirement = f"tracked at least {f'{params.tracked_to_raw:g} x raw = ' if baseline else ''}{100 * least:.3g} %"
    if tracked < least:
        return Measurement("success", 0.0, reason=requirement.replace("at least", f"{100 * tracked:.3g} %, under"))
    if not pseudo_ground_truth.has_truth(outcome):
        return _success_without_truth(outcome, baseline, params, requirement)
    raw_m = _median(baseline, "ate_rmse_m")
    limit_m, spread_m = params.ate_limit_m or params.ate_to_raw * raw_m, outcome.value(SPREAD)
    if math.isnan(limit_m):
        reason = "no finished run of the raw codec has an ATE to compare with; add codec raw or set ate_limit_m"
        return _missing("success", reason)
    times = "" if params.ate_limit_m else f"{params.ate_to_raw:g} x raw = "
    if limit_m > spread_m:
        times = f"the spread of the true path (ate_limit_m is more: {_length(limit_m)}) = "
        limit_m = spread_m
    factor, unit = _unit(limit_m)
    return _judge("ATE", factor * outcome.value("ate_rmse_m"), factor * limit_m, unit, times, requirement)


def _no_reference(outcome: Outcome, baseline: list[Outcome], params: TrajectoryParams) -> str:
    """Why ground truth can judge no run from this start, whatever the codec; empty if it can, or if there is none.

    A limit above the spread of the true path would pass any estimate, because no aligned estimate has a larger error.
    """
    spread_m, limit_m = outcome.value(SPREAD), params.ate_to_raw * _median(baseline, "ate_rmse_m")
    if not pseudo_ground_truth.has_truth(outcome):
        return ""
    if math.isnan(spread_m):
        before = _OUTDATED.format(SPREAD)
        return next((str(entry.reason) for entry in outcome.measurements if entry.metric == SPREAD), before)
    if params.ate_limit_m or not limit_m > spread_m:
        return ""
    return (
        f"raw's error is too large for a reference: {params.ate_to_raw:g} x raw = {_length(limit_m)} is above "
        f"{_length(spread_m)}, the spread of the true path, which is the error of an estimate without information; "
        "set ate_limit_m below it"
    )


def _success_without_truth(
    outcome: Outcome, baseline: list[Outcome], params: TrajectoryParams, requirement: str
) -> Measurement:
    """Without ground truth: whether the path is about as near to raw's paths as these are to each other."""
    disagreement = pseudo_ground_truth.raw_disagreement_percent(baseline)
    if math.isnan(disagreement):
        return _missing("success", "no ground truth, and fewer than two raw runs to replace it; set start_offsets")
    if disagreement > params.raw_agrees_percent:
        limits = f"{disagreement:.3g} % of their length, over raw_agrees_percent = {params.raw_agrees_percent:g}"
        reason = f"no ground truth, and the paths of raw differ by {limits}"
        return _missing("success", reason)
    error = pseudo_ground_truth.raw_path_error(outcome, baseline)
    if math.isnan(error.value):
        return _missing("success", str(error.reason))
    limit, times = params.ate_to_raw * disagreement, f"{params.ate_to_raw:g} x raw's own = "
    return _judge("distance from raw's paths", error.value, limit, "% of their length", times, requirement)


def _judge(what: str, value: float, limit: float, unit: str, times: str, requirement: str) -> Measurement:
    """Whether a value is within a limit; the reason is the requirement, or how far the value is beyond the limit."""
    bound = f"{times}{limit:.3g} {unit}"
    if value <= limit:
        return Measurement("success", 1.0, reason=f"{what} at most {bound}, {requirement}")
    reason = f"{what} is unknown" if math.isnan(value) else f"{what} {value:.3g} {unit}, over {bound}"
    return Measurement("success", 0.0, reason=reason)


def starts_in_time(outcome: Outcome, same: Outcome, params: TrajectoryParams) -> Measurement:
    """Whether the first map comes at most `delay_frames` later than in the raw codec's run from the same start."""
    frames, raw_frames = (run.value("initialisation_frames") for run in (outcome, same))
    if same.value("tracked_fraction") == 0.0:
        return _missing("starts_in_time", "raw frames give no map from this start")
    if math.isnan(frames) or math.isnan(raw_frames):
        return _missing("starts_in_time", _OUTDATED.format("initialisation_frames"))
    if frames <= raw_frames + params.delay_frames:
        return Measurement("starts_in_time", 1.0)
    excess = f"{frames - raw_frames:.0f} frames later than raw's, over delay_frames = {params.delay_frames}"
    return Measurement("starts_in_time", 0.0, reason=f"the first map comes {excess}")


def _median(runs: list[Outcome], metric: str) -> float:
    """The median of a metric over the runs that have it; NaN if none has."""
    values = [value for run in runs if not math.isnan(value := run.value(metric))]
    return float(np.median(values)) if values else math.nan


def _unit(length_m: float) -> tuple[float, str]:
    return (1e3, "mm") if length_m < _SMALL_M else (1.0, "m")


def _length(length_m: float) -> str:
    factor, unit = _unit(length_m)
    return f"{factor * length_m:.3g} {unit}"


def _missing(metric: str, reason: str) -> Measurement:
    return Measurement(metric, math.nan, reason=reason)
