"""A town of six blocks: streets fourteen meters wide, house fronts, parked cars, trees, lamp posts, a cloudy sky.

Units are meters; the ground is at 0, and the crossings lie at the corners of STREET_CORNERS_M and beside them.
"""

from __future__ import annotations

import numpy as np

from codecbench.core.contracts.image import Image
from codecbench.plugins.datasets.synthetic.furniture import Rng
from codecbench.plugins.datasets.synthetic.scene import Panel, Skin, box, place_panels, uniform_skin
from codecbench.plugins.datasets.synthetic.textures import Color, crop, recolor, round_to_uint8, scatter_patches

_ARRANGEMENT = 20250704
_BLOCK_X, _BLOCK_Y, _COLUMNS, _ROWS = 80.0, 60.0, 3, 2
_HALF_STREET = 7.0
_DENSITY = 40.0
_FRONT = (8.8, 11.0)
_FACADES = 36
_WALL_COLORS: tuple[Color, ...] = (
    (196.0, 176.0, 146.0), (176.0, 120.0, 98.0), (206.0, 200.0, 186.0), (150.0, 146.0, 138.0), (186.0, 150.0, 104.0),
    (160.0, 170.0, 172.0), (132.0, 92.0, 76.0),
)  # fmt: skip
_PAINT: tuple[Color, ...] = (
    (150.0, 36.0, 34.0), (44.0, 62.0, 104.0), (196.0, 196.0, 198.0), (58.0, 60.0, 64.0), (116.0, 122.0, 128.0),
    (40.0, 84.0, 66.0),
)  # fmt: skip


def town() -> list[Panel]:
    """All panels of the town, under the light of an overcast day."""
    rng = np.random.default_rng(_ARRANGEMENT)
    stock = _Stock(rng)
    width, depth = _BLOCK_X - 2 * _HALF_STREET, _BLOCK_Y - 2 * _HALF_STREET
    panels = _sky(rng) + _streets(rng)
    for column in range(_COLUMNS):
        for row in range(_ROWS):
            middle = ((column + 0.5) * _BLOCK_X, (row + 0.5) * _BLOCK_Y, 0.0)
            for quarter in range(4):
                along, across = (width, depth) if quarter % 2 == 0 else (depth, width)
                panels += place_panels(
                    place_panels(_row(along, stock, rng), (0.0, -across / 2, 0.0)), middle, 90.0 * quarter
                )
    middle = (_COLUMNS * _BLOCK_X / 2, _ROWS * _BLOCK_Y / 2, 0.0)
    for quarter in range(4):
        along, across = _COLUMNS * _BLOCK_X, _ROWS * _BLOCK_Y
        along, across = (along, across) if quarter % 2 == 0 else (across, along)
        houses = _row(along + 2 * _HALF_STREET, stock, rng)
        panels += place_panels(place_panels(houses, (0.0, across / 2 + _HALF_STREET, 0.0)), middle, 90.0 * quarter)
    return panels


def van() -> list[Panel]:
    """A lettered van about the origin that drives along x; its back shows the letters to a car behind it."""
    rng = np.random.default_rng(_ARRANGEMENT)
    skin: Skin = lambda face, w, h: crop("text", round(1.5 * h * _DENSITY), round(1.5 * w * _DENSITY), rng)  # noqa: E731
    body = box((0.0, 0.0, 0.4), (4.6, 1.9, 1.9), skin, leave_out=("bottom",))
    return body + box((0.0, 0.0, 0.0), (3.8, 1.7, 0.4), uniform_skin(np.full((8, 8, 3), 30, np.uint8)))


def _row(length: float, stock: _Stock, rng: Rng) -> list[Panel]:
    """House fronts along x about the origin, facing -y, with cars, trees and posts in front of them."""
    count = round(length / _FRONT[0])
    panels: list[Panel] = []
    for number in range(count):
        x = ((number + 0.5) / count - 0.5) * length
        panels += place_panels(
            _house(length / count, stock.random_skin(stock.fronts)("front", 0.0, 0.0), rng), (x, 0.0, 0.0)
        )
        if 0 < number < count - 1 and rng.random() < 0.4:
            panels += place_panels(_car(stock), (x, -3.6 + float(rng.uniform(-0.2, 0.2)), 0.0))
        if number > 0 and rng.random() < 0.25:
            panels += place_panels(_tree(stock), (x - length / count / 2, -1.7, 0.0), float(rng.uniform(0, 90)))
        elif number > 0 and rng.random() < 0.3:
            panels += place_panels(_post(stock), (x - length / count / 2, -2.2, 0.0))
    return panels


