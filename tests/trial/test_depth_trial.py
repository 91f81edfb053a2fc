"""Depth and other 16-bit frames in `codecbench try`: what is recognized, and what they are judged by."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from recordings import tum

from codecbench.core.contracts.errors import Unsupported
from codecbench.core.engine.planning.matrix import matrix_from
from codecbench.core.engine.planning.plan import make_plan
from codecbench.core.engine.plugins.registry import installed
from codecbench.trial.pace import Pace
from codecbench.trial.recording import Recording
from codecbench.trial.trial import open_recording
from codecbench.trial.trial_matrix import TrialMatrix, trial_matrix


@pytest.fixture(autouse=True)
def machine(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("codecbench.trial.trial_matrix.measure_pace", lambda *_: Pace(1.0, 0.0))


def write_frames(folder: Path) -> Path:
    folder.mkdir(parents=True)
    for number in range(12):
        frame = np.random.default_rng(number).integers(500, 4000, (32, 48), dtype=np.uint16)
        assert cv2.imwrite(str(folder / f"{number}.png"), frame)
    return folder


def made(recording: Recording, aim: str | None = None) -> TrialMatrix:
    matrix = trial_matrix(installed(), recording, aim=aim)  # type: ignore[arg-type]
    plan = make_plan(matrix_from(matrix.text))
    assert [cell.unsupported for cell in plan.cells if cell.unsupported] == []
    return matrix


def evaluators(matrix: TrialMatrix) -> list[str]:
    return [entry.setting.name for entry in matrix_from(matrix.text).evaluators]


def test_a_folder_that_is_called_depth_is_depth_in_millimeters(tmp_path: Path) -> None:
    recording = open_recording(write_frames(tmp_path / "depth"))
    assert ", depth in steps of 1 mm, " in str(recording)
    matrix = made(recording)
    assert (matrix.aim, evaluators(matrix)) == ("depth", ["quality", "depth", "timing"])
    assert {"rvl", "png", "lerc", "hevc"} <= {entry.setting.name for entry in matrix_from(matrix.text).codecs}
    with pytest.raises(Unsupported, match="--for tracking: this recording is depth"):
        made(recording, "tracking")


def test_other_16_bit_frames_are_intensities_without_features_or_slam(tmp_path: Path) -> None:
    recording = open_recording(write_frames(tmp_path / "thermal"), fov_deg=60.0)
    assert ", 16-bit gray, " in str(recording)
    matrix = made(recording)
    assert (matrix.aim, evaluators(matrix)) == ("speed", ["quality", "timing"])
    assert "--set depth_unit_m=METERS" in matrix.choices[0]
    for aim, reason in (("depth", "is not depth; use --for speed"), ("tracking", "8-bit"), ("quality", "8-bit")):
        with pytest.raises(Unsupported, match=reason):
            made(recording, aim)
    assert made(open_recording(tmp_path / "thermal", params={"depth_unit_m": 0.01})).aim == "depth"


def test_the_depth_of_a_tum_folder_is_its_stream(tmp_path: Path) -> None:
    folder = tum(tmp_path / "desk")
    write_frames(folder / "depth")
    (folder / "depth.txt").write_text("0.0 depth/0.png\n0.1 depth/1.png\n")
    recording = open_recording(folder / "depth")
    assert (recording.dataset, recording.depth_unit_m, recording.frames) == ("tum", 1 / 5000, 2)
    assert open_recording(folder).depth_unit_m is None
