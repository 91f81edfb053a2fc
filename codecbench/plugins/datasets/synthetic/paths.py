"""Camera paths through synthetic scenes: exact poses at any time."""

from __future__ import annotations

from collections.abc import Sequence
from math import atan, cos, hypot, inf, pi, radians, sin, tan

import numpy as np
from numpy.typing import NDArray

from codecbench.plugins.datasets.synthetic.worlds.conditions import Conditions

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
    """Hand tremor: a few slow waves along and about each axis, with phases from `seed`, times `factor`."""

    def __init__(self, seed: int, factor: float = 1.0) -> None:
        self._factor = factor
        rng = np.random.default_rng([seed, 1])
        self._phases = rng.uniform(0.0, 2.0 * pi, (6, len(_TREMOR_HZ)))

    def at(self, time_s: float) -> Floats:
        """Displacement in meters and rotation in radians (6,) at a time."""
        waves = np.sin(2.0 * pi * np.array(_TREMOR_HZ) * time_s + self._phases)
        sizes = np.vstack([np.tile(_TREMOR_M, (3, 1)), np.tile(np.radians(_TREMOR_DEG), (3, 1))])
        return np.asarray((waves * sizes).sum(axis=1) * self._factor)


class HandheldPath:
    """A hand-held camera that circles the room's table.

    A round returns to the start exactly, except for the tremor, which does not repeat: the second round sees the
    same places from a few millimeters or centimeters away. speed: factor on the walking speed, not on the tremor's
    frequencies. seed: of the tremor's phases. tremor: factor on its amplitude. loop_s: time of one round.
    """

    def __init__(self, seed: int, speed: float = 1.0, tremor: float = 1.0) -> None:
        self._speed = speed
        self._tremor = Tremor(seed, tremor)
        self.loop_s = LOOP_S / speed

    def world_from_camera(self, time_s: float) -> Floats:
        """The pose (4, 4) at a time: x right, y down, z forward in the camera; z up in the world; meters."""
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
    """The point the camera looks at, which wanders about the middle of the table."""
    return np.array(
        [
            0.16 * np.sin(2 * phase) - 0.10 * np.cos(phase),
            0.14 * np.cos(3 * phase) - 0.08 * np.sin(phase),
            _TARGET_HEIGHT_M + 0.08 * np.sin(2 * phase + 2.0),
        ]
    )


def looking_pose(position: Floats, direction: Floats, turn: Floats) -> Floats:
    """The pose (4, 4) of a level camera that looks along `direction`, then rotated by `turn` (radians)."""
    pose = np.eye(4)
    pose[:3, :3] = _looking_rotation(direction) @ _small_rotation(turn)
    pose[:3, 3] = position
    return pose


def _looking_rotation(direction: Floats) -> Floats:
    """The rotation (3, 3) of a level camera that looks along `direction`; columns are its axes in the world."""
    forward = direction / np.sqrt(direction @ direction)
    right = np.array([forward[1], -forward[0], 0.0])
    right /= np.sqrt(right @ right)
    return np.column_stack([right, np.cross(forward, right), forward])


def _small_rotation(angles: Floats) -> Floats:
    """The rotation (3, 3) by a rotation vector in radians, exactly orthonormal (Rodrigues' formula)."""
    angle = float(np.sqrt(angles @ angles))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = angles / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * (cross @ cross))


class Route:
    """A closed route on the ground: straight lines between corners, rounded by arcs of one radius.

    It begins halfway between the first corner and the second. length_m: length of one round.
    """

    def __init__(self, corners_m: Sequence[tuple[float, float]], radius_m: float) -> None:
        self._pieces: list[tuple[float, Floats, float, float]] = []
        self.length_m = 0.0
        corners = [np.array(corner, float) for corner in corners_m]
        position = (corners[0] + corners[1]) / 2
        for k in range(len(corners)):
            corner, following = corners[(k + 1) % len(corners)], corners[(k + 2) % len(corners)]
            heading = np.arctan2(*(corner - position)[::-1])
            turn = (np.arctan2(*(following - corner)[::-1]) - heading + pi) % (2 * pi) - pi
            straight = hypot(*(corner - position)) - radius_m * tan(abs(turn) / 2)
            self._add(straight, position, heading, 0.0)
            position = position + straight * np.array([cos(heading), sin(heading)])
            arc = radius_m * abs(turn)
            self._add(arc, position, heading, turn / arc)
            position = self.at(self.length_m)
        end = (corners[0] + corners[1]) / 2
        self._add(hypot(*(end - position)), position, np.arctan2(*(end - position)[::-1]), 0.0)

    def _add(self, length: float, position: Floats, heading: float, bend: float) -> None:
        self._pieces.append((self.length_m, position, heading, bend))
        self.length_m += length

    def at(self, distance_m: float) -> Floats:
        """The point (2,) at a distance along the route, modulo its length."""
        if distance_m != self.length_m:
            distance_m %= self.length_m
        start, position, heading, bend = next(piece for piece in reversed(self._pieces) if piece[0] <= distance_m)
        distance_m = distance_m - start
        if bend == 0.0:
            return position + distance_m * np.array([cos(heading), sin(heading)])
        end = heading + bend * distance_m
        return position + np.array([sin(end) - sin(heading), cos(heading) - cos(end)]) / bend


