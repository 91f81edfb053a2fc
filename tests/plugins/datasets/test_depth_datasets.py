"""Depth and other 16-bit pictures through the datasets: what their pixels mean, which frames, which camera."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from recordings import CALIBRATION, tum

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.contracts.image import Layout
from codecbench.core.contracts.sequence import Depth
from codecbench.plugins.datasets.folder import Folder
from codecbench.plugins.datasets.sevenscenes import SevenScenes
from codecbench.plugins.datasets.tum import Tum

ROWS, COLUMNS = 32, 48


def depth_picture(number: int) -> np.ndarray:
    picture = 500 + 7 * np.arange(ROWS * COLUMNS, dtype=np.uint16).reshape(ROWS, COLUMNS) + np.uint16(number)
    picture[::5] = 0
    return picture


def write(file: Path, picture: np.ndarray) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(file), picture)


def rgbd(folder: Path, times_s: list[float], calibration: str = CALIBRATION) -> Path:
    """A TUM folder with color at 0 and 0.1 s, and depth at other times."""
    tum(folder)
    (folder / "calib.yaml").write_text(calibration)
    for number in range(len(times_s)):
        write(folder / "depth" / f"{number}.png", depth_picture(number))
    lines = [f"{time_s} depth/{number}.png\n" for number, time_s in enumerate(times_s)]
    (folder / "depth.txt").write_text("".join(lines))
    return folder


def test_depth_frames_are_those_nearest_to_color_frames(tmp_path):
    folder = rgbd(tmp_path / "desk", [-0.03, 0.004, 0.012, 0.09, 0.14])
    depth = Tum.create(path=folder, stream="depth").open()
    assert (depth.name, depth.layout, depth.depth) == ("desk_depth", Layout(1, 16), Depth(1 / 5000))
    assert depth.timestamps_s.tolist() == [0.004, 0.09]
    assert [np.array_equal(frame.image, depth_picture(n)) for frame, n in zip(depth, (1, 3), strict=True)] == [True] * 2
    assert depth.camera == Tum.create(path=folder).open().camera
    assert "3 of 5 depth frames are left out" in depth.notes[0]
    with pytest.raises(DatasetError, match=r"depth\.txt: no depth frame is within 0\.02 s"):
        Tum.create(path=rgbd(tmp_path / "apart", [0.05]), stream="depth").open()


def test_a_calibration_file_describes_a_depth_camera_of_its_own(tmp_path):
    depth = "  width: 48\n  height: 32\n  fx: 60\n  fy: 61\n  cx: 23\n  cy: 15\n  steps_per_m: 1000\n  unknown: 65535\n"
    moved = f"{CALIBRATION}depth:\n{depth}  color_from_depth: [0.5, 0, 0, 0, 0, 0, 1]\n"
    folder = rgbd(tmp_path / "desk", [0.0, 0.1], moved)
    sequence = Tum.create(path=folder, stream="depth").open()
    assert (sequence.camera.fx, sequence.camera.cy, sequence.depth) == (60.0, 15.0, Depth(0.001, 65535))
    assert sequence.ground_truth.positions_world.tolist() == [[0.5, 0, 0], [1.5, 0, 0]]
    other = Tum.create(path=folder, stream="depth", depth_unit_m=0.01).open()
    assert other.depth == Depth(0.01, 65535)
    assert Tum.create(path=folder, stream="depth", depth_unknown=7).open().depth == Depth(0.001, 7)
    assert other.fingerprint != sequence.fingerprint
    (folder / "calib.yaml").write_text(moved.replace("unknown: 65535", "unknown: -1"))
    with pytest.raises(DatasetError, match=r"calib\.yaml:15: `unknown` is -1"):
        Tum.create(path=folder, stream="depth").open()


def test_a_folder_of_16_bits_holds_intensities_unless_a_unit_is_given(tmp_path):
    for number in range(2):
        write(tmp_path / "d" / f"{number}.png", depth_picture(number))
    thermal = Folder.create(path=tmp_path / "d").open()
    assert (thermal.layout, thermal.depth) == (Layout(1, 16), None)
    depth = Folder.create(path=tmp_path / "d", depth_unit_m=0.001).open()
    assert (depth.layout, depth.depth, depth.origin.kind) == (Layout(1, 16), Depth(0.001), "folder of depth images")
    assert depth.fingerprint != thermal.fingerprint
    with pytest.raises(DatasetError, match="leave out `color: rgb`"):
        Folder.create(path=tmp_path / "d", color="rgb").open()
    write(tmp_path / "d" / "2.png", np.zeros((ROWS, COLUMNS), np.uint8))
    with pytest.raises(DatasetError, match=r"2\.png: has samples of uint8; depth has 16 bits"):
        list(Folder.create(path=tmp_path / "d", depth_unit_m=0.001).open())
    with pytest.raises(DatasetError, match=r"2\.png: has 8 bits, the first frame 16"):
        list(Folder.create(path=tmp_path / "d").open())
    write(tmp_path / "c" / "0.png", np.zeros((ROWS, COLUMNS, 3), np.uint16))
    with pytest.raises(DatasetError, match=r"3 channel\(s\) of uint16"):
        Folder.create(path=tmp_path / "c").open()


def test_scaled_depth_invents_no_distance(tmp_path):
    write(tmp_path / "0.png", depth_picture(0))
    for scale in (0.75, 2.0):
        scaled = Folder.create(path=tmp_path, depth_unit_m=0.001, scale=scale).open()
        image = scaled.read(0).image
        assert (image.shape, image.dtype) == ((ROWS * scale, COLUMNS * scale), np.uint16)
        assert set(image.ravel().tolist()) <= set(depth_picture(0).ravel().tolist())
    assert np.array_equal(image[::2, 1::2], depth_picture(0))
    thermal = Folder.create(path=tmp_path, scale=0.5).open().read(0).image
    assert thermal[10, 10] == pytest.approx(
        cv2.resize(depth_picture(0), (24, 16), interpolation=cv2.INTER_AREA)[10, 10]
    )


def test_a_folder_of_several_kinds_is_recognized_by_its_first_file(tmp_path, monkeypatch):
    write(tmp_path / "10_depth.png", depth_picture(0))
    write(tmp_path / "9_color.png", np.zeros((ROWS, COLUMNS, 3), np.uint8))
    for listed in (sorted(tmp_path.iterdir()), sorted(tmp_path.iterdir(), reverse=True)):
        monkeypatch.setattr(Path, "iterdir", lambda path, listed=listed: iter(listed))
        assert Folder.recognise(tmp_path) == {"path": str(tmp_path)}


def test_sevenscenes_reads_a_sequence_as_published(tmp_path):
    folder = tmp_path / "chess" / "seq-01"
    for number in range(3):
        write(folder / f"frame-{number:06}.color.png", np.full((ROWS, COLUMNS, 3), number, np.uint8))
        write(folder / f"frame-{number:06}.depth.png", depth_picture(number))
        pose = np.eye(4)
        pose[0, 3] = number
        np.savetxt(folder / f"frame-{number:06}.pose.txt", pose)
    assert SevenScenes.recognise(folder) == {"path": str(folder)}
    color = SevenScenes.create(path=folder).open()
    assert (color.name, len(color), color.layout, color.camera) == ("chess_seq-01", 3, Layout(3), None)
    assert "the depth camera's" in color.notes[-1]
    depth = SevenScenes.create(path=folder, stream="depth", fov_deg=60).open()
    assert (depth.name, depth.layout, depth.depth) == ("chess_seq-01_depth", Layout(1, 16), Depth(0.001, 65535))
    assert depth.ground_truth.positions_world[:, 0].tolist() == [0, 1, 2]
    assert depth.timestamps_s.tolist() == pytest.approx([0, 1 / 30, 2 / 30])
    with pytest.raises(DatasetError, match=r"0\.depth\.png: is 48x32, but the calibration is for 640x480"):
        SevenScenes.create(path=folder, stream="depth").open()


@pytest.mark.real
def test_real_depth_opens_as_it_is(data_folder):
    depth = Tum.create(path=data_folder / "sevenscenes_400", stream="depth").open()
    assert (len(depth), depth.layout, depth.depth, depth.camera.fx) == (400, Layout(1, 16), Depth(0.001), 585.0)
    image = depth.read(0).image
    assert 800 < np.median(image[image > 0]) < 4000
