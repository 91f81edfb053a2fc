"""Deserializes messages by the definitions that ROS ships.

The definitions in a bag are not used: rosbags would turn them into Python code, and a bag may be untrusted.
"""

from __future__ import annotations

import struct
from functools import cache
from typing import Any, Final

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

ENCODINGS: Final = ("cdr", "ros1")


@cache
def _types(encoding: str) -> Any:
    """The message types of ROS 2 (`cdr`) or ROS 1, with transforms added to the latter."""
    if encoding == "cdr":
        return get_typestore(Stores.ROS2_HUMBLE)
    types = get_typestore(Stores.ROS1_NOETIC)
    types.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TRANSFORMS[0]))
    return types


def deserialize(content: bytes, type_: str, encoding: str, where: str) -> Any:
    """Deserialize a message. Raises DatasetError, naming `where`, if the bytes are not of this type."""
    type_ = TRANSFORMS[0] if type_ in TRANSFORMS else type_
    types = _types(encoding)
    try:
        if encoding == "ros1":
            return types.deserialize_ros1(content, type_)
        return types.deserialize_cdr(content, type_)
    except KeyError as error:
        raise DatasetError(f"{where}: the type {type_} is not supported") from error
    except (SerdeError, ValueError, IndexError, struct.error, AssertionError) as error:
        raise DatasetError(f"{where}: is not a {type_}: {error}") from error
