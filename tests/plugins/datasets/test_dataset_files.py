"""Datasets of image files: layouts made here with known content, then one thing at a time broken."""

from __future__ import annotations

import os
import re
from dataclasses import replace

import cv2
import numpy as np
import pytest
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.contracts.image import gray_from_image
from codecbench.core.contracts.sequence import Camera
from codecbench.plugins.datasets.calibration import FREIBURG, camera_from_file
from codecbench.plugins.datasets.euroc import Euroc
from codecbench.plugins.datasets.files import read_image_file
from codecbench.plugins.datasets.folder import Folder, natural_key
from codecbench.plugins.datasets.kitti import Kitti
from codecbench.plugins.datasets.synthetic.dataset import Synthetic
from codecbench.plugins.datasets.tum import Tum

CALIBRATION = (
    "model: pinhole\nwidth: 32\nheight: 24\nfps: 25\nfx: 30.5\nfy: 31\ncx: 15.5\ncy: 11.5\nk1: 0.1\np2: -1e-3\n"
)

LAYOUTS = {"tum": (Tum, {}), "kitti": (Kitti, {"sequence": "07"}), "euroc": (Euroc, {}), "folder": (Folder, {})}


def picture(number, shape=(24, 32, 3)):
    return np.random.default_rng(number).integers(0, 256, shape, dtype=np.uint8)


def write_picture(file, image):
    file.parent.mkdir(parents=True, exist_ok=True)
    stored = image if image.ndim == 2 else np.ascontiguousarray(image[:, :, ::-1])
    assert cv2.imwrite(str(file), stored)


def random_poses(count, seed=1):
    rng = np.random.default_rng(seed)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = Rotation.random(count, rng=rng).as_matrix()
    poses[:, :3, 3] = rng.normal(size=(count, 3))
    return poses


def rewrite(file, before, after):
    text = file.read_text()
    assert before in text
    file.write_text(text.replace(before, after, 1))


def message(dataset, **values):
    with pytest.raises(DatasetError) as caught:
        dataset.create(**values).open()
    return str(caught.value)


def quoted(text):
    """What a message names as it is typed: options, parameters and their values."""
    return re.findall(r"`([^`]+)`", text)


# TUM


@pytest.fixture
def tum(tmp_path):
    """Five frames; ground truth at other times, and more of them."""
    folder = tmp_path / "my_sequence"
    lines = ["# color images", "# timestamp filename"]
    for number in range(5):
        write_picture(folder / "rgb" / f"{number}.png", picture(number))
        lines.append(f"{100 + number * 0.04:.6f} rgb/{number}.png")
    (folder / "rgb.txt").write_text("\n".join(lines) + "\n")
    poses = random_poses(8)
    rows = ["# ground truth"]
    for number, pose in enumerate(poses):
        quaternion = Rotation.from_matrix(pose[:3, :3]).as_quat()
        rows.append(" ".join(f"{value:.12f}" for value in (99.9 + number * 0.05, *pose[:3, 3], *quaternion)))
    (folder / "groundtruth.txt").write_text("\n".join(rows) + "\n")
    (folder / "calib.yaml").write_text(CALIBRATION)
    return folder


def test_tum_gives_frames_times_camera_and_the_whole_true_path(tum):
    sequence = Tum.create(path=tum, start=1, stop=5, stride=2).open()
    assert sequence.name == "my_sequence"
    assert len(sequence) == 2
    np.testing.assert_allclose(sequence.timestamps_s, [100.04, 100.12])
    assert sequence.frame_rate_hz == 12.5
    frame = sequence.read(1)
    assert (frame.index, frame.timestamp_s) == (1, 100.12)
    np.testing.assert_array_equal(frame.image, picture(3))
    assert sequence.camera == camera_from_file(tum / "calib.yaml")[0]
    assert sequence.camera.distortion == (0.1, 0, 0, -1e-3, 0)
    assert len(sequence.ground_truth) == 8
    np.testing.assert_allclose(sequence.ground_truth.world_from_camera, random_poses(8), atol=1e-10)
    np.testing.assert_allclose(sequence.ground_truth.timestamps_s, 99.9 + np.arange(8) * 0.05)
    assert [frame.index for frame in sequence] == [0, 1]


def test_tum_finds_its_camera(tum, tmp_path):
    (tum / "calib.yaml").rename(tmp_path / "other.yaml")
    assert quoted(message(Tum, path=tum)) == ["camera", "calibration", "fov_deg", "camera: none"]
    assert Tum.create(path=tum, calibration=tmp_path / "other.yaml").open().camera.fx == 30.5
    assert Tum.create(path=tum, camera="none").open().camera is None
    assert re.search(r"0\.png: .*32x24.* 640x480", message(Tum, path=tum, camera="freiburg1"))
    named = tum.rename(tmp_path / "rgbd_dataset_freiburg2_desk")
    for number in range(5):
        write_picture(named / "rgb" / f"{number}.png", picture(number, (480, 640, 3)))
    assert Tum.create(path=named).open().camera == FREIBURG["freiburg2"]
    with pytest.raises(ValidationError, match="not both"):
        Tum.create(path=named, camera="freiburg1", calibration=tmp_path / "other.yaml")


