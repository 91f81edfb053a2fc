"""The same pixels give the same numbers with kernels for another level of x86-64 and with OpenCV's older code.

The frames are written once and read by each run: what rendering calls may depend on the processor in its last bits.
"""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from pathlib import Path

import cv2
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

import codecbench
from codecbench.core.contracts.sequence import FrameSequence
from codecbench.core.engine.plugins.registry import installed

pytestmark = [
    pytest.mark.thorough,
    pytest.mark.timeout(1800),
    pytest.mark.skipif(platform.machine() != "x86_64", reason="compares levels of x86-64"),
]

MATRIX = """
version: 1
name: processors
sequences: [{use: tum, params: {path: room}}]
codecs:
  - raw
  - {use: jpeg, params: {quality: 30}}
  - {use: multilevel, params: {profile: {grid: [static, context]}}}
  - orb_features
evaluators: [quality, features, trajectory, localization, {use: delivery, params: {link: wifi_edge}}]
run: {timeout_s: 1500}
"""
OLDER = {
    "NUMBA_CPU_NAME": "x86-64-v2",
    "NUMBA_CPU_FEATURES": "",
    "OPENCV_CPU_DISABLE": "AVX512-SKX,AVX2,FP16,FMA3,AVX",
    "OPENCV_IPP": "disabled",
}
"""A processor of before 2013, as far as kernels and OpenCV go."""

OWN = {"NUMBA_CPU_NAME": "host"}
"""All that this processor has."""


def write_tum(sequence: FrameSequence, folder: Path) -> None:
    (folder / "rgb").mkdir(parents=True)
    rows, poses = [], []
    camera, truth = sequence.camera, sequence.ground_truth
    assert camera is not None
    assert truth is not None
    for frame in sequence:
        assert frame.image.shape[2:] == (3,)
        assert cv2.imwrite(str(folder / f"rgb/{frame.index:04}.png"), frame.image[..., ::-1])
        rows.append(f"{frame.timestamp_s:.6f} rgb/{frame.index:04}.png\n")
    for time_s, pose in zip(truth.timestamps_s, truth.world_from_camera, strict=True):
        numbers = [*pose[:3, 3], *Rotation.from_matrix(pose[:3, :3]).as_quat()]
        poses.append(f"{time_s:.6f} " + " ".join(f"{number:.9f}" for number in numbers) + "\n")
    (folder / "rgb.txt").write_text("".join(rows))
    (folder / "groundtruth.txt").write_text("".join(poses))
    values = {name: getattr(camera, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
    (folder / "calib.yaml").write_text("".join(f"{name}: {value}\n" for name, value in values.items()))


def run_results(folder: Path, name: str, variables: dict[str, str]) -> tuple[pd.DataFrame, dict[str, bytes]]:
    """The tidy table of a run under these variables, and its trajectories by their files' names."""
    command = [sys.executable, "-m", "codecbench", "run", "matrix.yaml", "--out", name]
    done = subprocess.run(
        command, cwd=folder, env={**os.environ, **variables}, capture_output=True, text=True, timeout=1500
    )
    assert done.returncode == 0, done.stdout + done.stderr
    run = codecbench.open_run(folder / name)
    paths = {
        str(file.relative_to(folder / name)): file.read_bytes() for file in (folder / name).rglob("trajectory.txt")
    }
    table = run.tidy
    depends = table.metric.isin(["slam_ms_per_frame"]) | table.metric.str.startswith("opencv_")
    return table[~depends], paths


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("processors")
    write_tum(installed().create("dataset", "synthetic", {"stop": 60}).open(), folder / "room")
    (folder / "matrix.yaml").write_text(MATRIX)
    return folder


@pytest.mark.parametrize("variables", [OLDER, pytest.param(OWN, marks=pytest.mark.slow)], ids=["older", "own"])
def test_numbers_do_not_depend_on_the_processor(recorded: Path, variables: dict[str, str]) -> None:
    here, paths = run_results(recorded, "here", {})
    there, other_paths = run_results(recorded, variables["NUMBA_CPU_NAME"], variables)
    assert len(here) > 100
    assert paths
    pd.testing.assert_frame_equal(here, there, check_exact=True)
    assert paths == other_paths
