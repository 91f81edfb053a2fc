"""Topics of coded video: the frames of every message and codec, in any order, and what is said of damaged ones."""

from __future__ import annotations

import gc
import multiprocessing
import os
import random

import numpy as np
import pytest
from bag_files import time_ns
from mcap.writer import Writer
from video_bags import ENCODERS, SIZE, encode, scene, write_video

from codecbench.core.contracts.errors import DatasetError
from codecbench.plugins.codecs.video.library import load_av
from codecbench.plugins.datasets.bag.dataset import Bag

MESSAGES = ("protobuf", "json", "foxglove_msgs", "ffmpeg", "ffmpeg db3")
REORDERED = {"preset": "fast", "crf": "18"}


def opened(tmp_path, packets, format_="h264", how="ffmpeg", **values):
    return Bag.create(
        path=write_video(tmp_path / f"{len(list(tmp_path.iterdir()))}.mcap", packets, format_, how), **values
    ).open()


def frame_number(image):
    """The number that `scene` wrote into a picture, by its brightness."""
    return round((float(image[8:40, 4:28].mean()) - 10.0) / 6.0)


def decoded_in_one_go(packets, decoder):
    """PyAV's own decoding of a whole stream, in RGB."""
    context = load_av().CodecContext.create(decoder, "r")
    frames = []
    for data in [*(data for _, data in packets), None]:
        frames += context.decode(None if data is None else load_av().Packet(data))
    return [frame.to_ndarray(format="rgb24") for frame in frames]


@pytest.fixture(scope="module", params=ENCODERS)
def stream(request):
    return request.param, encode(request.param, count=20)


@pytest.mark.parametrize("how", MESSAGES)
def test_frames_are_those_of_the_stream(tmp_path, stream, how):
    format_, packets = stream
    name = {"h265": "hevc"}.get(format_, format_) if "ffmpeg" in how else format_
    sequence = opened(tmp_path, packets, name, how)
    expected = decoded_in_one_go(packets, {"h265": "hevc", "av1": "libdav1d"}.get(format_, format_))
    images = [sequence.read(number).image for number in range(len(sequence))]
    np.testing.assert_array_equal(images, expected)
    assert [frame_number(image) for image in images] == list(range(20))
    np.testing.assert_allclose(sequence.timestamps_s * 1e9, [time_ns(number) for number in range(20)], rtol=0, atol=256)
    kbits_per_s = sum(len(data) for _, data in packets) / 20 * 8 * 25 / 1000
    assert f"{name} video, {kbits_per_s:.0f} kbit/s" in " ".join(sequence.notes)
    for number in random.Random(1).sample(range(20), 20):
        np.testing.assert_array_equal(sequence.read(number).image, images[number])


@pytest.mark.parametrize(
    ("format_", "options"),
    [
        ("h264", REORDERED),
        ("h264", REORDERED | {"x264-params": "open-gop=1"}),
        ("hevc", REORDERED | {"x265-params": "log-level=none:open-gop=1"}),
        ("h264", {"preset": "ultrafast", "tune": "zerolatency", "intra-refresh": "1"}),
    ],
)
def test_frames_of_reordered_and_open_groups_are_found_in_any_order(tmp_path, format_, options):
    packets = encode({"hevc": "h265"}.get(format_, format_), options=options)
    sequence = opened(tmp_path, packets, format_)
    images = [sequence.read(number).image for number in range(len(sequence))]
    assert [frame_number(image) for image in images] == list(range(30))
    for number in random.Random(2).sample(range(30), 30):
        np.testing.assert_array_equal(sequence.read(number).image, images[number])


def test_a_stream_that_begins_late_starts_at_its_first_key_frame_and_says_so(tmp_path, stream):
    format_, packets = stream
    sequence = opened(tmp_path, packets[4:], {"h265": "hevc"}.get(format_, format_))
    assert [frame_number(frame.image) for frame in sequence] == list(range(10, 20))
    assert "frames begin at the first key frame, /camera/video[6]: 6 before it are left out" in sequence.notes
    with pytest.raises(DatasetError, match=r"none of its 5 packets of .* is a key frame"):
        opened(tmp_path, packets[1:6], {"h265": "hevc"}.get(format_, format_))


def test_a_stream_that_begins_within_a_gradual_refresh_starts_where_it_is_complete(tmp_path):
    packets = encode(options={"preset": "ultrafast", "tune": "zerolatency", "intra-refresh": "1"})
    sequence = opened(tmp_path, packets[5:])
    whole = decoded_in_one_go(packets, "h264")
    assert 12 <= 30 - len(sequence) <= 20
    np.testing.assert_array_equal([frame.image for frame in sequence], whole[30 - len(sequence) :])


