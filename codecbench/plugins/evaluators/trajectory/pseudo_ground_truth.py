"""The raw codec's paths in the place of a ground truth that a sequence does not have.

A monocular path has no unit, and raw's own runs differ from start to start. So the distance from raw's path is told as
a share of that path's length, and every run, raw's own too, is judged by raw's runs from other starts: what raw shows
there is the least that can be told of any codec.
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
    """The median of the run's distances from raw's runs that began at other frames."""
    if has_truth(outcome):
        return Measurement(METRIC, math.nan, reason="the sequence has ground truth, which judges better")
    others = [raw for raw in baseline if raw.repeat != outcome.repeat]
    if not others:
        return Measurement(METRIC, math.nan, reason="raw has no run from another start; give several start_offsets")
    known = [error for raw in others if not math.isnan(error := _distance_percent(outcome, raw))]
    if not known:
        return Measurement(METRIC, math.nan, reason="too few frames are tracked both here and by a run of raw")
    return Measurement(METRIC, float(np.median(known)))


def raw_disagreement_percent(baseline: list[Outcome]) -> float:
    """The median of what `raw_path_error` says of raw's own runs; NaN where it says nothing."""
    known = [error for raw in baseline if not math.isnan(error := raw_path_error(raw, baseline).value)]
    return float(np.median(known)) if known else math.nan


def _distance_percent(outcome: Outcome, raw: Outcome) -> float:
    """RMS distance of the two paths over the frames that both have, in percent of the length of raw's; NaN for few."""
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
    """Each run's path is compared with several: read once, as long as the file stays as it is."""
    return files.read_tum(file)
