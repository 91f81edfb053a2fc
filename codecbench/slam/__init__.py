"""Stand-alone monocular ORB-SLAM: images and a camera in, trajectory and map out.

    from codecbench.slam import Camera, System

    system = System(Camera(640, 480, 535.4, 539.2, 320.1, 247.6))
    for timestamp_s, image in frames:
        system.process(image, timestamp_s)
    result = system.finish()

`image` is gray (height, width) or RGB (height, width, 3), uint8. The same frames and seed give the same result to the
last bit. The package uses neither codecs nor ground truth. Each name below is imported on first use, so that a caller
of one kernel does not load the rest.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from codecbench.slam.geometry.camera import Camera
    from codecbench.slam.options import Options
    from codecbench.slam.result import ClosedLoop, FrameState, FrameTrajectory, MapResult, MergedMaps, Result
    from codecbench.slam.system import System

_MODULES = {
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
    if name not in _MODULES:
        raise AttributeError(f"module 'codecbench.slam' has no attribute {name!r}")
    value = getattr(import_module(f"codecbench.slam.{_MODULES[name]}"), name)
    globals()[name] = value
    return value
