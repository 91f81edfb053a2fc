"""`codecbench try` as its page shows it, and as a stranger would first meet it."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from installed_command import Done, Place
from project import DOCS
from recordings import pictures
from skimage import data

import codecbench
from codecbench.plugins.datasets.synthetic.dataset import Synthetic

pytestmark = pytest.mark.thorough


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Place:
    """A folder that holds `pictures`, twelve of them."""
    folder = tmp_path_factory.mktemp("try")
    pictures(folder / "pictures", [f"{number}.png" for number in range(12)], size=(96, 128))
    return Place(folder)


def succeeded(done: Done) -> str:
    assert done.status == 0, done.output
    return done.output


def test_the_commands_of_the_page_run(place: Place) -> None:
    page = (DOCS / "try.md").read_text()
    commands = [line for block in re.findall(r"```console\n(.*?)```", page, re.DOTALL) for line in block.splitlines()]
    assert len(commands) >= 4
    for command in commands:
        program, *words = shlex.split(command)
        assert program == "codecbench"
        succeeded(place.call(*words, timeout=600))


def test_the_program_of_the_page_runs(place: Place) -> None:
    (program,) = re.findall(r"```python\n(.*?)```", (DOCS / "try.md").read_text(), re.DOTALL)
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=place.folder, capture_output=True, text=True, timeout=600, check=True
    )
    assert [line.split()[-2] for line in done.stdout.splitlines()[2:]] == ["quality=10", "quality=40"]


def test_a_report_is_written_and_the_matrix_can_be_run_again(place: Place) -> None:
    printed = succeeded(place.call("try", "pictures", "--codec", "jpeg:10", "--for", "speed", "--out", "run"))
    assert "12 frames, 128x96" in printed
    (report,) = re.findall(r"the report: file://(.*)", printed)
    assert Path(report).stat().st_size > 10_000
    again = succeeded(place.call("run", "run/matrix.yaml", "--out", "run"))
    assert re.search(r"\d of them", again)


@pytest.mark.slow
def test_tracking_without_truth_or_calibration(tmp_path: Path) -> None:
    """The embedded room as pictures alone: raw paths agree, and distances are told in percent of their length."""
    sequence = Synthetic.create(frames=170).open()
    (tmp_path / "room").mkdir()
    for frame in sequence:
        name = tmp_path / "room" / f"{frame.index}.png"
        cv2.imwrite(str(name), np.ascontiguousarray(frame.image[:, :, ::-1]))
    run = codecbench.trial(tmp_path / "room", codecs=["jpeg:40"], fov_deg=62.7, minutes=30, out=tmp_path / "run")
    apart = dict(zip(run.wide["codec"], run.wide["trajectory.raw_path_error_percent.median"], strict=True))
    assert 0 < apart["raw"] < 2
    assert 0 < apart["jpeg"] < 4
    assert run.wide["trajectory.ate_rmse_m.median"].isna().all()


def test_photographs_of_a_library_can_be_tried(place: Place) -> None:
    """Pictures of several sizes: what needs one size does not run, and everything else does."""
    folder = place.folder / "photographs"
    folder.mkdir()
    for name in ("astronaut", "coffee", "chelsea"):
        cv2.imwrite(str(folder / f"{name}.jpg"), np.ascontiguousarray(getattr(data, name)()[::2, ::2, ::-1]))
    said = succeeded(place.call("try", "photographs", "--codec", "jpeg:20", "--codec", "webp:20", timeout=600))
    assert "decoded JPEG" in said
    assert "decoded JPEG" in succeeded(place.call("init", "--from", "photographs", "--out", "photographs.yaml"))
