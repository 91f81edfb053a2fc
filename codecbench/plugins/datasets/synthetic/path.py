"""The way of a hand-held camera round the table and past its own beginning."""

from __future__ import annotations

from math import pi

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

FRAME_RATE_HZ = 30.0
LOOP_S = 340 / FRAME_RATE_HZ
"""Time of one round at speed 1: 7.9 m at 0.7 m/s."""

_SEMI_AXES_M = (1.40, 1.10)
_HEIGHT_M = 1.50
_TARGET_HEIGHT_M = 1.02
_TREMOR_HZ = (0.43, 0.97, 1.83, 3.10)
_TREMOR_M = (0.0120, 0.0050, 0.0018, 0.0006)
_TREMOR_DEG = (0.55, 0.30, 0.12, 0.05)


class Tremor:
    """The trembling of a hand: a few slow waves along and about each axis, their phases from `seed`, times `factor`."""

    def __init__(self, seed: int, factor: float = 1.0) -> None:
        self._factor = factor
        rng = np.random.default_rng([seed, 1])
        self._phases = rng.uniform(0.0, 2.0 * pi, (6, len(_TREMOR_HZ)))

    def at(self, time_s: float) -> Floats:
        """(6,) displacement in metres and turn in radians at a time."""
        waves = np.sin(2.0 * pi * np.array(_TREMOR_HZ) * time_s + self._phases)
        sizes = np.vstack([np.tile(_TREMOR_M, (3, 1)), np.tile(np.radians(_TREMOR_DEG), (3, 1))])
        return np.asarray((waves * sizes).sum(axis=1) * self._factor)


class HandheldPath:
    """Exact camera poses at any time, in seconds from the start.

    One round returns to the start exactly but for the hand's tremor, which does not repeat: the second round
    sees the same places in the same direction from a few millimetres or centimetres beside. speed: rounds are
    walked that many times as fast; the tremor keeps its rhythm. seed: of the tremor's phases. tremor: factor on it.
    loop_s: time of one round.
    """

    def __init__(self, seed: int, speed: float = 1.0, tremor: float = 1.0) -> None:
        self._speed = speed
        self._tremor = Tremor(seed, tremor)
        self.loop_s = LOOP_S / speed

    def world_from_camera(self, time_s: float) -> Floats:
        """The pose (4, 4) at a time: x right, y down, z forward in the camera; z up in the world; metres."""
        tremor = self._tremor.at(time_s)
        phase = 2.0 * pi * time_s * self._speed / LOOP_S
        position = _position(phase) + tremor[:3]
        return looking_pose(position, _target(phase) - position, tremor[3:])


def _position(phase: float) -> Floats:
    x, y = _SEMI_AXES_M
    return np.array(
        [
            x * np.cos(phase) + 0.05 * np.cos(3 * phase + 0.4),
            y * np.sin(phase) + 0.05 * np.sin(2 * phase + 1.1),
            _HEIGHT_M + 0.09 * np.sin(2 * phase + 0.5) + 0.05 * np.sin(3 * phase),
        ]
    )


def _target(phase: float) -> Floats:
    """Where the camera looks: about the middle of the table, wandering."""
    return np.array(
        [
            0.16 * np.sin(2 * phase) - 0.10 * np.cos(phase),
            0.14 * np.cos(3 * phase) - 0.08 * np.sin(phase),
            _TARGET_HEIGHT_M + 0.08 * np.sin(2 * phase + 2.0),
        ]
    )


def looking_pose(position: Floats, direction: Floats, turn: Floats) -> Floats:
    """The pose (4, 4) of a level camera at `position` that looks along `direction`, then turned by `turn` (radians)."""
    pose = np.eye(4)
    pose[:3, :3] = _looking(direction) @ _small_rotation(turn)
    pose[:3, 3] = position
    return pose


def _looking(direction: Floats) -> Floats:
    """The rotation (3, 3) of a level camera that looks along `direction`; columns are its axes in the world."""
    forward = direction / np.sqrt(direction @ direction)
    right = np.array([forward[1], -forward[0], 0.0])
    right /= np.sqrt(right @ right)
    return np.column_stack([right, np.cross(forward, right), forward])


def _small_rotation(angles: Floats) -> Floats:
    """The rotation (3, 3) by a vector of angles in radians, exactly orthonormal (Rodrigues' formula)."""
    angle = float(np.sqrt(angles @ angles))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = angles / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross))
