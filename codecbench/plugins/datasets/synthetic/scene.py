"""Geometry of a scene: textured rectangles in space, and boxes made of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import cos, radians, sin

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.image import Image
from codecbench.plugins.datasets.synthetic.textures import halve, round_to_uint8

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


def uniform_skin(texture: Image) -> Skin:
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


def place_panels(panels: list[Panel], foot: Point, turn_deg: float = 0.0) -> list[Panel]:
    """The panels turned about the vertical through the origin, then moved so that the origin comes to `foot`."""
    c, s = cos(radians(turn_deg)), sin(radians(turn_deg))
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return [
        Panel(turn @ panel.corner + np.array(foot), turn @ panel.right, turn @ panel.down, panel.texture, panel.glows)
        for panel in panels
    ]


@dataclass(frozen=True)
class Atlas:
    """What the renderer reads.

    edges: (P, 3, 3) corner, right and down of each panel, metres, world. texels: (N,) uint32, all levels of all
    textures, row by row, red in the lowest byte. first_level: (P,) row of `levels` at which a panel's texture
    begins. level_count: (P,). levels: (L, 3) offset into `texels`, height, width; each level has half the sides
    of the one before. carried: so many panels at the end belong to a thing that moves.
    """

    edges: NDArray[np.float64]
    texels: NDArray[np.uint32]
    first_level: NDArray[np.int64]
    level_count: NDArray[np.int64]
    levels: NDArray[np.int64]
    moving_count: int = 0


def panel_edges(panels: Sequence[Panel]) -> NDArray[np.float64]:
    """(P, 3, 3) corner, right and down of each panel."""
    return np.array([[panel.corner, panel.right, panel.down] for panel in panels])


def make_atlas(panels: Sequence[Panel]) -> Atlas:
    """Reduce every texture down to one texel and lay them end to end; one array on several panels is kept once."""
    blocks: list[NDArray[np.uint32]] = []
    levels: list[tuple[int, int, int]] = []
    first_level, level_count = [], []
    offset = 0
    known: dict[int, tuple[int, int]] = {}
    for panel in panels:
        if id(panel.texture) in known:
            first, count = known[id(panel.texture)]
            first_level.append(first)
            level_count.append(count)
            continue
        first_level.append(len(levels))
        pixels = panel.texture.astype(np.float32)
        while True:
            height, width = pixels.shape[:2]
            levels.append((offset, height, width))
            blocks.append(_pack_colors(round_to_uint8(pixels)))
            offset += height * width
            if height == width == 1:
                break
            pixels = halve(pixels)
        level_count.append(len(levels) - first_level[-1])
        known[id(panel.texture)] = first_level[-1], level_count[-1]
    return Atlas(
        edges=panel_edges(panels),
        texels=np.concatenate(blocks),
        first_level=np.array(first_level, np.int64),
        level_count=np.array(level_count, np.int64),
        levels=np.array(levels, np.int64),
    )


def _pack_colors(image: Image) -> NDArray[np.uint32]:
    colors = image.reshape(-1, 3).astype(np.uint32)
    return np.asarray(colors[:, 0] | colors[:, 1] << 8 | colors[:, 2] << 16, dtype=np.uint32)
