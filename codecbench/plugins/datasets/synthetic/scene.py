"""Geometry of a scene: textured rectangles (panels), boxes of them, and panels as arrays for compiled code."""

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
"""Returns the texture of a box's face, given the face's name, width and height in meters."""


@dataclass(frozen=True)
class Panel:
    """A textured rectangle that is visible from one side only."""

    corner: Floats
    """(3,) meters in the world: where the texture begins."""
    right: Floats
    """(3,) meters: the edge along the texture's rows as seen from the front."""
    down: Floats
    """(3,) meters: the edge along the texture's columns."""
    texture: Image
    glows: bool = False
    """Whether the texture is shown unlit."""

    def point(self, along: float, below: float) -> Floats:
        """The point (3,) at these shares, 0..1, of the two edges."""
        return self.corner + along * self.right + below * self.down

    @property
    def normal(self) -> Floats:
        """(3,) unit vector towards the visible side."""
        outward = np.cross(self.down, self.right)
        return np.asarray(outward / np.sqrt(outward @ outward))


def uniform_skin(texture: Image) -> Skin:
    """Skin with the same texture on every face."""
    return lambda face, width, height: texture


def upright(center: Point, facing_deg: float, width: float, height: float, texture: Image) -> Panel:
    """A vertical panel about `center` whose front faces the horizontal direction `facing_deg` (0 is +x)."""
    angle = radians(facing_deg)
    right = np.array([-sin(angle), cos(angle), 0.0]) * width
    down = np.array([0.0, 0.0, -height])
    return Panel(np.array(center) - right / 2 - down / 2, right, down, texture)


def box(foot: Point, size: Point, skin: Skin, turn_deg: float = 0.0, leave_out: tuple[str, ...] = ()) -> list[Panel]:
    """A box with the center of its bottom at `foot`, turned about the vertical.

    size: along x, y and z before turning. Faces are `front` (towards -y), `back`, `left` (-x), `right`, `top`,
    `bottom`, except those in `leave_out`.
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
    """Turn panels about the vertical through the origin, then move the origin to `foot`."""
    c, s = cos(radians(turn_deg)), sin(radians(turn_deg))
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return [
        Panel(turn @ panel.corner + np.array(foot), turn @ panel.right, turn @ panel.down, panel.texture, panel.glows)
        for panel in panels
    ]


@dataclass(frozen=True)
class Atlas:
    """Panels and the mip levels of their textures as arrays, for the renderer."""

    edges: NDArray[np.float64]
    """(P, 3, 3) corner, right and down of each panel, meters, world."""
    texels: NDArray[np.uint32]
    """(N,) all levels of all textures, row by row, red in the lowest byte."""
    first_level: NDArray[np.int64]
    """(P,) row of `levels` at which a panel's texture begins."""
    level_count: NDArray[np.int64]
    """(P,) number of levels of a panel's texture."""
    levels: NDArray[np.int64]
    """(L, 3) offset into `texels`, height, width; each level has half the sides of the one before."""
    moving_count: int = 0
    """How many panels, at the end, belong to a moving object."""


def panel_edges(panels: Sequence[Panel]) -> NDArray[np.float64]:
    """Corner, right and down of each panel (P, 3, 3)."""
    return np.array([[panel.corner, panel.right, panel.down] for panel in panels])


def make_atlas(panels: Sequence[Panel]) -> Atlas:
    """Compute the mip levels of all textures and concatenate them; a texture shared by panels is stored once."""
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
    """The pixels as uint32, red in the lowest byte."""
    colors = image.reshape(-1, 3).astype(np.uint32)
    return np.asarray(colors[:, 0] | colors[:, 1] << 8 | colors[:, 2] << 16, dtype=np.uint32)
