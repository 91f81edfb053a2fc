"""Bags that rosbags wrote: frames, times, cameras, and what is said where something is missing or ambiguous."""

from __future__ import annotations

import re
import shutil

import numpy as np
import pytest
from bag_files import FORMATS, START_NS, STEP_NS, BagWriter, bag_file, picture, time_ns, write_pictures
from pydantic import ValidationError

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.contracts.image import gray_from_image, png_bytes
from codecbench.core.contracts.sequence import Camera, Depth, Origin
from codecbench.plugins.datasets.bag.dataset import Bag
from codecbench.plugins.datasets.bag.recording import open_recording

KINDS = [(kind, None) for kind in FORMATS]
KINDS += [("bag", "bz2"), ("bag", "lz4"), ("db3", "messages"), ("mcap", "messages"), ("mcap", "chunks")]


def message(**values):
    with pytest.raises(DatasetError) as caught:
        Bag.create(**values).open()
    return str(caught.value)


def quoted(text):
    """What a message names as it is typed: parameters and their values."""
    return re.findall(r"`([^`]+)`", text)


def path_for(folder, kind):
    return folder / ("office.bag" if kind == "bag" else "office")


@pytest.mark.parametrize(("kind", "compressed"), KINDS)
def test_frames_times_and_camera_are_those_that_were_written(tmp_path, kind, compressed):
    path = write_pictures(path_for(tmp_path, kind), kind, compressed=compressed)
    sequence = Bag.create(path=path, start=1, stop=6, stride=2).open()
    assert (sequence.name, len(sequence), sequence.channels, sequence.frame_rate_hz) == ("office", 3, 3, 12.5)
    np.testing.assert_allclose(sequence.timestamps_s, (START_NS + np.array([1, 3, 5]) * STEP_NS) / 1e9)
    for index in (2, 0, 1):
        frame = sequence.read(index)
        np.testing.assert_array_equal(frame.image, picture(1 + 2 * index))
        assert (frame.index, frame.timestamp_s) == (index, sequence.timestamps_s[index])
    assert sequence.camera == Camera(32, 24, 30.0, 31.0, 15.5, 11.5, (0.1, -0.05, 0.001, -0.002, 0.01))
    assert sequence.ground_truth is None
    topic, said = sequence.notes[0].split(": ")
    assert topic == "/cam/image_raw"
    assert re.fullmatch(r"6 .*/Image, 32x24 rgb8", said)
    assert not any("damaged" in note for note in sequence.notes)


@pytest.mark.parametrize("kind", ["db3", "mcap"])
def test_a_single_file_of_a_ros_2_bag_is_read_without_its_folder(tmp_path, kind):
    folder = write_pictures(tmp_path / "office", kind)
    alone = tmp_path / f"alone.{kind}"
    shutil.copy(bag_file(folder, kind), alone)
    sequence = Bag.create(path=alone).open()
    assert (sequence.name, len(sequence)) == ("alone", 6)
    assert sequence.fingerprint == Bag.create(path=folder).open().fingerprint


@pytest.mark.parametrize("kind", ["db3", "mcap"])
def test_the_files_of_a_split_bag_follow_each_other(tmp_path, kind):
    folder = tmp_path / "whole"
    folder.mkdir()
    for part in range(3):
        with BagWriter(tmp_path / f"part{part}", kind) as bag:
            for number in range(2 * part, 2 * part + 2):
                bag.write("/image", bag.image(picture(number), "rgb8", time_ns(number)), time_ns(number))
        shutil.copy(bag_file(tmp_path / f"part{part}", kind), folder / f"whole_{9 + part}.{kind}")
    sequence = Bag.create(path=folder).open()
    assert [frame.image[0, 0].tolist() for frame in sequence] == [picture(n)[0, 0].tolist() for n in range(6)]


def test_fingerprint_follows_frames_selection_and_conversion(tmp_path):
    path = write_pictures(tmp_path / "a.bag", "bag")
    plain = Bag.create(path=path).open().fingerprint
    (tmp_path / "elsewhere").mkdir()
    assert Bag.create(path=shutil.copy(path, tmp_path / "elsewhere")).open().fingerprint == plain
    assert Bag.create(path=path, stop=5).open().fingerprint != plain
    assert Bag.create(path=path, color="gray").open().fingerprint != plain
    assert Bag.create(path=path, camera="none").open().fingerprint != plain
    other = write_pictures(tmp_path / "b.bag", "bag", count=5)
    assert Bag.create(path=other).open().fingerprint == Bag.create(path=path, stop=5).open().fingerprint