def test_tum_takes_a_field_of_view_where_there_is_no_calibration(tum):
    known = Tum.create(path=tum, fov_deg=90).open()
    assert known.camera == Tum.create(path=tum).open().camera
    assert re.match(r"`fov_deg`, 90 degrees, .* calib\.yaml$", known.notes[-1])
    assert Tum.create(path=tum, fov_deg=90, camera="none").open().camera.fx == pytest.approx(16)
    (tum / "calib.yaml").unlink()
    ideal = Tum.create(path=tum, fov_deg=90).open()
    assert (ideal.camera.fx, ideal.camera.width, ideal.camera.cx) == (pytest.approx(16), 32, 15.5)
    assert "ideal one of 90 " in ideal.notes[-1]
    with pytest.raises(ValidationError, match="`camera` or `fov_deg`"):
        Tum.create(path=tum, fov_deg=90, camera="freiburg1")


def test_tum_without_ground_truth_says_so(tum):
    (tum / "groundtruth.txt").unlink()
    assert re.search(r"groundtruth\.txt: .* missing", message(Tum, path=tum))
    assert cost(Tum, path=tum) == {"ground_truth": False}
    assert Tum.create(path=tum, ground_truth=False).open().ground_truth is None


@pytest.mark.parametrize("values", [{}, {"path": "x", "fetched": "y"}])
def test_one_place_must_be_given(values):
    with pytest.raises(ValidationError, match="`path` or `fetched`"):
        Tum.create(**values)


@pytest.mark.parametrize(
    ("values", "pattern"),
    [
        ({"stop": 6}, "stop is 6, .* 5 "),
        ({"start": 5}, r"rgb\.txt: start is 5, .*\(5\)"),
        ({"start": 3, "stop": 2}, r"start is 3, .* stop \(2\)"),
        ({"skip": [5]}, "skip has 5, .* 5 frames"),
        ({"start": 1, "stop": 3, "skip": [1, 2]}, "skip .* 1 to 2$"),
        ({"path": "nowhere"}, r"^nowhere: .*`path` .* rgb\.txt$"),
    ],
)
def test_selections_that_are_not_there(tum, values, pattern):
    assert re.search(pattern, message(Tum, **{"path": tum, **values}))


def test_skipped_frames_are_left_out_and_the_others_keep_their_times(tum):
    sequence = Tum.create(path=tum, start=1, stop=5, skip=[2, 0]).open()
    np.testing.assert_allclose(sequence.timestamps_s, [100.04, 100.12, 100.16])
    np.testing.assert_array_equal(sequence.read(1).image, picture(3))
    assert sequence.frame_rate_hz == 25.0
    (note,) = sequence.notes
    assert (re.findall(r"\d+", note), quoted(note)) == (["3", "5", "1", "4", "2"], ["skip"])
    assert sequence.fingerprint != Tum.create(path=tum, start=1).open().fingerprint
    assert Tum.create(path=tum, skip=[0]).open().fingerprint == Tum.create(path=tum, start=1).open().fingerprint
    with pytest.raises(ValidationError, match=r"skip\.0\n.* equal to 0 "):
        Tum.create(path=tum, skip=[-1])


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_damaged_picture_costs_itself(layout, request):
    """The error says how to leave it out, counted in the recording; so does that of a first one."""
    path = request.getfixturevalue("tum" if layout == "folder" else layout)
    path = path / "rgb" if layout == "folder" else path
    dataset, more = LAYOUTS[layout]
    sequence = dataset.create(path=path, start=1, **more).open()
    file = sequence._content.files[1]
    whole = file.read_bytes()
    for content in (bytes(len(whole)), whole[:-20], b""):
        file.write_bytes(content)
        with pytest.raises(DatasetError) as caught:
            sequence.read(1)
        assert caught.value.without == {"skip": [2]}
        assert caught.value.what.startswith(f"{file}: ")
        assert f"({len(content)} bytes)" in caught.value.what
        assert (quoted(caught.value.what), quoted(str(caught.value))) == ([], ["skip: [2]"])
        with pytest.raises(DatasetError) as caught:
            dataset.create(path=path, start=2, fov_deg=90, **more).open()
        assert caught.value.without == {"skip": [2]}
    rest = dataset.create(path=path, start=1, skip=[2], **more).open()
    np.testing.assert_array_equal(rest.read(1).image, sequence.read(2).image)
    assert rest.timestamps_s.tolist() == sequence.timestamps_s[[0, *range(2, len(sequence))]].tolist()


