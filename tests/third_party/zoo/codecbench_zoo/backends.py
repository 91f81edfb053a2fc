"""SLAM backends that misbehave, in what they are and in what they make of frames."""

from __future__ import annotations

import ctypes
import os
import sys
import time
from dataclasses import replace
from typing import Any

import numpy as np

from codecbench import Trajectory
from codecbench_zoo.tame import TameBackend, straight_run


class _Spoiling(TameBackend):
    def run(self, frames: Any, camera: Any, **options: Any) -> Any:
        return self.spoilt([(frame.index, frame.timestamp_s) for frame in frames])

    def spoilt(self, stamps: Any) -> Any:
        raise NotImplementedError


def _path(stamps: Any, **changed: Any) -> Any:
    return replace(straight_run(stamps).trajectory, **changed)


class TracksNone(_Spoiling):
    def spoilt(self, stamps: Any) -> Any:
        return None


class TracksNan(_Spoiling):
    def spoilt(self, stamps: Any) -> Any:
        return straight_run(stamps, trajectory=_path(stamps, world_from_camera=np.full((len(stamps), 4, 4), np.nan)))


class TracksFlat(_Spoiling):
    def spoilt(self, stamps: Any) -> Any:
        return straight_run(stamps, trajectory=_path(stamps, world_from_camera=np.zeros((len(stamps), 3))))


class TracksMore(_Spoiling):
    def spoilt(self, stamps: Any) -> Any:
        return straight_run([*stamps, (len(stamps), 1e3)])


class TracksLess(_Spoiling):
    def spoilt(self, stamps: Any) -> Any:
        return straight_run(stamps[:-1])


class TracksBackwards(_Spoiling):
    def spoilt(self, stamps: Any) -> Any:
        path = straight_run(stamps).trajectory
        turned = Trajectory(path.timestamps_s[::-1], path.world_from_camera)
        return straight_run(stamps, trajectory=turned)


class TracksUntimely(_Spoiling):
    def spoilt(self, stamps: Any) -> Any:
        return straight_run(stamps, trajectory=_path(stamps, timestamps_s=np.full(len(stamps), np.nan)))


class TracksLists(_Spoiling):
    def spoilt(self, stamps: Any) -> Any:
        return straight_run(stamps, trajectory=[])


class TracksEndlessPoints(_Spoiling):
    def spoilt(self, stamps: Any) -> Any:
        return straight_run(stamps, points_world=np.full((5, 2), np.inf))


class TracksForEver(_Spoiling):
    def spoilt(self, stamps: Any) -> Any:
        time.sleep(3600)


class TracksAndExits(_Spoiling):
    def spoilt(self, stamps: Any) -> Any:
        sys.exit(0)


class TracksAndDies(_Spoiling):
    def spoilt(self, stamps: Any) -> Any:
        ctypes.string_at(0)


class LeavesTheTrack(TameBackend):
    """Ends its process when it is constructed."""

    def __init__(self, params: Any) -> None:
        os._exit(0)


class Unbuilt(TameBackend):
    """Has architectures that cannot be looked into."""

    architectures = None  # type: ignore[assignment]


class TracksWell(_Spoiling):
    def spoilt(self, stamps: Any) -> Any:
        return straight_run(stamps)
