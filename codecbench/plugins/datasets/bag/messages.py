"""Deserializes messages by the definitions that ROS and Foxglove publish.

The definitions in a bag are not used: rosbags would turn them into Python code, and a bag may be untrusted.
"""

from __future__ import annotations

import json
import struct
from functools import cache
from importlib import import_module
from types import SimpleNamespace
from typing import Any, Final

import numpy as np
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from codecbench.core.contracts.errors import DatasetError

IMAGE: Final = "sensor_msgs/msg/Image"
COMPRESSED: Final = "sensor_msgs/msg/CompressedImage"
CAMERA_INFO: Final = "sensor_msgs/msg/CameraInfo"
POSE: Final = "geometry_msgs/msg/PoseStamped"
POSE_COVARIANCE: Final = "geometry_msgs/msg/PoseWithCovarianceStamped"
TRANSFORM: Final = "geometry_msgs/msg/TransformStamped"
ODOMETRY: Final = "nav_msgs/msg/Odometry"
TRANSFORMS: Final = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
FIX: Final = "sensor_msgs/msg/NavSatFix"
VIDEO: Final = "foxglove_msgs/msg/CompressedVideo"
_PACKET: Final = "ffmpeg_image_transport_msgs/msg/FFMPEGPacket"

_DEFINITIONS: Final = {
    VIDEO: "builtin_interfaces/Time timestamp\nstring frame_id\nuint8[] data\nstring format",
    _PACKET: "std_msgs/Header header\nint32 width\nint32 height\nstring encoding\nuint64 pts\nuint8 flags\n"
    "bool is_bigendian\nuint8[] data",
}
"""Messages of ROS 2 that rosbags does not know."""
_FOXGLOVE: Final = {
    "foxglove.RawImage": IMAGE,
    "foxglove.CompressedImage": COMPRESSED,
    "foxglove.CompressedVideo": VIDEO,
    "foxglove.CameraCalibration": CAMERA_INFO,
    "foxglove.PoseInFrame": POSE,
    "foxglove.FrameTransform": TRANSFORMS[0],
    "foxglove.FrameTransforms": TRANSFORMS[0],
    "foxglove.LocationFix": FIX,
}
"""Schemas of Foxglove, and the ROS messages whose fields they get."""


def kind_of(type_: str, encoding: str) -> str:
    """The ROS type whose fields a deserialized message has; empty if such messages cannot be deserialized."""
    if encoding in ("protobuf", "json"):
        return _FOXGLOVE.get(type_, "")
    if encoding not in ("cdr", "ros1") or (encoding == "ros1" and type_ in _DEFINITIONS):
        return ""
    return {_PACKET: VIDEO, TRANSFORMS[1]: TRANSFORMS[0]}.get(type_, type_)


@cache
def _types(encoding: str) -> Any:
    """The message types of ROS 2 (`cdr`) or ROS 1, with those added that rosbags lacks."""
    is_ros1 = encoding == "ros1"
    types = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
    added = {TRANSFORMS[0]: "geometry_msgs/TransformStamped[] transforms"} if is_ros1 else _DEFINITIONS
    for name, definition in added.items():
        types.register(get_types_from_msg(definition, name))
    return types


def deserialize(content: bytes, type_: str, encoding: str, where: str) -> Any:
    """Deserialize a message to the fields of `kind_of`; video packets get `header`, `data` and `format`.

    Raises DatasetError, naming `where`, if the bytes are not of this type.
    """
    try:
        if encoding in ("protobuf", "json"):
            return _as_ros(_from_foxglove(content, type_, encoding), _FOXGLOVE[type_])
        name = TRANSFORMS[0] if type_ in TRANSFORMS else type_
        types = _types(encoding)
        message = types.deserialize_ros1(content, name) if encoding == "ros1" else types.deserialize_cdr(content, name)
    except KeyError as error:
        raise DatasetError(f"{where}: the type {type_} is not supported") from error
    except ImportError as error:
        raise DatasetError(f"{where}: {type_} needs {error.name}; run: pip install 'codecbench[bag]'") from error
    except (SerdeError, ValueError, TypeError, IndexError, struct.error, AssertionError, RecursionError) as error:
        raise DatasetError(f"{where}: is not a {type_}: {error}") from error
    if type_ == _PACKET:
        return SimpleNamespace(header=message.header, data=message.data, format=message.encoding)
    if type_ == VIDEO:
        header = SimpleNamespace(stamp=message.timestamp, frame_id=message.frame_id)
        return SimpleNamespace(header=header, data=message.data, format=message.format)
    return message


def _from_foxglove(content: bytes, type_: str, encoding: str) -> Any:
    """Parse a message by Foxglove's published schema. Raises ImportError or ValueError."""
    name = type_.rpartition(".")[2]
    schema = getattr(import_module(f"foxglove_schemas_protobuf.{name}_pb2"), name)
    from google.protobuf import json_format, message, timestamp_pb2  # an optional extra

    def read_time(fields: dict[str, Any]) -> Any:
        """Write a time as protobuf's JSON has it; Foxglove's has two numbers."""
        if fields.keys() != {"sec", "nsec"}:
            return fields
        return timestamp_pb2.Timestamp(seconds=fields["sec"], nanos=fields["nsec"]).ToJsonString()

    try:
        if encoding == "protobuf":
            return schema.FromString(content)
        return json_format.ParseDict(json.loads(content, object_hook=read_time), schema(), ignore_unknown_fields=True)
    except (message.DecodeError, json_format.ParseError) as error:
        raise ValueError(str(error)) from error


def _as_ros(message: Any, kind: str) -> Any:
    """Give a message of Foxglove the fields of a kind of ROS message."""
    if kind == TRANSFORMS[0]:
        return SimpleNamespace(transforms=[_transform(one) for one in getattr(message, "transforms", [message])])
    fields = {field.name: getattr(message, field.name) for field in message.DESCRIPTOR.fields}
    if "data" in fields:
        fields |= {"data": np.frombuffer(message.data, np.uint8), "is_bigendian": False}
    return SimpleNamespace(**fields, header=_header(message.timestamp, message.frame_id))


def _transform(message: Any) -> Any:
    moved = SimpleNamespace(translation=message.translation, rotation=message.rotation)
    header = _header(message.timestamp, message.parent_frame_id)
    return SimpleNamespace(header=header, child_frame_id=message.child_frame_id, transform=moved)


def _header(stamp: Any, frame_id: str) -> Any:
    """A header as ROS has it, of a time from protobuf."""
    return SimpleNamespace(stamp=SimpleNamespace(sec=stamp.seconds, nanosec=stamp.nanos), frame_id=frame_id)


def stamp_ns(header: Any) -> int:
    """The time in a message's header, in ns."""
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)
