"""What viewers show of a run."""

from __future__ import annotations

import math
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from exported_run import COUNT, TIMES_NS, frames
from measured_runs import cell_result
from scipy.spatial.transform import Rotation

from codecbench.core.contracts.view import Drawing, FrameTimeline
from codecbench.core.engine.storage.store import Store
from codecbench.exporting.cells import results_of
from codecbench.exporting.coded_run import open_coded_run, time_ns


def test_a_time_is_that_of_its_shortest_decimal() -> None:
    assert time_ns(1305031102.175304) == 1305031102175304000
    assert time_ns(1 / 3) == 333333333
    assert time_ns(np.float64(0.1)) == 100000000
    for time_s in np.random.default_rng(0).uniform(0, 2e9, 1000).tolist():
        assert abs(time_ns(time_s) - Fraction(time_s) * 10**9) <= Fraction(np.spacing(time_s)) * 10**9 / 2 + 1


def test_frames_values_and_paths_are_together(run: Path, tmp_path: Path) -> None:
    """SLAM tracked frames 1 and 3; its file has microseconds."""
    (tmp_path / "trajectory.txt").write_text("1305031102.211214 1 0 0 0 0 0 1\n1305031102.275326 0 1 0 0 0 0.6 0.8\n")
    timeline = FrameTimeline(np.array([1, 3]), None, np.array([0.5, 0.25]), "m")
    slam = cell_result("raw", 1, "trajectory", count=COUNT)
    slam = replace(slam, folder=tmp_path, drawing=lambda: Drawing((), "", timeline=timeline))
    store = Store(run)
    plan = store.read_plan()
    (job,) = (job for job in plan.jobs if job.codec.name == "raw")
    with open_coded_run(store, job, (*results_of(store, plan, job), slam), slam) as coded_run:
        assert coded_run.title == f"raw on {job.sequence.name}"
        assert coded_run.times_ns == TIMES_NS
        for index, image in enumerate(frames()):
            frame = coded_run.coded.frame(index)
            assert np.array_equal(frame.original.image, image)
            assert np.array_equal(frame.decoded, image)
    assert coded_run.values["quality"]["psnr_gray_db"].tolist() == [math.inf] * COUNT
    error_m = coded_run.values["trajectory"]["error_m"]
    assert error_m.tolist() == pytest.approx([math.nan, 0.5, math.nan, 0.25, math.nan, math.nan], nan_ok=True)
    assert coded_run.paths["truth"].times_ns == TIMES_NS
    estimate = coded_run.paths["estimate"]
    assert estimate.times_ns == [TIMES_NS[1], TIMES_NS[3]]
    assert np.allclose(estimate.world_from_camera[1, :3, :3], Rotation.from_quat([0, 0, 0.6, 0.8]).as_matrix())
