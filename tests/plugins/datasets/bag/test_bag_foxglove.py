"""Foxglove's own messages, in protobuf and in JSON: pictures, camera and poses."""

from __future__ import annotations

import io
import json

import numpy as np
import pytest
from bag_files import picture, time_ns
from foxglove_schemas_protobuf import (
    CameraCalibration_pb2,
    CompressedImage_pb2,
    FrameTransform_pb2,
    FrameTransforms_pb2,
    LocationFix_pb2,
    PoseInFrame_pb2,
    RawImage_pb2,
)
from google.protobuf import json_format
from mcap.writer import Writer as McapWriter
from mcap_protobuf.writer import Writer as ProtobufWriter
from PIL import Image as PillowImage

from codecbench.core.contracts.errors import DatasetError
from codecbench.plugins.datasets.bag.dataset import Bag

QUARTER_TURN = {"z": 0.5**0.5, "w": 0.5**0.5}


def stamped(message, number):
    message.timestamp.FromNanoseconds(time_ns(number))
    return message


def messages():
    """(topic, message, number) of three pictures each, a camera and poses."""
    for number in range(3):
        image = picture(number)
        raw = RawImage_pb2.RawImage(frame_id="camera", width=32, height=24, encoding="rgb8", step=96)
        raw.data = image.tobytes()
        yield "/raw", raw, number
        yield "/png", CompressedImage_pb2.CompressedImage(frame_id="camera", data=png(image), format="png"), number
        pose = PoseInFrame_pb2.PoseInFrame(frame_id="world")
        pose.pose.position.x, pose.pose.orientation.w = number, 1.0
        yield "/pose", pose, number
        fix = LocationFix_pb2.LocationFix(frame_id="gps", latitude=45.0, longitude=7.0, altitude=100.0 + number)
        yield "/gps", fix, number
        moved = FrameTransform_pb2.FrameTransform(parent_frame_id="world", child_frame_id="base")
        moved.translation.y, moved.rotation.w = number, 1.0
        yield "/tf", FrameTransforms_pb2.FrameTransforms(transforms=[stamped(moved, number)]), number
    mount = FrameTransform_pb2.FrameTransform(parent_frame_id="base", child_frame_id="camera", rotation=QUARTER_TURN)
    mount.translation.x = 0.5
    yield "/tf_static", mount, 0
    yield "/camera", CameraCalibration_pb2.CameraCalibration(
        frame_id="camera", width=32, height=24, distortion_model="plumb_bob", D=[0.1, 0, 0, 0, 0],
        K=[30, 0, 15.5, 0, 31, 11.5, 0, 0, 1], P=[30, 0, 15.5, 0, 0, 31, 11.5, 0, 0, 0, 1, 0],
    ), 0  # fmt: skip


def png(image):
    stream = io.BytesIO()
    PillowImage.fromarray(image).save(stream, "PNG")
    return stream.getvalue()


def write_protobuf(path):
    with open(path, "wb") as stream, ProtobufWriter(stream) as writer:
        for topic, message, number in messages():
            if hasattr(message, "timestamp"):
                stamped(message, number)
            writer.write_message(topic, message, time_ns(number), time_ns(number))


def write_json(path):
    """Foxglove's JSON: protobuf's with proto field names, times of two numbers and whole numbers as numbers."""
    with open(path, "wb") as stream:
        writer, channels = McapWriter(stream), {}
        writer.start()
        for topic, message, number in messages():
            fields = json_format.MessageToDict(message, preserving_proto_field_name=True)
            time = {"sec": time_ns(number) // 10**9, "nsec": time_ns(number) % 10**9}
            for target in [fields, *fields.get("transforms", [])]:
                target["timestamp"] = time
            if topic not in channels:
                schema = writer.register_schema(message.DESCRIPTOR.full_name, "jsonschema", b"{}")
                channels[topic] = writer.register_channel(topic, "json", schema)
            writer.add_message(channels[topic], time_ns(number), json.dumps(fields).encode(), time_ns(number))
        writer.finish()


@pytest.fixture(scope="module", params=[write_protobuf, write_json])
def recording(request, tmp_path_factory):
    path = tmp_path_factory.mktemp("foxglove") / "drive.mcap"
    request.param(path)
    return path


@pytest.mark.parametrize("topic", ["/raw", "/png"])
def test_pictures_and_their_times(recording, topic):
    sequence = Bag.create(path=recording, topic=topic, ground_truth="none").open()
    np.testing.assert_array_equal([frame.image for frame in sequence], [picture(number) for number in range(3)])
    np.testing.assert_allclose(sequence.timestamps_s * 1e9, [time_ns(number) for number in range(3)], rtol=0, atol=256)
    assert (sequence.camera.fx, sequence.camera.cy, sequence.camera.distortion[0]) == (30.0, 11.5, 0.1)


def test_poses_transforms_and_fixes(recording):
    path = Bag.create(path=recording, topic="/raw").open().ground_truth
    np.testing.assert_array_equal(path.positions_world, [[number, 0, 0] for number in range(3)])
    path = Bag.create(path=recording, topic="/raw", ground_truth="/tf").open().ground_truth
    expected = np.array([[0, -1, 0, 0.5], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], np.float64)
    for number in range(3):
        expected[1, 3] = number
        np.testing.assert_allclose(path.world_from_camera[number], expected, atol=1e-12)
    path = Bag.create(path=recording, topic="/raw", ground_truth="/gps").open().ground_truth
    np.testing.assert_allclose(path.positions_world, [[0, 0, number] for number in range(3)], atol=1e-6)


@pytest.mark.parametrize(
    ("encoding", "content"),
    [
        ("protobuf", b"\xff\xff\xff"),
        ("json", b'{"timestamp": {"sec": 1, "nsec": 2}, "width": "many"}'),
        ("json", b"[" * 100_000),
        ("json", b'{"timestamp": 3}'),
        ("json", b"[1]"),
    ],
)
def test_other_bytes_are_refused(tmp_path, encoding, content):
    with open(tmp_path / "a.mcap", "wb") as stream:
        writer = McapWriter(stream)
        writer.start()
        channel = writer.register_channel("/raw", encoding, writer.register_schema("foxglove.RawImage", encoding, b""))
        writer.add_message(channel, 1, content, 1)
        writer.finish()
    with pytest.raises(DatasetError, match=r"/raw\[0\]: is not a foxglove.RawImage"):
        Bag.create(path=tmp_path / "a.mcap").open()