def cost(dataset, **values):
    """The parameters that an error says open the rest, with which it is opened."""
    with pytest.raises(DatasetError) as caught:
        dataset.create(**values).open()
    dataset.create(**values, **caught.value.without).open()
    return caught.value.without


def test_pictures_that_are_missing_cost_themselves_unless_they_are_most(tum):
    for number in (1, 3):
        (tum / "rgb" / f"{number}.png").unlink()
    assert cost(Tum, path=tum) == {"skip": [1, 3]}
    assert quoted(message(Tum, path=tum)) == ["skip: [1, 3]"]
    (tum / "rgb" / "0.png").unlink()
    said = message(Tum, path=tum)
    assert re.search(r"0\.png: .*2 more of 5", said)
    assert quoted(said) == []


def test_a_calibration_and_a_true_path_cost_themselves(tum, kitti, euroc, tmp_path):
    (tmp_path / "own.yaml").write_text("width: [")
    with pytest.raises(DatasetError) as caught:
        Tum.create(path=tum, calibration=tmp_path / "own.yaml").open()
    assert caught.value.without == {}  # it was asked for
    rewrite(tum / "calib.yaml", "width: 32", "width: [")
    assert quoted(message(Tum, path=tum)) == ["camera: none"]
    assert cost(Tum, path=tum, fov_deg=90) == {"camera": "none"}
    rewrite(tum / "groundtruth.txt", "99.95", "x")
    assert cost(Tum, path=tum, camera="none") == {"ground_truth": False}
    rewrite(kitti / "sequences/07/calib.txt", "P0: 30", "P0:")
    drive = {"path": kitti, "sequence": "07"}
    assert cost(Kitti, **drive) == {"calibration": "none"}
    street = Kitti.create(**drive, calibration="none").open()
    assert (street.camera, len(street.ground_truth)) == (None, 4)
    assert "camera 0" in street.notes[-1]
    assert Kitti.create(**drive, calibration="none", fov_deg=90).open().camera.fx == pytest.approx(16)
    rewrite(kitti / "poses/07.txt", "\n", "\n1 2 3\n")
    assert cost(Kitti, **drive, calibration="none") == {"ground_truth": False}
    rewrite(euroc / "mav0/cam0/sensor.yaml", "  data: [", "  data: [9, ")
    assert cost(Euroc, path=euroc) == {"ground_truth": False}  # T_BS, which only moves the poses
    rewrite(euroc / "mav0/cam0/sensor.yaml", "30.5", "-30.5")
    assert cost(Euroc, path=euroc) == {"calibration": "none"}


@pytest.mark.parametrize("layout", ["tum", "kitti", "fisheye", "synthetic"])
@pytest.mark.parametrize("scale", [1.0, 2.0])
def test_a_miscalibrated_camera_sees_the_same_and_says_another_lens(layout, scale, request, tmp_path):
    if layout == "synthetic":
        dataset, given = Synthetic, {"world": "room", "width": 32, "height": 24, "frames": 3}
    else:
        path = request.getfixturevalue("kitti" if layout == "kitti" else "tum")
        dataset, given = (Kitti, {"sequence": "07"}) if layout == "kitti" else (Tum, {})
        given["path"] = path
        if layout == "fisheye":
            given["calibration"] = tmp_path / "lens.yaml"
            given["calibration"].write_text(CALIBRATION.replace("pinhole", "equidistant").replace("p2", "k2"))
    true, same, told, less = (
        dataset.create(**given, scale=scale, **error).open()
        for error in ({}, {"calibration_error": 0.0}, {"calibration_error": 0.02}, {"calibration_error": -0.02})
    )
    assert (same.fingerprint, same.name, same.as_calibrated) == (true.fingerprint, true.name, "")
    assert len({true.fingerprint, told.fingerprint, less.fingerprint}) == 3
    assert (told.name, less.name) == (f"{true.name}-k1+0.02", f"{true.name}-k1-0.02")
    assert told.as_calibrated == less.as_calibrated == true.fingerprint
    camera = true.camera
    distortion = (camera.distortion[0] + 0.02, *camera.distortion[1:])
    assert told.camera == replace(camera, fx=1.01 * camera.fx, fy=1.01 * camera.fy, distortion=distortion)
    assert told.notes[:-1] == true.notes
    assert re.findall(r"[+-][\d.]+", told.notes[-1]) == ["+0.02", "+1"]
    assert re.findall(r"[+-][\d.]+", less.notes[-1]) == ["-0.02", "-1"]
    assert [frame.timestamp_s for frame in told] == [frame.timestamp_s for frame in true]
    for frame, wanted in zip(told, true, strict=True):
        np.testing.assert_array_equal(frame.image, wanted.image)


