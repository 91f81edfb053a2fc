"""The named synthetic scenes: the place, the camera's path, and what severity makes worse."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import pi
from typing import Literal, get_args

from codecbench.plugins.datasets.synthetic.paths import (
    Drive,
    Flight,
    HandheldPath,
    Panning,
    Route,
    RouteWalk,
    Slider,
    Turning,
)
from codecbench.plugins.datasets.synthetic.rendered import CameraPath
from codecbench.plugins.datasets.synthetic.worlds.conditions import Conditions, interpolate_conditions

WorldName = Literal[
    "room",
    "fast_room",
    "dim_room",
    "poor_texture",
    "exposure",
    "rolling_shutter",
    "rotation",
    "panning_room",
    "corridor_loop",
    "repetitive_corridor",
    "slow_start",
    "street",
    "straight_road",
    "road_behind_van",
    "field",
]
Place = Literal["room", "corridor", "street", "street_and_van", "field"]
WORLD_NAMES: tuple[WorldName, ...] = get_args(WorldName)


def _handheld_path(conditions: Conditions, seed: int) -> CameraPath:
    return HandheldPath(seed, conditions.speed_m_s / 0.7, conditions.tremor)


def _corridor_path(conditions: Conditions, seed: int) -> CameraPath:
    route = Route(CORRIDOR_CORNERS_M, conditions.radius_m)
    return RouteWalk(route, conditions, seed, height_m=1.5, ahead_m=1.6, loop_m=route.length_m)


def _street_path(conditions: Conditions, seed: int) -> CameraPath:
    route = Route(STREET_CORNERS_M, conditions.radius_m)
    cut_m = (8 - 2 * pi) * conditions.radius_m
    return RouteWalk(route, conditions, seed, height_m=1.65, ahead_m=2.0, loop_m=STREET_LOOP_M - cut_m)


@dataclass(frozen=True)
class World:
    """A named synthetic scene."""

    about: str
    """Description in one line."""
    place: Place
    calm: Conditions
    """Conditions at severity 0."""
    hard: Conditions
    """Conditions at severity 1."""
    make_path: Callable[[Conditions, int], CameraPath] = _handheld_path
    """Makes the camera's path from conditions and a seed."""
    width: int = 640
    height: int = 480
    rate_hz: float = 30.0
    focal: float = 525.0 / 640.0
    """Focal length as a share of the image's width."""
    view_m: float = 1.8
    """Typical distance of visible surfaces."""

    def at(self, severity: float) -> Conditions:
        """The conditions at a severity from 0 to 1."""
        return interpolate_conditions(self.calm, self.hard, severity)

    def path(self, conditions: Conditions, seed: int) -> CameraPath:
        """The camera's path under these conditions."""
        return self.make_path(conditions, seed)

    def frames(self, severity: float, rate_hz: float) -> int:
        """Default length: one loop and a seventh of the next, or the whole path if it has no loop."""
        path = self.path(self.at(severity), 0)
        return round((path.end_s if isinstance(path, Drive) else path.loop_s * 8 / 7) * rate_hz)


CORRIDOR_CORNERS_M = ((0.0, 0.0), (9.0, 0.0), (9.0, 6.5), (0.0, 6.5))
STREET_CORNERS_M = ((0, 0), (80, 0), (80, 60), (0, 60), (0, 0), (240, 0), (240, 120), (80, 120), (80, 60), (0, 60))
STREET_LOOP_M = 280.0
"""Distance from the first crossing over three others back to it, before arcs shorten its four corners."""

_ROOM = Conditions(speed_m_s=0.6)
_CORRIDOR = Conditions(speed_m_s=0.8, radius_m=1.0, tremor=0.6)
_ROAD = World(
    "",
    "street",
    Conditions(speed_m_s=6.0, tremor=0.3, exposure=0.03),
    Conditions(speed_m_s=14.0, tremor=0.6, exposure=0.1, electrons=3000.0),
    Drive,
    width=1241,
    height=376,
    rate_hz=10.0,
    focal=718.0 / 1241.0,
    view_m=9.0,
)

