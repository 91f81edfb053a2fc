"""Monocular ORB-SLAM that stands alone: images and a camera in, trajectory and map out.

    from codecbench.slam import Camera, System

    system = System(Camera(640, 480, 535.4, 539.2, 320.1, 247.6))
    for timestamp_s, image in frames:
        system.process(image, timestamp_s)
    result = system.finish()

`image` is gray (height, width) or RGB (height, width, 3), uint8. Same frames and seed, same result to the
last bit. Nothing here knows codecs or ground truth. The names below are loaded when they are first used: who needs one
kernel does not wait for the rest.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from codecbench.slam.geometry.camera import Camera
    from codecbench.slam.options import Options
    from codecbench.slam.result import ClosedLoop, FrameState, FrameTrajectory, MapResult, MergedMaps, Result
    from codecbench.slam.system import System

_HOMES = {
    "Camera": "geometry.camera",
    "ClosedLoop": "result",
    "FrameState": "result",
    "FrameTrajectory": "result",
    "MapResult": "result",
    "MergedMaps": "result",
    "Options": "options",
    "Result": "result",
    "System": "system",
}

__all__ = [
    "Camera",
    "ClosedLoop",
    "FrameState",
    "FrameTrajectory",
    "MapResult",
    "MergedMaps",
    "Options",
    "Result",
    "System",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'codecbench.slam' has no attribute {name!r}")
    value = getattr(import_module(f"codecbench.slam.{_HOMES[name]}"), name)
    globals()[name] = value
    return value