def test_a_calibration_is_wrong_only_where_there_is_one(tum):
    (note,) = Tum.create(path=tum, calibration_error=0.1).open().notes
    assert re.search(r"k1 by \+0\.1, .* \+5 %$", note)
    said = message(Folder, path=tum / "rgb", calibration_error=0.01)
    assert quoted(said) == ["calibration_error", "calibration_error: 0.0"]
    with pytest.raises(ValidationError, match=r"calibration_error\n.* equal to 0\.1 "):
        Tum.create(path=tum, calibration_error=0.2)


def test_a_calibration_of_another_size_costs_itself(tum):
    rewrite(tum / "calib.yaml", "width: 32", "width: 64")
    assert cost(Tum, path=tum) == {"camera": "none"}


def test_frames_that_do_not_fit_are_named_when_they_are_read(tum):
    sequence = Tum.create(path=tum).open()
    write_picture(tum / "rgb" / "2.png", picture(2, (20, 32, 3)))
    with pytest.raises(DatasetError, match=r"2\.png: is 32x20, .* 32x24; set `skip: \[2\]`"):
        sequence.read(2)
    write_picture(tum / "rgb" / "2.png", picture(2, (24, 32)))
    with pytest.raises(DatasetError, match=r"2\.png: has 1 .* 3; .*`color: rgb`"):
        sequence.read(2)
    assert Tum.create(path=tum, color="rgb").open().read(2).image.shape == (24, 32, 3)
    (tum / "rgb" / "2.png").unlink()
    with pytest.raises(DatasetError, match=r"2\.png: .*No such"):
        sequence.read(2)
    with pytest.raises(DatasetError, match=r"5 is not in 0\.\.4"):
        sequence.read(5)


def test_fingerprints_follow_the_content(tum, tmp_path):
    import shutil

    plain = Tum.create(path=tum).open().fingerprint
    copy = shutil.copytree(tum, tmp_path / "elsewhere")
    assert Tum.create(path=copy).open().fingerprint == plain
    assert Tum.create(path=tum, stop=5, color="rgb").open().fingerprint == plain
    changed = [
        Tum.create(path=tum, **values).open().fingerprint
        for values in ({"start": 1}, {"stride": 2}, {"color": "gray"}, {"camera": "none"}, {"ground_truth": False})
    ]
    rewrite(tum / "groundtruth.txt", "99.950000000000 ", "99.951 ")
    changed.append(Tum.create(path=tum).open().fingerprint)
    rewrite(tum / "calib.yaml", "cx: 15.5", "cx: 15.6")
    changed.append(Tum.create(path=tum).open().fingerprint)
    content = bytearray((tum / "rgb" / "3.png").read_bytes())
    write_picture(tum / "rgb" / "3.png", picture(99))
    changed.append(Tum.create(path=tum).open().fingerprint)
    (tum / "rgb" / "3.png").write_bytes(content)
    os.utime(tum / "rgb" / "3.png", ns=(1, 1))
    assert Tum.create(path=tum).open().fingerprint == changed[-2]
    assert len({plain, *changed}) == 9


# Image files


@pytest.mark.parametrize("extension", ["png", "jpg", "bmp", "tif", "webp"])
def test_a_file_that_is_cut_short_is_no_image(tmp_path, extension):
    file = tmp_path / f"a.{extension}"
    write_picture(file, picture(1, (64, 80, 3)))
    whole = file.read_bytes()
    assert read_image_file(file).shape == (64, 80, 3)
    for share in (0.0, 0.3, 0.9):
        file.write_bytes(whole[: int(len(whole) * share)])
        with pytest.raises(DatasetError, match=rf"a\.{extension}: .*again"):
            read_image_file(file)


def test_channels_come_out_as_they_are_in_the_file(tmp_path):
    from PIL import Image as Pillow

    gray, color = picture(1, (24, 32)), picture(2)
    equal = np.repeat(gray[:, :, None], 3, axis=2)
    for name, image in (("gray", gray), ("color", color), ("equal", equal)):
        Pillow.fromarray(image).save(tmp_path / f"{name}.png")
        np.testing.assert_array_equal(read_image_file(tmp_path / f"{name}.png"), image)
    alpha = np.dstack([color, picture(3, (24, 32))])
    Pillow.fromarray(alpha, "RGBA").save(tmp_path / "alpha.png")
    np.testing.assert_array_equal(read_image_file(tmp_path / "alpha.png"), color)


# Folder