def _house(width: float, front: Image, rng: Rng) -> list[Panel]:
    height = _FRONT[1] * float(rng.uniform(0.85, 1.25))
    juts = float(rng.uniform(0.0, 0.9))
    side = front[:, :40]
    skin: Skin = lambda face, w, h: front if face == "front" else side  # noqa: E731
    panels = box((0.0, 3.0 - juts, 0.0), (width, 6.0, height), skin, leave_out=("back", "top", "bottom"))
    cornice = (front[-30:, :200] * 0.8).astype(np.uint8)
    panels += box(
        (0.0, -juts - 0.15, height - 0.7), (width, 0.3, 0.4), uniform_skin(cornice), leave_out=("back", "top")
    )
    for _ in range(int(rng.integers(2))):
        place = float(rng.uniform(-0.3, 0.3)) * width, -juts - 0.4, 3.2 * int(rng.integers(1, 3)) + 0.1
        balcony = (front[40:80, :80] * 0.7).astype(np.uint8)
        panels += box(place, (1.8, 0.8, 0.95), uniform_skin(balcony), leave_out=("back",))
    return panels


def _facade(rng: Rng) -> Image:
    """Texture of a house front: a wall of plaster, stone or bricks with rows of windows and shop windows."""
    width, height = (round(side * _DENSITY) for side in _FRONT)
    name = ("brick", "gravel", "moon")[int(rng.integers(3))]
    wall = recolor(
        scatter_patches(name, height, width, rng, 90, 0.5), _WALL_COLORS[int(rng.integers(len(_WALL_COLORS)))], 0.7
    )
    columns, storeys = int(rng.integers(3, 6)), 3
    rise, step = round(3.2 * _DENSITY), width // columns
    tall, wide = round(float(rng.uniform(1.3, 1.9)) * _DENSITY), round(float(rng.uniform(0.9, 1.3)) * _DENSITY)
    for storey in range(storeys):
        top = height - (storey + 1) * rise + (rise - tall) // 2
        for column in range(columns):
            left = column * step + (step - wide) // 2
            if storey == 0:
                _opening(wall, top, left, round(rise * 0.72), round(step * 0.66), rng, 0.9)
            else:
                _opening(wall, top, left, tall, wide, rng, 0.45)
    return wall