def test_color_is_converted_as_in_other_datasets(tmp_path):
    path = write_pictures(tmp_path / "a.bag", "bag", count=1)
    gray = Bag.create(path=path, color="gray").open()
    assert gray.channels == 1
    np.testing.assert_array_equal(gray.read(0).image, gray_from_image(picture(0)))


@pytest.mark.parametrize("kind", FORMATS)
def test_several_topics_of_pictures_are_listed_and_one_is_chosen_by_name(tmp_path, kind):
    path = path_for(tmp_path, kind)
    with BagWriter(path, kind) as bag:
        for number in range(3):
            bag.write("/left/image", bag.image(picture(number), "rgb8", time_ns(number)), time_ns(number))
        bag.write("/right/image", bag.image(picture(9, (12, 16)), "mono8", time_ns(0)), time_ns(0))
        bag.write("/left/camera_info", bag.camera_info(), time_ns(0))
        bag.write("/right/camera_info", bag.camera_info(size=(16, 12), fx=9.0), time_ns(0))
    first, *topics = message(path=path).splitlines()
    assert first.startswith(f"{path}: 2 ")
    assert quoted(first) == ["topic"]
    assert topics == [
        "  /left/image: 3 of sensor_msgs/msg/Image, 32x24 rgb8",
        "  /right/image: 1 of sensor_msgs/msg/Image, 16x12 mono8",
    ]
    said = message(path=path, topic="/middle")
    assert said.splitlines()[0].startswith(f"{path}: topic '/middle' ")
    assert re.findall(r"^  (/\S+): ", said, re.MULTILINE) == ["/left/image", "/right/image"]
    right = Bag.create(path=path, topic="/right/image").open()
    assert (right.channels, right.frame_rate_hz, right.camera.fx) == (1, 30.0, 9.0)
    np.testing.assert_array_equal(right.read(0).image, picture(9, (12, 16)))
    assert len(Bag.create(path=path, topic="/left/image").open()) == 3


def test_depth_is_taken_only_if_it_is_named_or_alone(tmp_path):
    path = path_for(tmp_path, "mcap")
    with BagWriter(path, "mcap") as bag:
        bag.write("/depth", bag.image(np.zeros((24, 32), np.float32), "32FC1", time_ns(0)), time_ns(0))
        bag.write("/depth/small", bag.compressed_image(b"x", "32FC1; compressedDepth png", time_ns(0)), time_ns(0))
        bag.write("/left", bag.image(picture(1), "rgb8", time_ns(0)), time_ns(0))
    assert Bag.create(path=path).open().origin.kind.endswith(" /left")
    listed = ["/depth", "/depth/small", "/left"]
    assert sorted(re.findall(r"^  (/\S+): ", message(path=path, topic="/x"), re.MULTILINE)) == listed
    assert Bag.create(path=path, topic="/depth").open().depth == Depth(0.001)


@pytest.mark.parametrize("kind", FORMATS)
def test_what_it_was_opened_from(tmp_path, kind):
    path = write_pictures(path_for(tmp_path, kind), kind, count=2)
    origin = Bag.create(path=path).open().origin
    topic = "/cam/image_raw"
    assert origin == Origin(f"ROS {1 if kind == 'bag' else 2} bag, topic {topic}", "camera_info")
    if kind == "mcap":
        assert Bag.create(path=bag_file(path, kind)).open().origin.kind == f"MCAP file, topic {topic}"


def test_a_bag_without_pictures_lists_what_it_has(tmp_path):
    with BagWriter(tmp_path / "a.bag", "bag") as bag:
        bag.write("/cam/camera_info", bag.camera_info(), 5)
    said = message(path=tmp_path / "a.bag")
    assert "no image topic" in said
    assert said.endswith(" /cam/camera_info (sensor_msgs/msg/CameraInfo, 1)")


@pytest.mark.parametrize("kind", FORMATS)
def test_times_of_the_recording_are_taken_where_headers_have_none(tmp_path, kind):
    path = path_for(tmp_path, kind)
    with BagWriter(path, kind) as bag:
        for number in range(3):
            bag.write("/image", bag.image(picture(number), "rgb8", 0), time_ns(number))
    sequence = Bag.create(path=path).open()
    np.testing.assert_allclose(sequence.timestamps_s, (START_NS + np.arange(3) * STEP_NS) / 1e9)
    assert any("headers have none" in note for note in sequence.notes)


def test_times_of_the_recording_can_be_asked_for(tmp_path):
    path = write_pictures(tmp_path / "a.bag", "bag", count=2)
    sequence = Bag.create(path=path, time="bag").open()
    np.testing.assert_allclose(sequence.timestamps_s, (START_NS + np.arange(2) * STEP_NS) / 1e9 + 0.005)


