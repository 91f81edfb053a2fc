"""Writes a trajectory of a run and its ground truth as text files in TUM's format, with the command that evo needs."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from codecbench.core.analysis.table import CellResult
from codecbench.core.contracts.errors import SlamError
from codecbench.core.contracts.sequence import Trajectory
from codecbench.core.engine.storage import atomic
from codecbench.core.engine.text import counted
from codecbench.plugins.evaluators.trajectory import files
from codecbench.plugins.evaluators.trajectory.alignment import associate

_ROUNDING_S: Final = 1e-6
"""Stamps in the files have microseconds, so a pair at the limit of the evaluator may be this much farther apart."""


def write_tum(result: CellResult, out: Path) -> Iterator[str]:
    """Write the trajectory of a cell to `out` and the ground truth beside it; yield a sentence for each, and a command.

    Poses are world_from_camera, `timestamp tx ty tz qx qy qz qw` in seconds and meters, already aligned with the ground
    truth if there is one. evo pairs the stamps of the shorter file. If that is the truth, several poses could share
    one, so the truth of each pose is written instead. Raises SlamError if no frame was tracked.
    """
    estimate = files.read_tum(result.folder / files.TRAJECTORY)
    name = f"{result.cell.evaluator.title}, repeat {result.cell.repeat}"
    if not len(estimate):
        raise SlamError(f"{name} tracked no frame, so there is no trajectory to write")
    error = next(measured for measured in result.measurements if measured.metric == "ate_rmse_m")
    truth_path = result.folder / files.GROUND_TRUTH
    if truth_path.exists():
        truth, tolerance_s = files.read_tum(truth_path), result.cell.evaluator.params["association_s"]
        if len(truth) < len(estimate):
            pairs = associate(estimate, truth, tolerance_s)
            truth = Trajectory(pairs.estimate.timestamps_s, pairs.reference.world_from_camera)
        reference = out.with_suffix(f".truth{out.suffix}")
        with atomic.open_whole(reference) as stream:
            files.write_tum(stream, truth)
        yield f"{reference}: ground truth, {counted(len(truth), 'pose')}"
    with atomic.open_whole(out) as stream:
        files.write_tum(stream, estimate)
    yield f"{out}: {name}, {counted(len(estimate), 'pose')} of {counted(result.cell.sequence.frames, 'frame')}"
    if math.isnan(error.value):
        yield f"no error for evo to compute: {error.reason}"
        return
    yield f"evo computes the ate_rmse_m of this repeat, {error.value:.6f}; tables show the median over repeats:"
    limit = f"{tolerance_s + _ROUNDING_S:.7g}"
    yield shlex.join(["evo_ape", "tum", str(reference), str(out), "--align", "--correct_scale", "--t_max_diff", limit])
