"""The room: walls, floor and ceiling, furniture along the walls, and the table in the middle.

Units are meters; the origin is on the floor below the middle of the table, x to the east, y to the north, z up.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from codecbench.plugins.datasets.synthetic import furniture
from codecbench.plugins.datasets.synthetic.furniture import OAK, PALE, WALNUT, texels
from codecbench.plugins.datasets.synthetic.lighting import bake_light
from codecbench.plugins.datasets.synthetic.scene import Atlas, Panel, Point, box, make_atlas, place_panels, upright
from codecbench.plugins.datasets.synthetic.textures import crop, photograph, planks, recolor, scatter_patches

HALF_X, HALF_Y, HEIGHT = 2.7, 2.3, 2.6
TABLE_TOP = 0.74
_ARRANGEMENT = 20240607
"""Seed of the arrangement, such as which parts of photographs are shown where; the same for every path."""

_TURNS = {"north": 0.0, "south": 180.0, "east": -90.0, "west": 90.0}
_WALL_DENSITY = 260.0


@cache
def room_atlas() -> Atlas:
    """The room for the renderer; made once per process."""
    return make_atlas(furnished_room())


def furnished_room() -> list[Panel]:
    """All panels of the room with the light in their textures; takes some seconds."""
    rng = np.random.default_rng(_ARRANGEMENT)
    panels = _shell(rng) + _lamps()
    panels += _north(rng) + _east(rng) + _south(rng) + _west(rng) + _table(rng)
    return bake_light(panels, _lamp_points(rng), rng)


def _place_at_wall(panels: list[Panel], wall: str, along: float, foot: float = 0.0) -> list[Panel]:
    """Place furniture with its back to a wall, `along` meters right of the wall's middle as seen from inside."""
    feet: dict[str, Point] = {
        "north": (along, HALF_Y, foot),
        "south": (-along, -HALF_Y, foot),
        "east": (HALF_X, -along, foot),
        "west": (-HALF_X, along, foot),
    }
    return place_panels(panels, feet[wall], _TURNS[wall])


