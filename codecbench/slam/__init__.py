"""Monocular ORB-SLAM that stands alone: images and a camera in, trajectory and map out.

    from codecbench.slam import Camera, System

    system = System(Camera(640, 480, 535.4, 539.2, 320.1, 247.6))
    for timestamp_s, image in frames:
        system.process(image, timestamp_s)
    result = system.finish()

`image` is gray (height, width) or blue-green-red (height, width, 3), uint8. Same frames and seed, same result to the
last bit. Nothing here knows codecs or ground truth.
"""

from codecbench.slam.geometry.camera import Camera
from codecbench.slam.options import Options
from codecbench.slam.system import System
from codecbench.slam.trajectory import FrameState, LoopEvent, MapResult, Result, Trajectory

__all__ = ["Camera", "FrameState", "LoopEvent", "MapResult", "Options", "Result", "System", "Trajectory"]