def test_frames_come_in_the_order_of_their_headers_each_time_once(tmp_path):
    with BagWriter(tmp_path / "a.bag", "bag") as bag:
        for place, number in enumerate((2, 0, 1, 1, 3)):
            bag.write("/image", bag.image(picture(10 * place + number), "rgb8", time_ns(number)), time_ns(place))
    sequence = Bag.create(path=tmp_path / "a.bag").open()
    for index, seed in enumerate((10, 21, 2, 43)):
        np.testing.assert_array_equal(sequence.read(index).image, picture(seed))
    notes = "\n".join(sequence.notes)
    assert re.search("^1 frames .*same time$", notes, re.MULTILINE)
    assert "sorted by time" in notes


def camera_of(tmp_path, kind="bag", topic="/cam/image_raw", **values):
    path = path_for(tmp_path, kind)
    with BagWriter(path, kind) as bag:
        bag.write(topic, bag.image(picture(0), "rgb8", time_ns(0)), time_ns(0))
        bag.write("/cam/camera_info", bag.camera_info(**values), time_ns(0))
    return Bag.create(path=path)


@pytest.mark.parametrize("kind", FORMATS)
def test_fisheye_cameras_are_read(tmp_path, kind):
    camera = camera_of(tmp_path, kind, model="equidistant", distortion=(0.01, 0.02, -0.03, 0.004)).open().camera
    assert camera == Camera(32, 24, 30.0, 31.0, 15.5, 11.5, (0.01, 0.02, -0.03, 0.004, 0.0), "equidistant")


def test_an_ideal_fisheye_is_a_fisheye(tmp_path):
    assert camera_of(tmp_path, model="equidistant", distortion=(0, 0, 0, 0)).open().camera.model == "equidistant"


def test_rational_cameras_are_read(tmp_path):
    numbers = (0.5, -0.3, 0.001, -0.002, 0.01, 0.4, -0.2, 0.03)
    camera = camera_of(tmp_path, model="rational_polynomial", distortion=numbers).open().camera
    assert (camera.distortion, camera.model) == (numbers, "pinhole")
    dataset = Bag.create(path=path_for(tmp_path, "bag"))
    (note,) = (note for note in dataset.open().notes if note.startswith("camera: /cam/camera_info, 32x24, fx 30, "))
    assert note.endswith("(k1 to k6)")


def test_a_rational_camera_whose_denominator_is_1_is_a_plain_one(tmp_path):
    numbers = (0.1, -0.05, 0.001, -0.002, 0.01)
    camera = camera_of(tmp_path, model="rational_polynomial", distortion=(*numbers, 0, 0, 0)).open().camera
    assert (camera.distortion, camera.model) == (numbers, "pinhole")


@pytest.mark.parametrize(
    ("values", "pattern"),
    [
        ({"model": "rational_polynomial", "distortion": (0.1,) * 12}, "'rational_polynomial' .* 8 numbers"),
        ({"model": "thin_prism", "distortion": (0.1,) * 12}, "'thin_prism' with 12 .* plumb_bob, "),
        ({"model": "plumb_bob", "distortion": (0.1,)}, "'plumb_bob' with 1 "),
        ({"fx": -4.0}, r"/cam/camera_info\[0\]: 32x24 .* -4\.0, 31\.0 "),
        ({"fx": float("nan")}, r"/cam/camera_info\[0\]: .*not finite"),
        ({"size": (64, 48)}, " 32x24, .* 64x48; "),
    ],
)
def test_cameras_that_cannot_be_used_say_how_to_go_on(tmp_path, values, pattern):
    dataset = camera_of(tmp_path, **values)
    with pytest.raises(DatasetError, match=f"{pattern}.*`camera: none`"):
        dataset.open()
    assert Bag.create(path=dataset.params.path, camera="none").open().camera is None


def test_a_camera_that_was_never_calibrated_is_none(tmp_path):
    sequence = camera_of(tmp_path, fx=0.0).open()
    assert sequence.camera is None
    assert any("is not calibrated" in note for note in sequence.notes)


def test_rectified_pictures_have_the_camera_of_the_projection(tmp_path):
    assert camera_of(tmp_path, topic="/cam/image_rect").open().camera == Camera(32, 24, 31.0, 32.0, 15.0, 11.0)