def test_folder_reads_any_images_in_natural_order(tmp_path):
    shapes = {"frame2.png": (10, 12, 3), "frame10.png": (12, 10, 3), "Frame1.PNG": (8, 8, 3)}
    for number, (name, shape) in enumerate(shapes.items()):
        write_picture(tmp_path / "pictures" / name, picture(number, shape))
    (tmp_path / "pictures" / "notes.txt").write_text("not an image")
    (tmp_path / "pictures" / ".hidden.png").write_text("not an image either")
    sequence = Folder.create(path=tmp_path / "pictures", frame_rate_hz=10).open()
    assert sequence.name == "pictures"
    assert [frame.image.shape for frame in sequence] == [(8, 8, 3), (10, 12, 3), (12, 10, 3)]
    np.testing.assert_allclose(sequence.timestamps_s, [0, 0.1, 0.2])
    assert sequence.camera is None
    assert sequence.ground_truth is None
    gray = Folder.create(path=tmp_path / "pictures", color="gray", start=1, stride=2).open()
    assert (len(gray), gray.channels, gray.frame_rate_hz) == (1, 1, 15.0)
    np.testing.assert_array_equal(gray.read(0).image, gray_from_image(picture(0, (10, 12, 3))))


def test_folder_with_a_camera_checks_sizes(tmp_path):
    write_picture(tmp_path / "f" / "1.png", picture(1))
    write_picture(tmp_path / "f" / "2.png", picture(1, (8, 8, 3)))
    (tmp_path / "c.yaml").write_text(CALIBRATION)
    sequence = Folder.create(path=tmp_path / "f", calibration=tmp_path / "c.yaml").open()
    assert sequence.camera.width == 32
    with pytest.raises(DatasetError, match=r"2\.png: .* 8x8.* 32x24"):
        sequence.read(1)


def test_folder_without_images(tmp_path):
    assert re.search(r"contains no .*\(\.png", message(Folder, path=tmp_path))
    assert "is not a folder" in message(Folder, path=tmp_path / "nowhere")
    (tmp_path / "a.png").write_text("hello")
    assert re.search(r"a\.png: .*\(5 bytes\)", message(Folder, path=tmp_path))


def test_natural_order_is_total(tmp_path):
    names = ["a1", "a01", "1a", "10", "9", "a", "b2c10", "b2c9", "A1", "²"]
    assert len({str(natural_key(tmp_path / name)) for name in names}) == len(names)
    ordered = sorted((tmp_path / name for name in names), key=natural_key)
    assert [file.name for file in ordered][:3] == ["1a", "9", "10"]


# KITTI


@pytest.fixture
def kitti(tmp_path):
    folder = tmp_path / "kitti" / "sequences" / "07"
    for number in range(4):
        write_picture(folder / "image_0" / f"{number:06d}.png", picture(number, (24, 32)))
        write_picture(folder / "image_2" / f"{number:06d}.png", picture(number))
    (folder / "times.txt").write_text("0.0\n0.1\n2.0e-1\n0.3\n")
    matrix = "{name}: 30 0 15.5 {x} 0 31 11.5 {y} 0 0 1 {z}\n"
    (folder / "calib.txt").write_text(
        matrix.format(name="P0", x=0, y=0, z=0) + matrix.format(name="P2", x=30 * 0.06, y=0.2, z=0.01) + "Tr: 1 2\n"
    )
    rows = [" ".join(f"{value:e}" for value in pose[:3].ravel()) for pose in random_poses(4)]
    (tmp_path / "kitti" / "poses").mkdir()
    (tmp_path / "kitti" / "poses" / "07.txt").write_text("\n".join(rows) + "\n")
    return tmp_path / "kitti"


def test_kitti_gray(kitti):
    sequence = Kitti.create(path=kitti, sequence="07", stride=3).open()
    assert (sequence.name, len(sequence), sequence.channels) == ("kitti_07", 2, 1)
    np.testing.assert_array_equal(sequence.read(1).image, picture(3, (24, 32)))
    assert sequence.camera.fy == 31
    assert (sequence.camera.width, sequence.camera.height) == (32, 24)
    np.testing.assert_allclose(sequence.ground_truth.world_from_camera, random_poses(4), atol=1e-6)
    assert sequence.frame_rate_hz == pytest.approx(10 / 3)
    inner = kitti.rename(kitti.parent / "dataset")
    (kitti.parent / "outer").mkdir()
    inner.rename(kitti.parent / "outer" / "dataset")
    assert Kitti.create(path=kitti.parent / "outer", sequence="07").open().camera == sequence.camera


def test_kitti_color_has_the_poses_of_its_own_camera(kitti):
    """A point projected through P2 from camera 0's frame and through K from camera 2's gives one pixel."""
    sequence = Kitti.create(path=kitti, sequence="07", camera="image_2").open()
    assert sequence.channels == 3
    projection = np.array([[30, 0, 15.5, 30 * 0.06], [0, 31, 11.5, 0.2], [0, 0, 1, 0.01]])
    point_zero = np.array([0.3, -0.2, 5.0, 1.0])
    expected = projection @ point_zero
    point_world = random_poses(4)[2] @ point_zero
    own = np.linalg.inv(sequence.ground_truth.world_from_camera[2]) @ point_world
    found = projection[:, :3] @ own[:3]
    np.testing.assert_allclose(found[:2] / found[2], expected[:2] / expected[2], atol=1e-4)