WORLDS: dict[WorldName, World] = {
    "room": World(
        "a furnished room, hand-held, round its table: faster, shakier, longer exposed, noisier",
        "room",
        Conditions(speed_m_s=0.4, tremor=0.5, exposure=0.1, electrons=12000),
        Conditions(speed_m_s=1.3, tremor=2.0, exposure=0.6, electrons=1200),
    ),
    "fast_room": World(
        "the room at a run, with the motion blur of a long exposure",
        "room",
        Conditions(speed_m_s=0.7, tremor=1.0, exposure=0.3),
        Conditions(speed_m_s=2.2, tremor=4.0, exposure=1.0),
    ),
    "dim_room": World(
        "the room with the light going out: fewer electrons, hence noise, and darker frames",
        "room",
        replace(_ROOM, electrons=6000.0),
        replace(_ROOM, electrons=25.0, brightness=0.15),
    ),
    "poor_texture": World(
        "the room with its surfaces fading to plain colors",
        "room",
        _ROOM,
        replace(_ROOM, contrast=0.03),
    ),
    "exposure": World(
        "the room under an exposure that swings up and down once in two seconds",
        "room",
        _ROOM,
        replace(_ROOM, swing_stops=3.0),
    ),
    "rolling_shutter": World(
        "the room through a shutter that reads one row after the other",
        "room",
        replace(_ROOM, tremor=1.5),
        replace(_ROOM, tremor=1.5, readout=1.0),
    ),
    "rotation": World(
        "the room from its middle: the camera turns on an ever smaller circle",
        "room",
        Conditions(turn_deg_s=30.0, radius_m=0.9, speed_m_s=0.0),
        Conditions(turn_deg_s=50.0, radius_m=0.02, speed_m_s=0.0),
        Turning,
        view_m=2.2,
    ),
    "panning_room": World(
        "the room from one place: the camera looks to and fro, with an ever shorter baseline",
        "room",
        Conditions(turn_deg_s=25.0, radius_m=0.3, speed_m_s=0.0),
        Conditions(turn_deg_s=55.0, radius_m=0.05, speed_m_s=0.0, exposure=0.4),
        Panning,
        view_m=2.2,
    ),
    "corridor_loop": World(
        "a corridor round a block of offices, at walking pace with sharp corners",
        "corridor",
        _CORRIDOR,
        replace(_CORRIDOR, speed_m_s=2.0, tremor=2.0, exposure=0.5, electrons=1500.0),
        _corridor_path,
        rate_hz=15.0,
        focal=0.62,
        view_m=2.0,
    ),
    "repetitive_corridor": World(
        "the corridor with its bays more and more similar",
        "corridor",
        replace(_CORRIDOR, speed_m_s=1.3),
        replace(_CORRIDOR, speed_m_s=1.3, distinctness=0.5),
        _corridor_path,
        rate_hz=15.0,
        focal=0.62,
        view_m=2.0,
    ),
    "slow_start": World(
        "a flat wall of the corridor in small frames, from a rail: dark for a second, hardly any motion at first",
        "corridor",
        Conditions(speed_m_s=0.5, tremor=0.05, brightness=0.8, electrons=6000.0, first_light=0.1),
        Conditions(speed_m_s=1.2, tremor=0.05, brightness=0.3, electrons=1000.0, first_light=0.003),
        Slider,
        width=320,
        height=240,
    ),
    "street": World(
        "a street canyon from a car, wide frames at 10 Hz, right-angle turns; a kilometer until it repeats",
        "street",
        Conditions(speed_m_s=5.0, radius_m=9.0, tremor=0.3, exposure=0.03),
        Conditions(speed_m_s=10.0, radius_m=6.0, tremor=0.6, exposure=0.1, electrons=3000.0),
        _street_path,
        width=1241,
        height=376,
        rate_hz=10.0,
        focal=718.0 / 1241.0,
        view_m=9.0,
    ),
    "straight_road": replace(
        _ROAD, about="the first of these streets straight on, its end far ahead, from a car that never turns"
    ),
    "road_behind_van": replace(
        _ROAD, about="the same behind a lettered van that keeps its distance", place="street_and_van"
    ),
    "field": World(
        "fields, hedges and farms from thirty meters above",
        "field",
        Conditions(speed_m_s=7.0, tremor=1.0, exposure=0.05),
        Conditions(speed_m_s=22.0, tremor=6.0, exposure=0.4, electrons=1500.0),
        Flight,
        rate_hz=15.0,
        view_m=30.0,
    ),
}
"""Every synthetic scene by its name; `severity` interpolates from its first conditions to the second."""