def _opening(wall: Image, top: int, left: int, tall: int, wide: int, rng: Rng, brightness: float) -> None:
    """Write a window into a wall: a frame, a bar and the image in the pane."""
    name = str(rng.choice(("coffee", "camera", "motorcycle", "cat", "astronaut", "retina", "rocket", "text")))
    pane = crop(name, tall, wide, rng, 0.6).astype(np.float32) * float(rng.uniform(0.5, 1.0)) * brightness
    frame = float(rng.choice((40.0, 90.0, 225.0)))
    pane[:3] = pane[-3:] = frame
    pane[:, :3] = pane[:, -3:] = frame
    pane[:, wide // 2 : wide // 2 + 2] = frame
    rows = min(tall, wall.shape[0] - top)
    wall[top : top + rows, left : left + wide] = round_to_uint8(pane[:rows, : wall.shape[1] - left])


class _Stock:
    """The surfaces of houses, cars and trees, shared by many objects in different combinations."""

    def __init__(self, rng: Rng) -> None:
        self._rng = rng
        self.fronts = [_facade(rng) for _ in range(_FACADES)]
        self.paints = [_patch("motorcycle", rng, paint) for paint in _PAINT for _ in range(2)]
        self.glass = [_patch("camera", rng, (70.0, 76.0, 84.0)) for _ in range(4)]
        self.wheels = [_patch("coins", rng, (36.0, 36.0, 38.0)) for _ in range(2)]
        self.bark = [_patch("gravel", rng, (84.0, 70.0, 56.0)) for _ in range(3)]
        self.leaves = [_patch("grass", rng, (70.0, 92.0, 52.0)) for _ in range(6)]
        self.metal = [_patch("gravel", rng, (70.0, 74.0, 76.0))]
        self.signs = [crop(name, 40, 40, rng) for name in ("text", "page", "rocket", "colors")]

    def random_skin(self, images: list[Image]) -> Skin:
        """Skin of a random one of the images, the same on every face."""
        return uniform_skin(images[int(self._rng.integers(len(images)))])


def _patch(name: str, rng: Rng, color: Color) -> Image:
    return recolor(crop(name, 100, 140, rng, 0.8), color)


def _car(stock: _Stock) -> list[Panel]:
    body = box((0.0, 0.0, 0.3), (4.2, 1.7, 0.55), stock.random_skin(stock.paints), leave_out=("bottom",))
    under = box((0.0, 0.0, 0.0), (3.4, 1.6, 0.3), stock.random_skin(stock.wheels), leave_out=("top", "bottom"))
    return body + under + box((0.1, 0.0, 0.85), (2.2, 1.5, 0.55), stock.random_skin(stock.glass), leave_out=("bottom",))


def _tree(stock: _Stock) -> list[Panel]:
    panels = box((0.0, 0.0, 0.0), (0.3, 0.3, 3.2), stock.random_skin(stock.bark), leave_out=("top", "bottom"))
    for turn, size, foot in ((0.0, 2.4, 2.8), (40.0, 2.0, 3.6)):
        panels += box((0.0, 0.0, foot), (size, size, size), stock.random_skin(stock.leaves), turn)
    return panels


def _post(stock: _Stock) -> list[Panel]:
    panels = box((0.0, 0.0, 0.0), (0.14, 0.14, 6.0), stock.random_skin(stock.metal), leave_out=("top", "bottom"))
    return panels + box(
        (0.0, -0.05, 2.2), (0.7, 0.05, 0.7), stock.random_skin(stock.signs), leave_out=("top", "bottom")
    )


def _streets(rng: Rng) -> list[Panel]:
    """The crossings, and lanes between them made of a few repeated pieces."""
    pieces = [_lane(rng) for _ in range(4)]
    crossing = _asphalt(rng, round(2 * _HALF_STREET * _DENSITY), round(2 * _HALF_STREET * _DENSITY))
    panels = []
    for column in range(_COLUMNS + 1):
        for row in range(_ROWS + 1):
            at = np.array([column * _BLOCK_X, row * _BLOCK_Y, 0.0])
            panels.append(_flat(at, 2 * _HALF_STREET, 0.0, crossing))
            for turn, block, more in ((0.0, _BLOCK_X, column < _COLUMNS), (90.0, _BLOCK_Y, row < _ROWS)):
                length = block - 2 * _HALF_STREET
                count = round(length / 22.0)
                for piece in range(count if more else 0):
                    ahead = _HALF_STREET + (piece + 0.5) * length / count
                    direction = np.array([1.0, 0.0, 0.0]) if turn == 0.0 else np.array([0.0, 1.0, 0.0])
                    lane = pieces[int(rng.integers(len(pieces)))]
                    panels.append(_flat(at + ahead * direction, length / count, turn, lane))
    return panels


def _flat(middle: np.ndarray[tuple[int, ...], np.dtype[np.float64]], length: float, turn: float, top: Image) -> Panel:
    """A piece of ground as wide as a street; `length`: along x before it is turned."""
    corner = np.array([-length / 2, _HALF_STREET, 0.0])
    flat = Panel(corner, np.array([length, 0.0, 0.0]), np.array([0.0, -2 * _HALF_STREET, 0.0]), top)
    return place_panels([flat], (float(middle[0]), float(middle[1]), 0.0), turn)[0]


def _asphalt(rng: Rng, rows: int, columns: int) -> Image:
    return recolor(scatter_patches("gravel", rows, columns, rng, 60, 0.25), (104.0, 102.0, 100.0), 0.6)


def _lane(rng: Rng) -> Image:
    """Texture of twenty-two meters of street: sidewalk, curb, asphalt with patches and a dashed line."""
    rows, columns = round(2 * _HALF_STREET * _DENSITY), round(22.0 * _DENSITY)
    lane = _asphalt(rng, rows, columns)
    kerb = round(2.8 * _DENSITY)
    slabs = recolor(scatter_patches("brick", rows, columns, rng, 100, 0.6), (150.0, 144.0, 136.0), 0.6)
    lane[:kerb], lane[-kerb:] = slabs[:kerb], slabs[-kerb:]
    lane[kerb : kerb + 5] = lane[-kerb - 5 : -kerb] = (186, 184, 178)
    dash = round(3.0 * _DENSITY)
    for start in range(dash // 2, columns - dash, 2 * dash):
        lane[rows // 2 - 3 : rows // 2 + 3, start : start + dash] = (222, 220, 210)
    for _ in range(4):
        top, left = int(rng.integers(kerb, rows - 2 * kerb)), int(rng.integers(columns - 120))
        patch = lane[top : top + int(rng.integers(20, 70)), left : left + int(rng.integers(30, 120))]
        patch[:] = patch // 5 * 4
    return lane


def _sky(rng: Rng) -> list[Panel]:
    """Clouds on the inside of a large box."""
    clouds = recolor(scatter_patches("moon", 512, 1024, rng, 400, 1.6), (206.0, 212.0, 222.0), 0.3)
    clouds = round_to_uint8(clouds * np.float32(0.9))
    reach, high = 400.0, 160.0
    middle = (_COLUMNS * _BLOCK_X / 2, _ROWS * _BLOCK_Y / 2, 0.0)
    walls: list[Panel] = []
    for quarter in range(4):
        wall = Panel(np.array([-reach, reach, high]), np.array([2 * reach, 0, 0]), np.array([0, 0, -high - 20]), clouds)
        walls += place_panels([wall], middle, 90.0 * quarter)
    lid = Panel(np.array([-reach, -reach, high]), np.array([2 * reach, 0, 0]), np.array([0, 2 * reach, 0]), clouds)
    return [*walls, *place_panels([lid], middle)]