def test_kitti_takes_a_field_of_view_where_there_is_no_calibration(kitti):
    params = {"path": kitti, "sequence": "07", "fov_deg": 90}
    known = Kitti.create(**params).open()
    assert known.camera == Kitti.create(path=kitti, sequence="07").open().camera
    assert known.notes[-1].endswith("from calib.txt")
    next(kitti.rglob("calib.txt")).unlink()
    ideal = Kitti.create(**params).open()
    assert ideal.camera.fx == pytest.approx(ideal.camera.width / 2)
    assert "ideal one of 90" in ideal.notes[0]
    assert "camera 0" in ideal.notes[1]
    assert "fov_deg" in quoted(message(Kitti, path=kitti, sequence="07"))


def test_kitti_what_is_missing(kitti):
    assert "08: is not a folder" in message(Kitti, path=kitti, sequence="08")
    (kitti / "poses" / "07.txt").unlink()
    assert re.search(r"07\.txt: .* missing", message(Kitti, path=kitti, sequence="07"))
    assert cost(Kitti, path=kitti, sequence="07") == {"ground_truth": False}
    assert Kitti.create(path=kitti, sequence="07", ground_truth=False).open().ground_truth is None
    (kitti / "sequences/07/image_0/000001.png").unlink()
    (kitti / "sequences/07/image_0/000002.png").unlink()
    words = message(Kitti, path=kitti, sequence="07", ground_truth=False)
    assert re.search(r"000001\.png: .*\(and 1 more of 4\)", words)


# EuRoC

START_NS = 1403636579763555584


@pytest.fixture
def euroc(tmp_path):
    cam = tmp_path / "MH_01" / "mav0" / "cam0"
    names = [START_NS + 50_000_000 * number for number in range(4)]
    for number, name in enumerate(names):
        write_picture(cam / "data" / f"{name}.png", picture(number, (24, 32)))
    (cam / "data.csv").write_text("#timestamp [ns],filename\r\n" + "".join(f"{n},{n}.png\r\n" for n in names))
    mounting = random_poses(1, seed=5)[0]
    (cam / "sensor.yaml").write_text(
        "#Default imu sensor yaml file\nsensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n  data: "
        f"[{', '.join(f'{value:.12f}' for value in mounting.ravel())}]\nrate_hz: 20\nresolution: [32, 24]\n"
        "camera_model: pinhole\nintrinsics: [30.5, 31, 15.5, 11.5] #fu, fv, cu, cv\n"
        "distortion_model: radial-tangential\ndistortion_coefficients: [-0.28, 0.07, 0.0002, 1.76e-05]\n"
    )
    truth = cam.parent / "state_groundtruth_estimate0"
    truth.mkdir()
    rows = ["#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], v"]
    for number, pose in enumerate(random_poses(6)):
        x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
        values = ",".join(f"{value:.12f}" for value in (*pose[:3, 3], w, x, y, z, 0.1))
        rows.append(f"{START_NS + 5_000_000 * number},{values}")
    (truth / "data.csv").write_text("\n".join(rows))
    return tmp_path / "MH_01"


def test_euroc_turns_body_poses_into_camera_poses(euroc):
    sequence = Euroc.create(path=euroc, start=1).open()
    assert (sequence.name, len(sequence), sequence.channels, sequence.frame_rate_hz) == ("MH_01", 3, 1, 20.0)
    np.testing.assert_allclose(np.diff(sequence.timestamps_s), 0.05, atol=1e-6)
    assert sequence.camera.distortion == (-0.28, 0.07, 0.0002, 1.76e-05, 0.0)
    np.testing.assert_array_equal(sequence.read(0).image, picture(1, (24, 32)))
    body_from_camera = random_poses(1, seed=5)[0]
    expected = random_poses(6) @ body_from_camera
    np.testing.assert_allclose(sequence.ground_truth.world_from_camera, expected, atol=1e-9)
    np.testing.assert_allclose(sequence.ground_truth.timestamps_s[5] - START_NS / 1e9, 0.025, atol=1e-6)


