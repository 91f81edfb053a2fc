"""What lies at a path: each layout made small, and told from the others."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from recordings import euroc, kitti, pictures, tum

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.engine.registry import installed
from codecbench.trial.recording import recognised
from codecbench.trial.trial import looked_at


def test_each_layout_is_told_from_the_others(tmp_path: Path) -> None:
    pictures(tmp_path / "pictures", ["1.png", "2.png", "10.png"])
    writer = cv2.VideoWriter(str(tmp_path / "drive.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (48, 32))
    for _ in range(4):
        writer.write(np.zeros((32, 48, 3), np.uint8))
    writer.release()
    paths = {
        tum(tmp_path / "tum"): ("tum", 2, True, True),
        tum(tmp_path / "bare", calibrated=False, truth=False): ("tum", 2, False, False),
        tum(tmp_path / "x_freiburg1_y", calibrated=False, truth=False): ("tum", 2, True, False),
        kitti(tmp_path / "kitti", truth=True): ("kitti", 2, True, True),
        kitti(tmp_path / "street", truth=False) / "sequences" / "07": ("kitti", 2, True, False),
        euroc(tmp_path / "euroc"): ("euroc", 2, True, False),
        tmp_path / "euroc" / "mav0": ("euroc", 2, True, False),
        tmp_path / "pictures": ("folder", 3, False, False),
        tmp_path / "drive.avi": ("video", 4, False, False),
    }
    for path, (dataset, frames, camera, truth) in paths.items():
        if "freiburg" in path.name:
            continue  # its published camera has another size than these pictures; see below
        found = recognised(installed(), path, {})
        assert (found.dataset, found.frames, found.has_camera, found.has_ground_truth) == (
            dataset, frames, camera, truth,
        ), path  # fmt: skip
        assert (found.width, found.height) == (48, 32)
    with pytest.raises(DatasetError, match="is 48x32, but the calibration is for 640x480"):
        recognised(installed(), tmp_path / "x_freiburg1_y", {})


def test_it_is_said_in_one_line(tmp_path: Path) -> None:
    pictures(tmp_path, ["1.png", "2.png"])
    said = str(recognised(installed(), tmp_path, {}))
    assert said.startswith("folder (")
    assert said.endswith("): 2 frames, 48x32, colour, no calibration, no ground truth")


@pytest.mark.parametrize("name", ["nothing", "text.txt", "one.png", "empty"])
def test_what_nobody_knows_is_said(tmp_path: Path, name: str) -> None:
    (tmp_path / "text.txt").write_text("hello")
    pictures(tmp_path, ["one.png"])
    (tmp_path / "empty").mkdir()
    with pytest.raises(DatasetError, match="no such file" if name == "nothing" else "no dataset recognises it"):
        recognised(installed(), tmp_path / name, {})


def test_a_field_of_view_makes_a_camera_and_is_told(tmp_path: Path) -> None:
    pictures(tmp_path, ["1.png", "2.png"])
    found = looked_at(tmp_path, fov_deg=90.0)
    assert found.has_camera
    assert found.params["fov_deg"] == 90.0
    assert "ideal one of 90 degrees" in found.notes[-1]


def test_the_focal_length_that_a_camera_noted_is_used(tmp_path: Path) -> None:
    """18 mm of focal length before 36 mm of film see 90 degrees."""
    from PIL import ExifTags, Image

    picture = Image.fromarray(np.zeros((32, 48, 3), np.uint8))
    exif = picture.getexif()
    exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLengthIn35mmFilm] = 18
    picture.save(tmp_path / "1.jpg", exif=exif)
    found = looked_at(tmp_path)
    assert found.params["fov_deg"] == 90.0
    assert "sees 90 degrees (EXIF)" in found.assumed[0]
    assert "ideal one of 90 degrees" in found.notes[0]


@pytest.mark.parametrize("kind", ["bag", "db3", "mcap"])
def test_bags_are_recognised_and_their_camera_with_them(tmp_path: Path, kind: str) -> None:
    pytest.importorskip("rosbags", reason="the extra codecbench[bag] is not installed")
    from bag_files import bag_file, write_pictures

    path = write_pictures(tmp_path / ("walk.bag" if kind == "bag" else "walk"), kind)
    for place in {path, bag_file(path, kind)}:
        found = recognised(installed(), place, {})
        assert (found.dataset, found.frames, found.width, found.height) == ("bag", 6, 32, 24)
        assert found.has_camera
        assert any("/cam/image_raw" in note for note in found.notes)
