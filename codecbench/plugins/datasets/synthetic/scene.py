"""Geometry of a scene: textured rectangles in space, and boxes made of them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import cos, radians, sin

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.image import Image

Floats = NDArray[np.float64]
Point = tuple[float, float, float]
Skin = Callable[[str, float, float], Image]
"""Texture of a box's face from the face's name, width and height in metres."""


@dataclass(frozen=True)
class Panel:
    """A textured rectangle that is seen from one side.

    corner, right, down: (3,) metres in the world: the corner where the texture begins, and the edges along
    its rows and columns as seen from the front. glows: shows its texture unlit.
    """

    corner: Floats
    right: Floats
    down: Floats
    texture: Image
    glows: bool = False

    def point(self, along: float, below: float) -> Floats:
        """The point (3,) at these shares, 0..1, of the two edges."""
        return self.corner + along * self.right + below * self.down

    @property
    def normal(self) -> Floats:
        """(3,) unit vector towards the side from which the panel is seen."""
        outward = np.cross(self.down, self.right)
        return np.asarray(outward / np.sqrt(outward @ outward))


def everywhere(texture: Image) -> Skin:
    """The same texture on every face."""
    return lambda face, width, height: texture


def upright(center: Point, facing_deg: float, width: float, height: float, texture: Image) -> Panel:
    """A vertical panel about `center` whose front faces the horizontal direction `facing_deg` (0 is +x)."""
    angle = radians(facing_deg)
    right = np.array([-sin(angle), cos(angle), 0.0]) * width
    down = np.array([0.0, 0.0, -height])
    return Panel(np.array(center) - right / 2 - down / 2, right, down, texture)


def box(foot: Point, size: Point, skin: Skin, turn_deg: float = 0.0, leave_out: tuple[str, ...] = ()) -> list[Panel]:
    """A box whose bottom has its centre at `foot`, turned about the vertical.

    size: along x, y and z before turning. Faces are `front` (towards -y), `back`, `left` (-x), `right`, `top`,
    `bottom`; those in `leave_out` are not made.
    """
    w, d, h = size
    corners = {
        "front": ((-w / 2, -d / 2, h), (w, 0, 0), (0, 0, -h)),
        "back": ((w / 2, d / 2, h), (-w, 0, 0), (0, 0, -h)),
        "left": ((-w / 2, d / 2, h), (0, -d, 0), (0, 0, -h)),
        "right": ((w / 2, -d / 2, h), (0, d, 0), (0, 0, -h)),
        "top": ((-w / 2, d / 2, h), (w, 0, 0), (0, -d, 0)),
        "bottom": ((-w / 2, -d / 2, 0), (w, 0, 0), (0, d, 0)),
    }
    c, s = cos(radians(turn_deg)), sin(radians(turn_deg))
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    panels = []
    for face, (corner, right, down) in corners.items():
        if face not in leave_out:
            edges = turn @ np.array(right, float), turn @ np.array(down, float)
            lengths = [float(np.abs(np.array(edge)).sum()) for edge in (right, down)]
            panels.append(Panel(turn @ np.array(corner) + np.array(foot), *edges, skin(face, *lengths)))
    return panels


def placed(panels: list[Panel], foot: Point, turn_deg: float = 0.0) -> list[Panel]:
    """The panels turned about the vertical through the origin, then moved so that the origin comes to `foot`."""
    c, s = cos(radians(turn_deg)), sin(radians(turn_deg))
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return [
        Panel(turn @ panel.corner + np.array(foot), turn @ panel.right, turn @ panel.down, panel.texture, panel.glows)
        for panel in panels
    ]
