"""Video files written here by OpenCV, read in every order."""

from __future__ import annotations

import re

import cv2
import numpy as np
import pytest

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.contracts.image import gray_from_image
from codecbench.plugins.datasets.video import Video

COUNT = 200


def frame(number):
    """A picture that says which one it is: two flat halves and a moving bar."""
    image = np.zeros((48, 64, 3), np.uint8)
    image[:, :, 0] = number
    image[24:, :, 2] = 255 - number
    return image


@pytest.fixture(scope="module", params=[("MJPG", "avi"), ("mp4v", "mp4")], ids=lambda one: one[1])
def video(request, tmp_path_factory):
    code, extension = request.param
    file = tmp_path_factory.mktemp("video") / f"clip.{extension}"
    writer = cv2.VideoWriter(str(file), cv2.VideoWriter_fourcc(*code), 25.0, (64, 48))
    if not writer.isOpened():
        pytest.skip(f"this OpenCV does not write {code}")
    for number in range(COUNT):
        writer.write(np.ascontiguousarray(frame(number)[:, :, ::-1]))
    writer.release()
    return file


def test_frames_in_order_with_their_times(video):
    sequence = Video.create(path=video).open()
    assert (sequence.name, len(sequence), sequence.channels, sequence.frame_rate_hz) == ("clip", COUNT, 3, 25.0)
    np.testing.assert_allclose(sequence.timestamps_s, np.arange(COUNT) / 25, atol=1e-6)
    for one in sequence:
        assert np.abs(one.image.astype(int) - frame(one.index)).mean() < 4


def test_any_order_gives_the_frames_of_the_straight_one(video):
    straight = [one.image for one in Video.create(path=video).open()]
    jumping = Video.create(path=video).open()
    for index in (199, 0, 100, 99, 170, 3, 3, 150, 20, 90, 198):
        np.testing.assert_array_equal(jumping.read(index).image, straight[index])


def test_selection_color_and_rate(video):
    sequence = Video.create(path=video, start=5, stop=100, stride=10, color="gray", frame_rate_hz=50).open()
    assert (len(sequence), sequence.channels, sequence.frame_rate_hz) == (10, 1, 5.0)
    assert sequence.timestamps_s[1] == pytest.approx(15 / 50)
    expected = gray_from_image(Video.create(path=video).open().read(25).image)
    np.testing.assert_array_equal(sequence.read(2).image, expected)


def test_fingerprint_follows_bytes_and_selection(video, tmp_path):
    plain = Video.create(path=video).open().fingerprint
    copy = tmp_path / f"other{video.suffix}"
    copy.write_bytes(video.read_bytes())
    assert Video.create(path=copy).open().fingerprint == plain
    assert Video.create(path=copy, stop=50).open().fingerprint != plain
    with open(copy, "ab") as stream:
        stream.write(b"\0" * 8)
    assert Video.create(path=copy).open().fingerprint != plain


def test_a_truncated_file_is_used_up_to_its_damage_if_stop_is_set(video, tmp_path):
    content = video.read_bytes()
    cut = tmp_path / f"cut{video.suffix}"
    cut.write_bytes(content[: len(content) // 2])
    with pytest.raises(DatasetError) as caught:
        Video.create(path=cut).open()
    if video.suffix == ".mp4":
        assert str(caught.value).startswith(f"{cut}: is cut off: it has no index (`moov`)")
        assert Video.recognise(cut) == {"path": str(cut)}
        return
    stop = caught.value.without["stop"]
    assert 80 < stop < 120
    facts = rf" {(stop - 1) / 25:.1f} s of 8\.0 s .* {stop} frames"
    assert re.search(f"{facts}; set `stop: {stop}` ", str(caught.value))
    sequence = Video.create(path=cut, stop=stop).open()
    assert any(re.search(facts, note) for note in sequence.notes)
    np.testing.assert_array_equal(sequence.read(stop - 1).image, Video.create(path=video).open().read(stop - 1).image)


def test_an_mp4_whose_index_is_at_its_beginning_is_another_matter(tmp_path):
    """Only a file without its index is said to be without, and photographs in the same container are no videos."""
    box = (16).to_bytes(4) + b"ftypisom" + bytes(4)
    for rest, said in (
        (b"\0\0\0\x08moov", "not a video"),
        (b"\0\0\0\x01moov\0\0\0\0\0\0\0\x10", "not a video"),
        (b"\0\0\0\x09moov", "is cut off"),
        (b"\0\0\0\x00mdat" + bytes(99), "is cut off"),
        (b"\0\0\0\x0cmdat" + bytes(4), "is cut off"),
    ):
        (tmp_path / "a.mp4").write_bytes(box + rest)
        with pytest.raises(DatasetError, match=said):
            Video.create(path=tmp_path / "a.mp4").open()
    (tmp_path / "a.heic").write_bytes(box.replace(b"isom", b"heic"))
    assert Video.recognise(tmp_path / "a.heic") is None


def gray_video(file, codec, pixels):
    av = pytest.importorskip("av", reason="PyAV is not installed")
    with av.open(str(file), "w") as container:
        stream = container.add_stream(codec, rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, pixels
        for number in range(6):
            samples = np.full((48, 64), 40 * number, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(samples, "gray").reformat(format=pixels)))
        container.mux(stream.encode())
    return file


@pytest.mark.parametrize("pixels", ["gray", "gray10le", "gray12le", "gray16le"])
def test_a_video_that_is_stored_gray_is_gray(tmp_path, pixels):
    file = gray_video(tmp_path / "gray.mkv", "ffv1", pixels)
    sequence = Video.create(path=file).open()
    assert (sequence.channels, sequence.origin.params) == (1, {})
    means = [frame.image.mean() for frame in sequence]  # FFmpeg rounds 16 bits upward
    np.testing.assert_allclose(means, np.arange(6) * 40, atol=1)
    assert sequence.read(0).image.shape == (48, 64)
    color = Video.create(path=file, color="rgb").open()
    assert (color.channels, color.read(0).image.shape) == (3, (48, 64, 3))


def test_a_video_without_color_in_a_format_with_it_suits_gray(tmp_path, video):
    sequence = Video.create(path=gray_video(tmp_path / "gray.mkv", "ffv1", "yuv420p")).open()
    assert (sequence.channels, sequence.origin.params) == (3, {"color": "gray"})
    assert Video.create(path=video).open().origin.params == {}


def test_files_that_are_no_video(tmp_path, video):
    with pytest.raises(DatasetError, match=r"\.mp4: .*No such"):
        Video.create(path=tmp_path / "none.mp4").open()
    (tmp_path / "text.mp4").write_text("hello")
    with pytest.raises(DatasetError, match=r"text\.mp4: .* video"):
        Video.create(path=tmp_path / "text.mp4").open()
    with pytest.raises(DatasetError, match=r" 201,.* 200 frames"):
        Video.create(path=video, stop=201).open()
    with pytest.raises(DatasetError, match=r"not in 0\.\.199"):
        Video.create(path=video).open().read(200)
    (tmp_path / "c.yaml").write_text("width: 3\nheight: 4\nfx: 1\nfy: 1\ncx: 1\ncy: 1\n")
    with pytest.raises(DatasetError, match=r" 64x48, .* 3x4"):
        Video.create(path=video, calibration=tmp_path / "c.yaml").open()
