"""Cameras from sensor_msgs/CameraInfo messages."""

from __future__ import annotations

import math
from typing import Any

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.contracts.sequence import Camera
from codecbench.plugins.datasets.bag.messages import CAMERA_INFO
from codecbench.plugins.datasets.bag.recording import Recording, Topic
from codecbench.plugins.datasets.calibration import camera_from_model

_REMEDY = "give `calibration: FILE`, or `camera: none` to use none"
_FISHEYE = ("equidistant", "fisheye")
_FEWEST_COEFFICIENTS = {"plumb_bob": 4, "rational_polynomial": 5, **dict.fromkeys(_FISHEYE, 4)}


def camera_topic(recording: Recording, images: Topic) -> Topic | None:
    """The `camera_info` topic beside a topic of images, else the only topic of that type, else None."""
    topics = {name: topic for name, topic in recording.topics.items() if topic.kind == CAMERA_INFO and len(topic)}
    parent = images.name
    while "/" in parent:
        parent = parent.rpartition("/")[0]
        if f"{parent}/camera_info" in topics:
            return topics[f"{parent}/camera_info"]
    return next(iter(topics.values())) if len(topics) == 1 else None


def camera_from_topic(recording: Recording, topic: Topic, images: Topic) -> Camera | None:
    """The camera in the first message; None if it was never calibrated (focal length 0).

    Images of a topic named `image_rect...` are rectified: their camera is the projection matrix, without distortion.
    Raises DatasetError if the distortion model is unknown.
    """
    info, where = recording.message(topic, 0), recording.where(topic, 0)
    matrix, projection, distortion = (
        [float(value) for value in getattr(info, name if hasattr(info, name) else name.upper())] for name in "kpd"
    )
    width, height = int(info.width), int(info.height)
    if not all(math.isfinite(value) for value in (*matrix, *projection, *distortion)):
        raise DatasetError(f"{where}: contains a number that is not finite; {_REMEDY}")
    rectified = any(part.startswith("image_rect") for part in images.name.split("/"))
    fx, fy, cx, cy = (
        (projection[0], projection[5], projection[2], projection[6])
        if rectified
        else (matrix[0], matrix[4], matrix[2], matrix[5])
    )
    if fx == 0.0:
        return None
    if fx < 0.0 or fy <= 0.0 or width < 1 or height < 1:
        raise DatasetError(f"{where}: {width}x{height} with focal lengths {fx}, {fy} is not a camera; {_REMEDY}")
    sizes = (width, height, fx, fy, cx, cy)
    model = str(info.distortion_model)
    if rectified or not (any(distortion) or model in _FISHEYE):
        return Camera(*sizes)
    return _distorted_camera(sizes, model, distortion, where)


def _distorted_camera(sizes: Any, model: str, distortion: list[float], where: str) -> Camera:
    """A camera with a distortion model. Raises DatasetError if it is unknown or lacks coefficients."""
    models = ", ".join(_FEWEST_COEFFICIENTS)
    if model not in _FEWEST_COEFFICIENTS or len(distortion) < _FEWEST_COEFFICIENTS[model]:
        raise DatasetError(
            f"{where}: distortion model {model[:40]!r} with {len(distortion)} numbers; supported: {models}; {_REMEDY}"
        )
    if model in _FISHEYE:
        return camera_from_model("equidistant", sizes[:2], sizes[2:], distortion[:4])
    if any(distortion[8:]):
        raise DatasetError(f"{where}: distortion model {model!r} with more than 8 numbers is not supported; {_REMEDY}")
    return camera_from_model("pinhole", sizes[:2], sizes[2:], distortion[:8])
