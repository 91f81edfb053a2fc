"""Trajectories for evo: its own command computes the error that the run has."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from measured_runs import cell_result
from memory_sequence import CodedInMemory, FunctionCodec, MemorySequence, Plugins, context
from synthetic_path import CAMERA, Told, helix, moved, noisy, part

from codecbench.core.analysis.table import CellResult
from codecbench.core.contracts.errors import SlamError
from codecbench.core.contracts.sequence import Trajectory
from codecbench.exporting.tum_files import write_tum
from codecbench.plugins.evaluators.trajectory import TrajectoryEvaluator

COUNT = 100


def computed(folder: Path, estimate: Trajectory, truth: Trajectory | None, **params: float) -> CellResult:
    """A cell of the trajectory evaluator on a hundred frames, ten a second, whose SLAM finds `estimate`."""
    sequence = MemorySequence([np.zeros((6, 8), np.uint8)] * COUNT, CAMERA, truth)
    evaluator = TrajectoryEvaluator.create(backend="told", **params)
    where = context(folder, 0, Plugins(told=lambda _: Told(estimate)))
    measurements = tuple(evaluator.evaluate(CodedInMemory(sequence, FunctionCodec(lambda image: image)), where))
    blank = cell_result("jpeg", 1, "trajectory", count=COUNT)
    setting = replace(blank.cell.evaluator, params=evaluator.params.model_dump())
    return replace(blank, cell=replace(blank.cell, evaluator=setting), measurements=measurements, folder=folder)


@pytest.mark.parametrize("every", [1, 4])
def test_evo_computes_the_error_of_the_run(tmp_path: Path, every: int) -> None:
    """True poses of each fourth frame belong to the three frames within the tolerance; evo would take one of these."""
    truth = helix(COUNT)
    estimate = moved(part(noisy(truth, 0.1), np.arange(10, COUNT)))
    result = computed(tmp_path, estimate, part(truth, np.arange(0, COUNT, every)), association_s=0.15)
    out = tmp_path / "a path" / "office.tum"
    *said, command = write_tum(result, out)
    error_m = next(measured.value for measured in result.measurements if measured.metric == "ate_rmse_m")
    assert f"{out}: trajectory, repeat 0, 90 poses of 100 frames" in said
    assert f" {error_m:.6f};" in said[-1]
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(command, shell=True, env={**os.environ, "PATH": path}, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    found = re.search(r"rmse\s+(\S+)", done.stdout)
    assert found, done.stdout
    assert float(found[1]) == pytest.approx(error_m, abs=1e-6)


def test_the_files_hold_what_slam_found_in_true_coordinates(tmp_path: Path) -> None:
    truth = helix(COUNT)
    list(write_tum(computed(tmp_path, moved(truth), truth), tmp_path / "x.tum"))
    written, true = (np.loadtxt(tmp_path / name) for name in ("x.tum", "x.truth.tum"))
    assert written.shape == true.shape == (COUNT, 8)
    assert np.allclose(written[:, 1:4], truth.positions_world, atol=1e-6)
    assert np.allclose(true[:, 0], truth.timestamps_s)


def test_without_truth_there_is_no_command(tmp_path: Path) -> None:
    said = list(write_tum(computed(tmp_path, helix(COUNT), None), tmp_path / "x.tum"))
    assert said[-1] == "no error for evo to compute: the sequence has no ground truth"
    assert not (tmp_path / "x.truth.tum").exists()
    with pytest.raises(SlamError, match="tracked no frame"):
        list(write_tum(computed(tmp_path, part(helix(COUNT), slice(0, 0)), None), tmp_path / "y.tum"))