def test_parameters_that_only_the_first_key_frame_has_suffice(tmp_path):
    packets = encode()
    bare = [(number, without_parameters(data) if number else data) for number, data in packets]
    assert sum(len(data) for _, data in bare) < sum(len(data) for _, data in packets)
    sequence = opened(tmp_path, bare)
    assert [frame_number(sequence.read(number).image) for number in (25, 3, 14)] == [25, 3, 14]


def without_parameters(data):
    """A packet of H.264 without its parameter sets and messages."""
    units = data.split(b"\0\0\1")[1:]
    return b"".join(b"\0\0\1" + unit.rstrip(b"\0") for unit in units if unit[0] & 31 not in (6, 7, 8))


@pytest.mark.parametrize(
    "damage", [lambda data: data[: len(data) // 2], lambda data: b"", lambda data: bytes(range(64))]
)
def test_after_a_damaged_packet_frames_are_refused_up_to_the_next_key_frame(tmp_path, damage):
    packets = [(number, damage(data) if number == 12 else data) for number, data in encode()]
    sequence = opened(tmp_path, packets)
    for number in (15, 12, 19):
        with pytest.raises(
            DatasetError, match=rf"video\[{number}\]: .* message 12 is damaged .*next key frame"
        ) as caught:
            sequence.read(number)
        assert caught.value.without == {"skip": [number]}
    assert [frame_number(sequence.read(number).image) for number in (11, 20, 29)] == [11, 20, 29]


def test_a_message_that_is_none_costs_itself_and_what_depends_on_it(tmp_path):
    path = write_video(tmp_path / "a", encode(), "h264", "ffmpeg", cut=(3, 12))
    sequence = Bag.create(path=path).open()
    assert len(sequence) == 30
    with pytest.raises(DatasetError, match=r"message 12 is damaged .*is not a ffmpeg_image_transport"):
        sequence.read(15)
    assert [frame_number(sequence.read(number).image) for number in (29, 11, 2)] == [29, 11, 2]


def test_a_forked_process_decodes_and_ends(tmp_path):
    sequence = opened(tmp_path, encode(count=12))
    sequence.read(3)
    child = multiprocessing.get_context("fork").Process(target=read_and_forget, args=([sequence], 7))
    child.start()
    child.join(60)
    assert child.exitcode == 7
    assert frame_number(sequence.read(4).image) == 4


def read_and_forget(sequences, number):
    """End with the number that the frame of this number shows, without the sequence and its decoder."""
    found = frame_number(sequences.pop().read(number).image)
    gc.collect()
    os._exit(found)


def test_lost_packets_are_named(tmp_path):
    sequence = opened(tmp_path, [packet for packet in encode() if packet[0] not in (12, 25)])
    assert len(sequence) == 28
    assert "gaps in the frames' times: 2; if packets were lost" in " ".join(sequence.notes)


def test_gray_is_read_as_gray_or_suggested(tmp_path):
    sequence = opened(tmp_path, encode("h265", count=3, pixel_format="gray"), "h265", "protobuf")
    assert sequence.read(0).image.shape == SIZE[::-1]
    colorless = encode(count=12, picture=lambda number: np.repeat(scene(number)[:, :, :1], 3, axis=2))
    sequence = opened(tmp_path, colorless)
    assert sequence.channels == 3
    assert sequence.origin.params == {"color": "gray"}


def test_another_codec_is_refused_with_those_that_are_read(tmp_path):
    with pytest.raises(DatasetError, match=r"format 'theora.*' is not supported; supported: h264, h265, vp9, av1"):
        opened(tmp_path, encode(count=2), "theora")


def test_topics_that_are_not_read_are_named_with_their_types(tmp_path):
    with open(tmp_path / "a.mcap", "wb") as stream:
        writer = Writer(stream)
        writer.start()
        schema = writer.register_schema("acme.Radar", "protobuf", b"")
        channel = writer.register_channel("/radar", "protobuf", schema)
        writer.add_message(channel, 1, b"", 1)
        writer.finish()
    with pytest.raises(DatasetError, match=r"has no image topic; topics: /radar \(acme.Radar, 1\)"):
        Bag.create(path=tmp_path / "a.mcap").open()


def test_a_cut_recording_of_video_names_the_repair(tmp_path):
    path = write_video(tmp_path / "a.mcap", encode(count=5), "h264", "protobuf")
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(DatasetError, match="mcap recover"):
        Bag.create(path=path).open()


def test_the_fingerprint_covers_the_packets_that_frames_depend_on(tmp_path):
    packets = encode()
    before = opened(tmp_path, packets, start=15).fingerprint
    changed = [(number, data + b"\0" if number == 12 else data) for number, data in packets]
    assert opened(tmp_path, changed, start=15).fingerprint != before
    earlier = [(number, data + b"\0" if number == 3 else data) for number, data in packets]
    assert opened(tmp_path, earlier, start=15).fingerprint == before
