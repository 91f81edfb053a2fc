"""Writes a coded run as an MCAP file with messages of Foxglove's schemas. Needs the extra `bag`."""

from __future__ import annotations

import heapq
import json
from collections.abc import Iterator
from importlib.metadata import version
from operator import itemgetter
from pathlib import Path
from typing import Any, Final

import numpy as np
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from foxglove_schemas_protobuf.Pose_pb2 import Pose
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
from foxglove_schemas_protobuf.RawImage_pb2 import RawImage
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.writer import Writer
from mcap_protobuf.schema import register_schema
from scipy.spatial.transform import Rotation

from codecbench.core.contracts.errors import Unsupported
from codecbench.core.contracts.image import Layout
from codecbench.core.engine.storage import atomic
from codecbench.core.engine.text import counted
from codecbench.exporting.coded_run import CameraPath, CodedRun, Values
from codecbench.plugins.codecs.video.codecs import VideoCodec
from codecbench.plugins.codecs.video.muxing import payload

_ENCODINGS: Final = {Layout(1, 8): "mono8", Layout(3, 8): "rgb8", Layout(1, 16): "mono16"}
_VIDEO_FORMATS: Final = {"h264": "h264", "hevc": "h265", "av1": "av1", "vp9": "vp9"}
_IMAGE_FORMATS: Final = {b"\xff\xd8\xff": "jpeg", b"\x89PNG": "png"}
"""By the first bytes of a file."""

_Messages = Iterator[tuple[int, int, bytes]]
"""Times in nanoseconds, channels and content, in order of time."""


def write(run: CodedRun, out: Path, coded: bool) -> str:
    """Write frames, values and paths to `out`, in order of time, and return a sentence about the file.

    coded: write the bitstreams instead of the decoded frames. The time of a message is that of its frame or pose.
    Raises Unsupported if Foxglove does not decode the bitstreams.
    """
    topic = "/camera/coded" if coded else "/camera/decoded"
    with atomic.open_whole(out) as stream:
        writer: Any = Writer(stream)
        writer.start(library=f"codecbench {version('codecbench')}")
        writer.add_metadata("codecbench", {"codec": run.title})
        pictures = _coded_frames(run, writer, topic) if coded else _decoded_frames(run, writer, topic)
        values = [_values(run, writer, f"/values/{title}", columns) for title, columns in run.values.items()]
        paths = [_poses(writer, f"/{name}", path) for name, path in run.paths.items()]
        for time_ns, channel, data in heapq.merge(pictures, *values, *paths, key=itemgetter(0)):
            writer.add_message(channel, log_time=time_ns, publish_time=time_ns, data=data)
        writer.finish()
        size = stream.tell()
    return f"{out}: {run.title}, {counted(len(run.coded), 'frame')} on {topic}, {size / 1e6:.1f} MB"


def _channel(writer: Any, topic: str, message_class: Any) -> int:
    return int(writer.register_channel(topic, "protobuf", register_schema(writer, message_class)))


def _stamp(time_ns: int) -> Any:
    stamp = Timestamp()
    stamp.FromNanoseconds(time_ns)
    return stamp


def _decoded_frames(run: CodedRun, writer: Any, topic: str) -> _Messages:
    channel, encoding = _channel(writer, topic, RawImage), _ENCODINGS[run.coded.sequence.layout]
    encoding = encoding if run.coded.sequence.depth is None else "16UC1"
    for index, time_ns in enumerate(run.times_ns):
        image = run.coded.frame(index).decoded
        height, width = image.shape[:2]
        message = RawImage(
            timestamp=_stamp(time_ns), frame_id="camera", width=width, height=height, encoding=encoding,
            step=image[0].nbytes, data=image.tobytes(),
        )  # fmt: skip
        yield time_ns, channel, message.SerializeToString()


def _coded_frames(run: CodedRun, writer: Any, topic: str) -> _Messages:
    """The bitstreams as sent, without our header."""
    codec = run.coded.codec
    magic = codec.magic if isinstance(codec, VideoCodec) else b""
    message_class, name = _coded_format(run, payload(run.coded.frame(0).bitstream, magic))
    channel = _channel(writer, topic, message_class)
    for index, time_ns in enumerate(run.times_ns):
        data = payload(run.coded.frame(index).bitstream, magic)
        message = message_class(timestamp=_stamp(time_ns), frame_id="camera", data=data, format=name)
        yield time_ns, channel, message.SerializeToString()


def _coded_format(run: CodedRun, first: bytes) -> tuple[Any, str]:
    """The schema and the format of bitstreams. first: the first of them."""
    codec, packets = run.coded.codec, run.coded.packets
    for start, name in _IMAGE_FORMATS.items():
        if first.startswith(start):
            return CompressedImage, name
    if not isinstance(codec, VideoCodec) or codec.name not in _VIDEO_FORMATS or run.coded.sequence.bits != 8:
        raise Unsupported(f"Foxglove does not decode the bitstreams of {run.title}; leave out --coded")
    if any(packet.frame != place for place, packet in enumerate(packets)):
        raise Unsupported(f"{run.title} has B-frames, which Foxglove does not decode; leave out --coded")
    return CompressedVideo, _VIDEO_FORMATS[codec.name]


def _values(run: CodedRun, writer: Any, topic: str, columns: Values) -> _Messages:
    """JSON objects of one number a name. JSON has no infinity: such values are left out, as missing ones."""
    schema = {"type": "object", "properties": {name: {"type": "number"} for name in columns}}
    data = json.dumps(schema).encode()
    channel = writer.register_channel(topic, "json", writer.register_schema(topic.strip("/"), "jsonschema", data))
    for index, time_ns in enumerate(run.times_ns):
        values = {name: float(column[index]) for name, column in columns.items() if np.isfinite(column[index])}
        if values:
            yield time_ns, channel, json.dumps(values).encode()


def _poses(writer: Any, topic: str, path: CameraPath) -> _Messages:
    """The pose at each time, and at the first one the whole path, which Foxglove's 3D panel draws as a line."""
    quaternions = Rotation.from_matrix(path.world_from_camera[:, :3, :3]).as_quat().tolist()
    poses = [
        Pose(position=Vector3(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))
        for (x, y, z), (qx, qy, qz, qw) in zip(path.world_from_camera[:, :3, 3].tolist(), quaternions, strict=True)
    ]
    whole, single = _channel(writer, f"{topic}/path", PosesInFrame), _channel(writer, f"{topic}/pose", PoseInFrame)
    start_ns = path.times_ns[0]
    message = PosesInFrame(timestamp=_stamp(start_ns), frame_id="world", poses=poses)
    yield start_ns, whole, message.SerializeToString()
    for time_ns, pose in zip(path.times_ns, poses, strict=True):
        yield time_ns, single, PoseInFrame(timestamp=_stamp(time_ns), frame_id="world", pose=pose).SerializeToString()
