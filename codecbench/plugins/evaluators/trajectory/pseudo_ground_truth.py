"""The raw codec's paths as a substitute for the ground truth that a sequence does not have.

A monocular path has no unit, and raw's own runs differ between start offsets. So the distance from raw's path is given
as a share of that path's length, and every run, raw's own included, is compared with raw's runs from other start
offsets. The distance between raw runs is the noise floor.
"""

from __future__ import annotations

import math
from functools import lru_cache
from pathlib import Path

import numpy as np

from codecbench.core.contracts.evaluator import Measurement, Outcome
from codecbench.core.contracts.sequence import Trajectory
from codecbench.plugins.evaluators.trajectory import files
from codecbench.plugins.evaluators.trajectory.alignment import Undefined, align, associate
from codecbench.plugins.evaluators.trajectory.errors import position_errors, rms

METRIC = "raw_path_error_percent"


def has_truth(outcome: Outcome) -> bool:
    """Whether the run's sequence has a ground truth."""
    return (outcome.artifacts / files.GROUND_TRUTH).exists()


def raw_path_error(outcome: Outcome, baseline: list[Outcome]) -> Measurement:
    """The median distance of the run from raw's runs with other start offsets."""
    if has_truth(outcome):
        return Measurement(METRIC, math.nan, reason="the sequence has ground truth, which is used instead")
    others = [raw for raw in baseline if raw.repeat != outcome.repeat]
    if not others:
        return Measurement(METRIC, math.nan, reason="raw has no run from another start; set several start_offsets")
    errors = [error for raw in others if not math.isnan(error := _distance_percent(outcome, raw))]
    if not errors:
        return Measurement(METRIC, math.nan, reason="too few frames are tracked both in this run and in a raw run")
    return Measurement(METRIC, float(np.median(errors)))


def raw_disagreement_percent(baseline: list[Outcome]) -> float:
    """The median of `raw_path_error` over raw's own runs; NaN if none has a value."""
    errors = [error for raw in baseline if not math.isnan(error := raw_path_error(raw, baseline).value)]
    return float(np.median(errors)) if errors else math.nan


def _distance_percent(outcome: Outcome, raw: Outcome) -> float:
    """RMS distance of two paths over common frames, in percent of the length of raw's; NaN if these are too few."""
    pairs = associate(_path(outcome), _path(raw), 0.0)
    try:
        errors = position_errors(pairs, align(pairs))
    except Undefined:
        return math.nan
    steps = np.linalg.norm(np.diff(pairs.reference.positions_world, axis=0), axis=1)
    return 100.0 * rms(errors) / float(steps.sum())


def _path(outcome: Outcome) -> Trajectory:
    file = outcome.artifacts / files.TRAJECTORY
    return _read(file, file.stat().st_mtime_ns)


@lru_cache(maxsize=256)
def _read(file: Path, _: int) -> Trajectory:
    """Read a path once for several comparisons; the second argument, its time of writing, is part of the cache key."""
    return files.read_tum(file)