def test_a_calibration_file_takes_the_place_of_the_topic(tmp_path):
    dataset = camera_of(tmp_path)
    file = tmp_path / "c.yaml"
    file.write_text("width: 32\nheight: 24\nfx: 3\nfy: 3\ncx: 1\ncy: 1\n")
    assert Bag.create(path=dataset.params.path, calibration=file).open().camera.fx == 3.0
    with pytest.raises(ValidationError, match="not both"):
        Bag.create(path=dataset.params.path, calibration=file, camera="/cam/camera_info")
    assert Bag.create(path=dataset.params.path, camera="/cam/camera_info").open().camera.fx == 30.0
    said = message(path=dataset.params.path, camera="/x")
    assert re.search(r"'/x' .* sensor_msgs/msg/CameraInfo.*\['/cam/camera_info'\]", said)


def test_a_field_of_view_is_used_where_there_is_no_calibration(tmp_path):
    path = write_pictures(tmp_path / "bare.bag", "bag", camera=False)
    sequence = Bag.create(path=path, fov_deg=90).open()
    assert sequence.camera.fx == pytest.approx(16)
    assert "field of view" in sequence.origin.camera
    assert "ideal one of 90 " in sequence.notes[-1]
    path = write_pictures(tmp_path / "known.bag", "bag")
    sequence = Bag.create(path=path, fov_deg=90).open()
    assert sequence.camera.fx == 30.0
    assert quoted(sequence.notes[-1]) == ["fov_deg"]
    assert sequence.notes[-1].endswith("from camera_info")
    assert Bag.create(path=path, fov_deg=90, camera="none").open().camera.fx == pytest.approx(16)
    with pytest.raises(ValidationError, match=r"`camera` .*`fov_deg`"):
        Bag.create(path=path, fov_deg=90, camera="/cam/camera_info")


def test_a_folder_of_several_recordings_is_refused_with_their_names(tmp_path):
    write_pictures(tmp_path / "b.bag", "bag", count=2)
    for name in ("walk", "drive"):
        file = bag_file(write_pictures(tmp_path / name, "mcap", count=3), "mcap")
        shutil.copy(file, tmp_path)
    said = message(path=tmp_path)
    assert said.startswith(f"{tmp_path}: ")
    assert said.endswith(": b.bag, drive.mcap, walk.mcap")


def test_paths_that_are_no_bag(tmp_path):
    assert re.search(r"none\.bag: .*`path` .*\.bag, \.mcap or \.db3", message(path=tmp_path / "none.bag"))
    assert "contains no .mcap" in message(path=tmp_path)
    (tmp_path / "a.txt").write_text("x")
    assert "ends in '.txt'" in message(path=tmp_path / "a.txt")
    (tmp_path / "a_0.db3.zstd").write_text("x")
    assert quoted(message(path=tmp_path)) == ["zstd -d"]
    path = write_pictures(tmp_path / "b.bag", "bag", count=2)
    assert re.search(r"b\.bag .*: stop .*9.* 2 ", message(path=path, stop=9))
    with pytest.raises(DatasetError, match=r"not in 0\.\.1"):
        Bag.create(path=path).open().read(2)


def test_a_recording_is_indexed_once_a_process_until_it_changes(tmp_path):
    path = write_pictures(tmp_path / "b.bag", "bag", count=2)
    assert open_recording(path) is open_recording(path)
    before = open_recording(path)
    path.unlink()
    write_pictures(path, "bag", count=3)
    assert open_recording(path) is not before


def test_what_is_damaged_or_unreadable_costs_itself(tmp_path):
    with BagWriter(tmp_path / "a.bag", "bag") as bag:
        for number in (1, 0, 2):
            content = png_bytes(picture(number))
            content = content[:-30] if number == 1 else content
            bag.write("/cam/image", bag.compressed_image(content, "png", time_ns(number)), time_ns(number))
        bag.write("/cam/camera_info", bag.camera_info("fov"), time_ns(0))
    with pytest.raises(DatasetError) as caught:
        Bag.create(path=tmp_path / "a.bag").open()
    assert caught.value.without == {"camera": "none"}
    assert quoted(str(caught.value)) == ["calibration: FILE", "camera: none"]
    sequence = Bag.create(path=tmp_path / "a.bag", camera="none").open()
    with pytest.raises(DatasetError) as caught:
        sequence.read(1)
    assert caught.value.without == {"skip": [1]}  # in the order of times
    rest = Bag.create(path=tmp_path / "a.bag", camera="none", skip=[1]).open()
    np.testing.assert_array_equal(rest.read(1).image, picture(2))
    assert rest.timestamps_s.tolist() == sequence.timestamps_s[[0, 2]].tolist()
    with pytest.raises(DatasetError) as caught:
        Bag.create(path=tmp_path / "a.bag", camera="none", start=1).open()
    assert caught.value.without == {"skip": [1]}
