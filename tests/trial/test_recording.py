"""Recognition of recordings: a small example of each layout."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from recordings import euroc, kitti, pictures, tum

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.engine.planning.matrix import matrix_from
from codecbench.core.engine.planning.plan import make_plan
from codecbench.core.engine.plugins.registry import installed
from codecbench.trial.recording import recognize
from codecbench.trial.trial import fit_matrix, open_recording


def test_each_layout_is_recognized(tmp_path: Path) -> None:
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
        found = recognize(installed(), path, {})
        assert (found.dataset, found.frames, found.has_camera, found.has_ground_truth) == (
            dataset, frames, camera, truth,
        ), path  # fmt: skip
        assert (found.width, found.height) == (48, 32)
    other = recognize(installed(), tmp_path / "x_freiburg1_y", {})
    assert not other.has_camera
    for fact in ("48x32", "640x480", "left out"):
        assert fact in other.assumed[0]
    with pytest.raises(DatasetError, match=r"48x32.* 640x480"):
        recognize(installed(), tmp_path / "x_freiburg1_y", {"camera": "freiburg1"})


def test_a_recording_is_described_in_one_line(tmp_path: Path) -> None:
    pictures(tmp_path, ["1.png", "2.png"])
    facts = str(recognize(installed(), tmp_path, {})).split(", ")
    assert facts[1:] == ["2 frames", "48x32", "color", "no calibration", "no ground truth"]
    found = recognize(installed(), tum(tmp_path / "walk"), {})
    *_, camera, truth = str(found).split(", ")
    assert (camera.split()[-1], truth) == ("calib.yaml", "ground truth")
    assert "1 frame, " in str(replace(found, frames=1))


def test_several_frame_sizes_are_listed(tmp_path: Path) -> None:
    pictures(tmp_path, ["1.png", "2.png"])
    pictures(tmp_path, ["3.png"], size=(48, 32))
    found = open_recording(tmp_path)
    assert "3 frames, " in str(found)
    assert " 32x48 and 48x32, " in str(found)
    with pytest.raises(DatasetError, match="differ in size"):
        open_recording(tmp_path, fov_deg=70.0)
    for number in range(4, 7):
        pictures(tmp_path, [f"{number}.png"], size=(20, 10 * number))
    assert "5 sizes from 32x48 to 60x20" in str(open_recording(tmp_path))


@pytest.mark.parametrize(
    ("name", "fact"),
    [
        ("nothing", "no such file"),
        ("text.txt", "is text"),
        ("one.png", "a single image"),
        ("blank.mp4", "an empty file"),
        ("other.bin", "another kind"),
        ("empty", "an empty folder"),
        ("texts", "such as a.txt"),
        ("above", "its folder images"),
        ("deep", "but 1 folder"),
        ("cut.mp4", "(`moov`)"),
    ],
)
def test_a_path_without_a_recording_is_described(tmp_path: Path, name: str, fact: str) -> None:
    for folder in ("empty", "texts", "deep/deeper"):
        (tmp_path / folder).mkdir(parents=True)
    for file in ("text.txt", "texts/c.txt", "texts/a.txt", "texts/b.txt"):
        (tmp_path / file).write_text("é" * 3000)
    (tmp_path / "other.bin").write_bytes(b"\0\xff\x17")
    (tmp_path / "blank.mp4").touch()
    (tmp_path / "cut.mp4").write_bytes(b"\0\0\0\x10ftypisom" + bytes(4) + b"\0\0\xff\0mdat" + bytes(90))
    pictures(tmp_path, ["one.png"])
    pictures(tmp_path / "above" / "images", ["one.png"])
    with pytest.raises(DatasetError) as caught:
        recognize(installed(), tmp_path / name, {})
    message = str(caught.value)
    assert message.startswith(f"{tmp_path / name}: ")
    assert fact in message
    assert ("(synthetic, tum" in message) == (name not in ("nothing", "cut.mp4"))


@pytest.mark.parametrize("number", [0, 4])
def test_a_damaged_picture_is_left_out_and_the_others_are_tried(tmp_path: Path, number: int) -> None:
    pictures(tmp_path, [f"{n}.png" for n in range(10)])
    (tmp_path / f"{number}.png").write_bytes(bytes(100))
    recording = open_recording(tmp_path)
    made = fit_matrix(installed(), recording, ["jpeg:10"])
    said = f"{tmp_path / str(number)}.png: not an image that OpenCV can read (100 bytes); fetch or copy it again"
    assert [*recording.assumed, *made.choices][0] == f"{said}; left out (`skip: [{number}]`)"
    assert f"skip: [{number}]}}" in made.text
    assert made.frames == 9
    assert [entry.frames for entry in make_plan(matrix_from(made.text)).sequences] == [9]


def test_many_damaged_pictures_are_counted_and_most_are_an_error(tmp_path: Path) -> None:
    pictures(tmp_path, [f"{n}.png" for n in range(10)])
    for number in range(1, 6):
        (tmp_path / f"{number}.png").write_bytes(b"x")
    made = fit_matrix(installed(), open_recording(tmp_path), ["jpeg:10"])
    assert made.choices[2].endswith("3.png: not an image that OpenCV can read (1 bytes); fetch or copy it again; "
                                    "left out (`skip: [3]`)")  # fmt: skip
    assert made.choices[3].startswith("2 more frames")
    assert "skip: [1, 2, 3, 4, 5]}" in made.text
    (tmp_path / "6.png").write_bytes(b"x")
    with pytest.raises(DatasetError, match=r"1\.png: .* 5 more of 10 "):
        fit_matrix(installed(), open_recording(tmp_path), ["jpeg:10"])
    for number in range(10):
        (tmp_path / f"{number}.png").write_bytes(b"x")
    with pytest.raises(DatasetError) as caught:
        open_recording(tmp_path)
    lines = str(caught.value).splitlines()
    assert lines[0].startswith(f"{tmp_path}: skip ")
    assert lines[1].startswith(f"{tmp_path}/0.png: ")
    assert len(lines) == 4


def test_unreadable_calibration_and_ground_truth_are_left_out(tmp_path: Path) -> None:
    walk = tum(tmp_path / "walk")
    with open(walk / "calib.yaml", "a") as stream:
        stream.write("note: taken at 5:30: sunny\n")
    (walk / "groundtruth.txt").write_text("0.0 0 0 0 0 0 0 1\n0.1 nonsense\n")
    found = open_recording(walk)
    assert (found.has_camera, found.has_ground_truth) == (False, False)
    assert found.params == {"path": str(walk), "camera": "none", "ground_truth": False}
    calibration, truth = found.assumed
    assert calibration.startswith(f"{walk}/calib.yaml:7: ")
    assert calibration.endswith("; left out (`camera: none`)")
    assert truth.startswith(f"{walk}/groundtruth.txt:2: 2 field")
    assert truth.endswith("; left out (`ground_truth: false`)")
    seen = open_recording(walk, fov_deg=90.0)
    assert (seen.has_camera, seen.has_ground_truth) == (True, False)
    with pytest.raises(DatasetError, match=r"calib\.yaml:7"):  # a camera that was asked for
        open_recording(walk, params={"calibration": str(walk / "calib.yaml")})


def test_a_field_of_view_makes_a_camera_and_a_note(tmp_path: Path) -> None:
    pictures(tmp_path, ["1.png", "2.png"])
    found = open_recording(tmp_path, fov_deg=90.0)
    assert found.has_camera
    assert found.params["fov_deg"] == 90.0
    assert "90 degrees" in found.notes[-1]


def test_the_focal_length_that_a_camera_noted_is_used(tmp_path: Path) -> None:
    """18 mm of focal length before 36 mm of film see 90 degrees."""
    from PIL import ExifTags, Image

    picture = Image.fromarray(np.zeros((32, 48, 3), np.uint8))
    exif = picture.getexif()
    exif.get_ifd(ExifTags.IFD.Exif)[ExifTags.Base.FocalLengthIn35mmFilm] = 18
    picture.save(tmp_path / "1.jpg", exif=exif)
    found = open_recording(tmp_path)
    assert found.params["fov_deg"] == 90.0
    assert "EXIF" in found.assumed[0]
    assert "90 degrees" in found.notes[0]


@pytest.mark.parametrize("kind", ["bag", "db3", "mcap"])
def test_bags_are_recognised_and_their_camera_with_them(tmp_path: Path, kind: str) -> None:
    pytest.importorskip("rosbags", reason="the extra codecbench[bag] is not installed")
    from bag_files import bag_file, write_pictures

    path = write_pictures(tmp_path / ("walk.bag" if kind == "bag" else "walk"), kind)
    for place in {path, bag_file(path, kind)}:
        found = recognize(installed(), place, {})
        assert (found.dataset, found.frames, found.width, found.height) == ("bag", 6, 32, 24)
        assert found.has_camera
        assert any("/cam/image_raw" in note for note in found.notes)
    said = str(recognize(installed(), path, {}))
    assert said.startswith(f"ROS {1 if kind == 'bag' else 2} bag, topic /cam/image_raw, 6 frames, 32x24, color, ")
    assert said.endswith("camera from camera_info, no ground truth")


@pytest.mark.parametrize("layout", ["tum", "bag"])
def test_every_recording_without_calibration_takes_a_field_of_view(tmp_path: Path, layout: str) -> None:
    if layout == "tum":
        path = tum(tmp_path / "walk", calibrated=False)
    else:
        pytest.importorskip("rosbags", reason="the extra codecbench[bag] is not installed")
        from bag_files import write_pictures

        path = write_pictures(tmp_path / "walk.bag", "bag", camera=False)
    assert not open_recording(path).has_camera
    found = open_recording(path, fov_deg=90.0)
    assert found.has_camera
    assert "field of view" in found.camera_from


def test_the_bits_of_a_12_bit_camera_are_measured_and_set(tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="the extra codecbench[bag] is not installed")
    from bag_files import BagWriter, picture, time_ns

    with BagWriter(tmp_path / "deep.bag", "bag") as bag:
        for number in range(3):  # the first is dark
            samples = picture(number, (24, 32)).astype(np.uint16) * (16 if number else 1)
            bag.write("/image", bag.image(samples, "mono16", time_ns(number)), time_ns(number))
    found = open_recording(tmp_path / "deep.bag")
    assert found.params["bits"] == 12
    assert found.assumed[0].startswith("bits=12 ")
    assert any("(`bits: 12`)" in note for note in found.notes)
    given = open_recording(tmp_path / "deep.bag", params={"bits": 16})
    assert (given.params["bits"], given.assumed) == (16, ())


def test_a_missing_parameter_is_named_as_an_option(tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="the extra codecbench[bag] is not installed")
    from bag_files import BagWriter, picture, time_ns

    with BagWriter(tmp_path / "two.bag", "bag") as bag:
        for topic in ("/left", "/right"):
            bag.write(topic, bag.image(picture(0), "rgb8", time_ns(0)), time_ns(0))
    with pytest.raises(DatasetError, match=r"init --from`: --set topic=VALUE$"):
        open_recording(tmp_path / "two.bag")
    assert open_recording(tmp_path / "two.bag", params={"topic": "/left"}).frames == 1