def _shell(rng: np.random.Generator) -> list[Panel]:
    """Walls, floor, ceiling and rug."""
    long, short, high = (texels(2 * side, _WALL_DENSITY) for side in (HALF_X, HALF_Y, HEIGHT / 2))
    plaster = recolor(scatter_patches("moon", high, long, rng, 160, 0.9), (214, 200, 172), 0.85)
    stone = recolor(scatter_patches("gravel", high, long, rng, 150, 0.8), (172, 164, 158), 0.45)
    paper = recolor(scatter_patches("grass", high, short, rng, 170, 0.9), (142, 164, 140), 0.42)
    width = photograph("galaxies").shape[1]
    sky = photograph("galaxies")[60 : 60 + width * high // short]
    floor = planks(texels(2 * HALF_Y, 300.0), texels(2 * HALF_X, 300.0), rng, (168, 118, 74), 40)
    ceiling = recolor(scatter_patches("moon", short, long, rng, 200, 0.7), (226, 222, 214), 0.5)
    rug = crop("tissue", texels(1.9, 320.0), texels(2.6, 320.0), rng)
    middle = HEIGHT / 2
    east, north = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
    return [
        upright((0, HALF_Y, middle), -90, 2 * HALF_X, HEIGHT, plaster),
        upright((0, -HALF_Y, middle), 90, 2 * HALF_X, HEIGHT, stone),
        upright((HALF_X, 0, middle), 180, 2 * HALF_Y, HEIGHT, sky),
        upright((-HALF_X, 0, middle), 0, 2 * HALF_Y, HEIGHT, paper),
        Panel(np.array([-HALF_X, HALF_Y, 0.0]), 2 * HALF_X * east, -2 * HALF_Y * north, floor),
        Panel(np.array([-HALF_X, -HALF_Y, HEIGHT]), 2 * HALF_X * east, 2 * HALF_Y * north, ceiling),
        Panel(np.array([-1.3, 0.95, 0.006]), 2.6 * east, -1.9 * north, rug),
    ]


_LAMPS: tuple[Point, ...] = ((-1.1, 0.3, HEIGHT - 0.05), (1.2, -0.3, HEIGHT - 0.05))


def _lamps() -> list[Panel]:
    glass = np.full((8, 8, 3), 252, np.uint8)
    panels = [panel for lamp in _LAMPS for panel in box(lamp, (0.7, 0.7, 0.05), lambda *_: glass, 0, ("top",))]
    return [Panel(panel.corner, panel.right, panel.down, panel.texture, glows=True) for panel in panels]


def _lamp_points(rng: np.random.Generator) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Sixteen points on each lamp, one in each cell of a grid."""
    cells = np.array([(column, row) for row in range(4) for column in range(4)] * 2)
    points = np.repeat(np.array(_LAMPS), 16, axis=0)
    points[:, :2] += ((cells + rng.random(cells.shape)) / 4 - 0.5) * 0.7
    points[:, 2] -= 0.01
    return points


def _north(rng: np.random.Generator) -> list[Panel]:
    panels = _place_at_wall(furniture.bookcase(1.5, 2.05, 6, rng, OAK), "north", -1.65)
    bricks = np.rot90(photograph("brick"))
    chimney = recolor(np.vstack([bricks, bricks[::-1]])[:, :440], (172, 100, 78), 1.3)
    panels += _place_at_wall(
        box((0, -0.09, 0), (1.1, 0.18, 2.6), lambda *_: chimney, 0, ("back", "top", "bottom")), "north", 0.0
    )
    portrait = place_panels(furniture.wall_picture("astronaut", 0.72, rng), (0, -0.18, 0))
    panels += _place_at_wall(portrait, "north", 0.0, 1.62)
    panels += _place_at_wall(furniture.cabinet(1.6, 0.82, ("retina", "coins", "camera"), rng, PALE), "north", 1.72)
    panels += _place_at_wall(furniture.wall_picture("coffee", 0.80, rng, PALE), "north", 1.42, 1.62)
    panels += _place_at_wall(furniture.wall_picture("coins", 0.55, rng), "north", 2.24, 1.45)
    for along, name, size in ((1.15, "tissue", 0.26), (1.72, "motorcycle", 0.34), (2.25, "galaxies", 0.22)):
        piece = furniture.carton((size, size * 0.8, size * 0.9), name, rng)
        panels += _place_at_wall(place_panels(piece, (0, -0.2, 0), float(rng.uniform(-25, 25))), "north", along, 0.82)
    return panels


def _east(rng: np.random.Generator) -> list[Panel]:
    panels = _place_at_wall(furniture.sofa(rng, (92, 116, 150), ("cat", "tissue", "retina")), "east", -0.25)
    panels += _place_at_wall(furniture.wall_picture("motorcycle", 1.0, rng, PALE), "east", 0.62, 1.65)
    panels += _place_at_wall(furniture.wall_picture("camera", 0.62, rng), "east", -0.55, 1.62)
    panels += _place_at_wall(furniture.wall_picture("colors", 0.50, rng, OAK), "east", -1.45, 1.72)
    foot = 0.0
    for name, size in (("motorcycle", 0.52), ("coffee", 0.44), ("page", 0.36)):
        piece = furniture.carton((size, size * 0.9, size * 0.8), name, rng, 500.0)
        panels += _place_at_wall(place_panels(piece, (0, -0.36, 0), float(rng.uniform(-20, 20))), "east", 1.75, foot)
        foot += size * 0.8
    return panels + _place_at_wall(furniture.bookcase(0.8, 1.25, 4, rng, WALNUT), "east", -1.82)


def _south(rng: np.random.Generator) -> list[Panel]:
    panels = _place_at_wall(place_panels(furniture.table(1.5, 0.62, 0.74, rng, PALE), (0, -0.32, 0)), "south", 0.75)
    screen = crop("page", 330, 560, rng, 1.4)
    monitor = box(
        (0, -0.2, 0.86), (0.62, 0.04, 0.37), lambda f, w, h: screen if f == "front" else screen[:20, :20] // 4
    )
    stand = box((0, -0.18, 0.74), (0.10, 0.06, 0.14), furniture.wood_skin(rng, (60, 60, 64)))
    panels += _place_at_wall(monitor + stand, "south", 0.72)
    for along, name, size in ((0.2, "astronaut", 0.2), (1.22, "text", 0.28), (1.36, "coins", 0.16)):
        panels += _place_at_wall(
            place_panels(furniture.carton((size, size, size), name, rng), (0, -0.33, 0), 15), "south", along, 0.74
        )
    panels += _place_at_wall(furniture.wall_picture("rocket", 1.15, rng, (228, 226, 220), 0.0), "south", 0.75, 1.78)
    panels += _place_at_wall(furniture.bookcase(1.3, 2.0, 6, rng, WALNUT), "south", -0.95)
    panels += _place_at_wall(furniture.wall_picture("moon", 0.58, rng), "south", -2.02, 1.60)
    panels += _place_at_wall(furniture.wall_picture("text", 0.60, rng, OAK), "south", 1.95, 1.45)
    return panels + _place_at_wall(furniture.cabinet(0.75, 0.95, ("gravel",), rng, OAK), "south", -2.12)


def _west(rng: np.random.Generator) -> list[Panel]:
    panels = _place_at_wall(
        furniture.cabinet(2.0, 0.62, ("galaxies", "tissue", "cat", "brick"), rng, WALNUT), "west", 0.35
    )
    panels += _place_at_wall(furniture.wall_picture("cat", 0.95, rng, OAK), "west", -0.15, 1.62)
    panels += _place_at_wall(furniture.wall_picture("retina", 0.66, rng), "west", 0.92, 1.60)
    panels += _place_at_wall(furniture.wall_picture("page", 0.62, rng, PALE), "west", 1.78, 1.75)
    for along, name, size in ((-0.4, "rocket", 0.3), (0.1, "grass", 0.2), (0.7, "camera", 0.36), (1.1, "colors", 0.22)):
        piece = furniture.carton((size, size * 0.7, size), name, rng)
        panels += _place_at_wall(place_panels(piece, (0, -0.19, 0), float(rng.uniform(-20, 20))), "west", along, 0.62)
    panels += _place_at_wall(furniture.bookcase(0.9, 1.85, 5, rng, PALE), "west", -1.55)
    return panels + _place_at_wall(
        place_panels(furniture.carton((0.5, 0.45, 0.8), "motorcycle", rng, 500.0), (0, -0.3, 0)), "west", 1.85
    )


def _table(rng: np.random.Generator) -> list[Panel]:
    panels = furniture.table(1.15, 0.75, TABLE_TOP, rng, OAK)
    for x, y, turn, fabric in ((-0.3, 0.52, 4, "tissue"), (0.32, -0.50, 176, "retina"), (0.78, 0.05, -97, "coins")):
        panels += place_panels(furniture.chair(rng, WALNUT, fabric), (x, y, 0), turn)
    standing = (
        (-0.36, 0.16, 25, (0.26, 0.20, 0.34), "motorcycle"), (-0.02, 0.20, -8, (0.30, 0.16, 0.22), "astronaut"),
        (0.33, 0.12, -32, (0.20, 0.24, 0.36), "coffee"), (0.08, -0.06, 40, (0.16, 0.16, 0.50), "galaxies"),
        (-0.20, -0.14, 12, (0.24, 0.14, 0.18), "cat"), (0.34, -0.22, -15, (0.22, 0.12, 0.26), "tissue"),
    )  # fmt: skip
    for x, y, turn, size, name in standing:
        panels += place_panels(furniture.carton(size, name, rng), (x, y, TABLE_TOP), turn)
    for x, y, z, turn in (
        (-0.44, -0.20, 0, 30),
        (-0.43, -0.19, 0.035, 55),
        (0.10, -0.28, 0, -12),
        (-0.03, 0.20, 0.22, 5),
    ):
        panels += place_panels(furniture.book_lying(rng), (x, y, TABLE_TOP + z), turn)
    return panels