def test_euroc_and_calibration_files_may_describe_a_fisheye(euroc, tmp_path):
    rewrite(euroc / "mav0/cam0/sensor.yaml", "radial-tangential", "equidistant")
    expected = Camera(32, 24, 30.5, 31.0, 15.5, 11.5, (-0.28, 0.07, 0.0002, 1.76e-05, 0.0), "equidistant")
    assert Euroc.create(path=euroc).open().camera == expected
    file = tmp_path / "calib.yaml"
    file.write_text(
        "model: equidistant\nwidth: 32\nheight: 24\nfx: 30.5\nfy: 31\ncx: 15.5\ncy: 11.5\n"
        "k1: -0.28\nk2: 0.07\nk3: 2.0e-4\nk4: 1.76e-05\n"
    )
    assert camera_from_file(file)[0] == expected
    fisheye = Euroc.create(path=euroc).open().fingerprint
    rewrite(euroc / "mav0/cam0/sensor.yaml", "equidistant", "radial-tangential")
    assert Euroc.create(path=euroc).open().fingerprint != fisheye


def test_euroc_needs_no_more_of_its_truth_than_the_poses(euroc):
    rewrite(euroc / "mav0/state_groundtruth_estimate0/data.csv", ",0.1", ",")
    assert len(Euroc.create(path=euroc).open().ground_truth) == 6


def test_euroc_takes_a_field_of_view_where_there_is_no_calibration(euroc):
    known = Euroc.create(path=euroc, fov_deg=90).open()
    assert known.camera == Euroc.create(path=euroc).open().camera
    assert known.notes[-1].endswith("from sensor.yaml")
    (euroc / "mav0" / "cam0" / "sensor.yaml").unlink()
    ideal = Euroc.create(path=euroc, fov_deg=90).open()
    assert (ideal.camera.fx, ideal.frame_rate_hz) == (pytest.approx(ideal.camera.width / 2), 20.0)
    assert "ideal one of 90" in ideal.notes[0]
    assert "the vehicle's sensor" in ideal.notes[1]
    assert len(ideal.ground_truth) == len(known.ground_truth)
    assert "fov_deg" in quoted(message(Euroc, path=euroc))


def test_euroc_what_is_missing(euroc, tmp_path):
    assert "cam1: is not" in message(Euroc, path=euroc, camera="cam1")
    (euroc / "mav0/state_groundtruth_estimate0/data.csv").unlink()
    assert re.search(r"estimate0/data\.csv: .* missing", message(Euroc, path=euroc))
    assert cost(Euroc, path=euroc) == {"ground_truth": False}
    assert Euroc.create(path=euroc, ground_truth=False).open().ground_truth is None
    (euroc / "mav0/cam0/sensor.yaml").unlink()
    assert re.search(r"sensor\.yaml: .* missing", message(Euroc, path=euroc, ground_truth=False))


# What is wrong in their files


WHOLE = ""
"""In the place of what a file holds before: all of it."""
STILL = "1 0 0 0 0 1 0 0 0 0 1 0"
NS = [START_NS + 50_000_000 * number for number in range(2)]
TRUTH = "state_groundtruth_estimate0/data.csv"
TRUTH_NS = START_NS + 5_000_000


