"""What docs/datasets.md shows of bags works on a bag with these topics."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from bag_files import BagWriter, picture, time_ns
from project import DOCS

from codecbench.cli.plan import plan
from codecbench.plugins.datasets.bag.dataset import BagParams
from codecbench.plugins.datasets.bag.images import _LAYOUTS

PAGE = (DOCS / "datasets.md").read_text()
SECTION = PAGE.partition("## `bag`")[2].partition("## Cameras")[0]


def example(kind: str) -> str:
    (code,) = re.findall(rf"<!-- bag: {kind} -->\n```\w+\n(.*?)```", SECTION, re.DOTALL)
    return str(code)


@pytest.fixture
def drive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the page's bag, where it is worked."""
    with BagWriter(tmp_path / "drive.bag", "bag") as bag:
        for number in range(300):
            bag.write("/camera/image_raw", bag.image(picture(number), "rgb8", time_ns(number)), time_ns(number))
        pose = bag.pose([0.0, 0, 0, 0, 0, 0, 1])
        header = bag.header(time_ns(0), "world")
        bag.write("/mocap/pose", bag.make("geometry_msgs/PoseStamped", header=header, pose=pose), time_ns(0))
        bag.write("/camera/camera_info", bag.camera_info(), time_ns(0))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_matrix_is_planned(drive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (drive / "drive.yaml").write_text(example("matrix"))
    plan.main([str(drive / "drive.yaml")], standalone_mode=False)
    said = capsys.readouterr().out
    (drive_line,) = re.findall(r"^ *drive: (300 .*)$", said, re.MULTILINE)
    assert drive_line.split(", ") == ["300 frames", "color", "camera", "ground truth"]
    assert re.search(r"^    /camera/image_raw: 300 .* 32x24 ", said, re.MULTILINE)
    assert re.search(r"^    ground truth: 1 .* /mocap/pose ", said, re.MULTILINE)
    assert "coding jobs: 3" in said


@pytest.mark.usefixtures("drive")
def test_the_lines_of_python_run(capsys: pytest.CaptureFixture[str]) -> None:
    exec(example("python"), {})
    said = capsys.readouterr().out
    assert said.startswith("300 Camera(width=32, height=24, fx=30.0")
    assert "/camera/camera_info" in said


def test_every_parameter_and_encoding_is_explained() -> None:
    shared = {
        "start",
        "stop",
        "stride",
        "skip",
        "color",
        "scale",
        "calibration_error",
        "path",
        "fov_deg",
        "depth_unit_m",
        "depth_unknown",
    }
    for name in set(BagParams.model_fields) - shared:
        assert f"| `{name}` |" in SECTION, name
    for name in _LAYOUTS:
        shown = name.replace("16", "8") if name.startswith("bayer") else name
        assert re.search(rf"\b{shown}\b", SECTION), name