class RouteWalk:
    """A camera that moves along a route and looks at the point `ahead_m` further on.

    loop_m: distance after which the route's start is seen again; loop_s is the corresponding time.
    """

    def __init__(
        self, route: Route, conditions: Conditions, seed: int, *, height_m: float, ahead_m: float, loop_m: float
    ) -> None:
        self._route = route
        self._speed_m_s = conditions.speed_m_s
        self._tremor = Tremor(seed, conditions.tremor)
        self._height_m = height_m
        self._ahead_m = ahead_m
        self.loop_s = loop_m / conditions.speed_m_s

    def world_from_camera(self, time_s: float) -> Floats:
        """The exact pose (4, 4) at a time."""
        distance_m = self._speed_m_s * time_s
        here, there = self._route.at(distance_m), self._route.at(distance_m + self._ahead_m)
        tremor = self._tremor.at(time_s)
        position = np.array([*here, self._height_m]) + tremor[:3]
        return looking_pose(position, np.array([*(there - here), -0.02 * self._ahead_m]), tremor[3:])


class Turning:
    """A camera that turns on the spot, looking outwards from a small circle."""

    def __init__(self, conditions: Conditions, seed: int) -> None:
        self._rate = radians(conditions.turn_deg_s)
        self._radius_m = conditions.radius_m
        self._tremor = Tremor(seed, conditions.tremor)
        self.loop_s = 360.0 / conditions.turn_deg_s

    def world_from_camera(self, time_s: float) -> Floats:
        """The exact pose (4, 4) at a time."""
        angle = self._rate * time_s
        outwards = np.array([cos(angle), sin(angle), 0.0])
        tremor = self._tremor.at(time_s)
        position = self._radius_m * outwards + np.array([0.0, 0.0, 1.45 + 0.3 * self._radius_m * sin(3 * angle)])
        return looking_pose(position + tremor[:3], outwards - np.array([0.0, 0.0, 0.08]), tremor[3:])


class Panning:
    """A camera that pans to and fro, up and down, from one place, slightly in front of its axis of rotation."""

    _SWING, _NOD = radians(70.0), radians(10.0)

    def __init__(self, conditions: Conditions, seed: int) -> None:
        self.loop_s = 2 * pi * self._SWING / radians(conditions.turn_deg_s)
        self._radius_m = conditions.radius_m
        self._tremor = Tremor(seed, conditions.tremor)

    def world_from_camera(self, time_s: float) -> Floats:
        """The exact pose (4, 4) at a time."""
        phase = 2 * pi * time_s / self.loop_s
        yaw, pitch = self._SWING * sin(phase), self._NOD * sin(2 * phase) - 0.08
        outwards = np.array([cos(yaw) * cos(pitch), sin(yaw) * cos(pitch), sin(pitch)])
        tremor = self._tremor.at(time_s)
        return looking_pose(np.array([0.0, 0.0, 1.45]) + self._radius_m * outwards + tremor[:3], outwards, tremor[3:])


class Drive:
    """A car that drives straight down the first street, stops at its end and never sees its start again.

    end_s: time at which it reaches the end. A van ahead of it, if the place has one, keeps its distance.
    """

    _START_M, _LENGTH_M, _VAN_M = 4.0, 200.0, 12.0

    def __init__(self, conditions: Conditions, seed: int) -> None:
        self._speed_m_s = conditions.speed_m_s
        self._tremor = Tremor(seed, conditions.tremor)
        self.loop_s = inf
        self.end_s = self._LENGTH_M / conditions.speed_m_s

    def _along_m(self, time_s: float) -> float:
        return self._START_M + self._speed_m_s * min(time_s, self.end_s)

    def world_from_camera(self, time_s: float) -> Floats:
        """The exact pose (4, 4) at a time."""
        tremor = self._tremor.at(time_s)
        position = np.array([self._along_m(time_s), 0.0, 1.65]) + tremor[:3]
        return looking_pose(position, np.array([1.0, 0.0, -0.02]), tremor[3:])

    def van_m(self, time_s: float) -> Floats:
        """Position of the van (3,) at a time, in meters."""
        return np.array([self._along_m(time_s) + self._VAN_M, 0.0, 0.0])


class Slider:
    """A camera on a rail along a wall of the corridor: it starts slowly, stops at the end and comes back."""

    _START_M, _LENGTH_M = (2.0, 0.8, 1.5), 3.0

    def __init__(self, conditions: Conditions, seed: int) -> None:
        self.loop_s = 0.75 * 3.0**0.5 * pi * self._LENGTH_M / conditions.speed_m_s
        self._tremor = Tremor(seed, conditions.tremor)

    def world_from_camera(self, time_s: float) -> Floats:
        """The exact pose (4, 4) at a time. The fourth power of a sine begins with no speed and no acceleration."""
        distance_m = self._LENGTH_M * sin(pi * time_s / self.loop_s) ** 4
        tremor = self._tremor.at(time_s)
        position = np.array(self._START_M) + np.array([distance_m, 0.0, 0.0]) + tremor[:3]
        return looking_pose(position, np.array([0.0, -1.0, 0.1]), tremor[3:])


class Flight:
    """An aircraft that circles over a field thirty meters up, its camera pointing down and slightly ahead."""

    _RADIUS_M = 32.0
    _HEIGHT_M = 30.0

    def __init__(self, conditions: Conditions, seed: int) -> None:
        self._turn_rate = conditions.speed_m_s / self._RADIUS_M
        self._tremor = Tremor(seed, conditions.tremor)
        self.loop_s = 2 * pi / self._turn_rate

    def world_from_camera(self, time_s: float) -> Floats:
        """The exact pose (4, 4) at a time."""
        angle = self._turn_rate * time_s
        radius = self._RADIUS_M * (1 + 0.12 * sin(2 * angle))
        position = np.array([radius * cos(angle), radius * sin(angle), self._HEIGHT_M + 3.0 * sin(3 * angle)])
        down = atan(2.2)
        direction = np.array([-sin(angle) * cos(down), cos(angle) * cos(down), -sin(down)])
        tremor = self._tremor.at(time_s)
        return looking_pose(position + 4.0 * tremor[:3], direction, tremor[3:])