@pytest.mark.parametrize(
    ("layout", "file", "before", "after", "pattern"),
    [
        ("tum", "rgb.txt", "100.040000", "100.0x", r"rgb.txt:4: field 1 .*'100.0x'"),
        ("tum", "rgb.txt", "100.040000", "nan", r"rgb.txt:4: .*'nan'"),
        ("tum", "rgb.txt", "100.040000", "100.000000", r"rgb.txt:4: time 100.000000 repeats"),
        ("tum", "rgb.txt", "100.040000", "99.5", r"rgb.txt:4: time 99.5 is before"),
        ("tum", "rgb.txt", " rgb/1.png", "", r"rgb.txt:4: 1 field.* has 2$"),
        ("tum", "rgb.txt", "rgb/1.png", "rgb/9.png", r"rgb/9.png: .*missing"),
        ("tum", "rgb.txt", WHOLE, "# nothing\n", r"rgb.txt: .* no rows$"),
        ("tum", "rgb.txt", WHOLE, b"\xff\xfe\x00", r"rgb.txt: .*not text, .* 0$"),
        ("tum", "rgb.txt", WHOLE, None, r"rgb.txt: .* missing$"),
        ("tum", "0.png", WHOLE, "hello", r"0.png: .*\(5 bytes\).*`skip: \[0\]`"),
        ("tum", "groundtruth.txt", "99.950000000000", "99.9", r"groundtruth.txt:3: time 99.9 repeats"),
        ("tum", "groundtruth.txt", "99.950000000000", "inf", r"groundtruth.txt:3: .*'inf'"),
        ("tum", "groundtruth.txt", "99.950000000000 ", "99.95 5 ", r"groundtruth.txt:3: 9 .* has 8"),
        (
            "tum",
            "groundtruth.txt",
            "99.95000000000",
            "99.95 0 0 0 0 0 0 0.5\n99.96",
            r"groundtruth.txt:3: .* 0.5, not 1",
        ),
        ("tum", "calib.yaml", "fx: 30.5", "fx: wide", r"calib.yaml:5: `fx` .*'wide'"),
        ("tum", "calib.yaml", "fx: 30.5\n", "", r"calib.yaml: `fx` is missing"),
        ("tum", "calib.yaml", "fx: 30.5", "fx: -1", r"calib.yaml:5: `fx` is -1,"),
        ("tum", "calib.yaml", "fps: 25", "fps: 0", r"calib.yaml:4: `fps` is 0"),
        ("tum", "calib.yaml", "pinhole", "fisheye", r"calib.yaml:1: .*'fisheye'; .*`pinhole` and `equidistant`"),
        ("tum", "calib.yaml", "model: pinhole", "note: at 5:30: x", r"calib.yaml:1: .*not YAML.* 'note: at 5:30: x'"),
        ("tum", "calib.yaml", "width: 32", "width: 64", r"0.png: is 32x24, .* 64x24"),
        ("kitti", "times.txt", "0.1", "x", r"times.txt:2: .*'x'"),
        ("kitti", "times.txt", "0.1\n", "0.1\n0.1\n", r"times.txt:3: time 0.1 repeats"),
        ("kitti", "calib.txt", "P0:", "Q0:", r"calib.txt: .* no row `P0:`"),
        ("kitti", "calib.txt", "P0: 30", "P0:", r"calib.txt:1: P0 has 11 .* 12"),
        ("kitti", "calib.txt", "P0: 30", "P0: -30", r"calib.txt:1: P0 .*rectified camera"),
        ("kitti", "07.txt", "\n", "\n1 2 3\n", r"07.txt:2: 3 .* has 12"),
        ("kitti", "07.txt", "\n", f"\n{STILL}\n", r"07.txt: 5 poses, .* 4 times"),
        ("kitti", "07.txt", WHOLE, f"{STILL}\n{STILL.replace('1', '2')}\n" * 2, r"07.txt:2: .*not a rotation"),
        ("euroc", "cam0/data.csv", f"{NS[0]},", "12.5,", r"data.csv:2: field 1 .*'12.5'.* ns$"),
        ("euroc", "cam0/data.csv", f"{NS[1]},", f"{NS[0]},", rf"data.csv:3: time {NS[0]} repeats"),
        ("euroc", "sensor.yaml", "pinhole", "omni", r"sensor.yaml:9: `camera_model` .*'omni'.*`pinhole`"),
        (
            "euroc",
            "sensor.yaml",
            "radial-tangential",
            "fov",
            r"sensor.yaml:11: `distortion_model` .*'fov'.*`radial-tangential`.*`equidistant`",
        ),
        ("euroc", "sensor.yaml", "[32, 24]", "[32]", r"sensor.yaml:8: `resolution` .*\[32\], .* 2 numbers"),
        ("euroc", "sensor.yaml", "30.5", "-30.5", r"sensor.yaml:10: `intrinsics` .*above 0"),
        ("euroc", "sensor.yaml", "  data: [", "  data: [9, ", r"`T_BS.data` is \[9"),
        ("euroc", TRUTH, f"{TRUTH_NS},", f"{TRUTH_NS},x", r"data.csv:3: .*'x"),
    ],
)
def test_what_is_wrong_in_a_file_is_named_with_its_line(layout, file, before, after, pattern, request):
    folder = request.getfixturevalue(layout)
    (path,) = folder.rglob(file)
    if after is None:
        path.unlink()
    elif before == WHOLE:
        path.write_bytes(after if isinstance(after, bytes) else after.encode())
    else:
        rewrite(path, before, after)
    dataset, more = LAYOUTS[layout]
    with pytest.raises(DatasetError, match=pattern):
        dataset.create(path=folder, **more).open()


# Real sequences


@pytest.mark.real
def test_real_sequences_open_as_they_are(data_folder):
    office = Tum.create(path=data_folder / "fr3_office_715").open()
    assert (len(office), office.channels, office.frame_rate_hz) == (715, 3, 30.0)
    assert office.camera == FREIBURG["freiburg3"]
    assert len(office.ground_truth) == 8710
    road = Tum.create(path=data_folder / "kitti00_half", stop=100, stride=3).open()
    assert (len(road), road.channels) == (34, 1)
    assert road.read(33).image.shape == (188, 620)
    stills = Folder.create(path=data_folder / "kodak").open()
    assert {frame.image.shape for frame in stills} == {(512, 768, 3), (768, 512, 3)}


@pytest.mark.real
def test_true_paths_agree_with_evo(data_folder):
    from evo.tools import file_interface

    expected = file_interface.read_tum_trajectory_file(data_folder / "fr3_office_715" / "groundtruth.txt")
    found = Tum.create(path=data_folder / "fr3_office_715").open().ground_truth
    np.testing.assert_allclose(found.timestamps_s, expected.timestamps)
    np.testing.assert_allclose(found.world_from_camera, np.array(expected.poses_se3), atol=2e-4)
