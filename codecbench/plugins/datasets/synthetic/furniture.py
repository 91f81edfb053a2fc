"""Pieces of furniture: lists of panels about an origin on the floor, their fronts towards -y, their backs at y = 0.

Sizes are in meters. Each face shows a different part of a photograph, so no two look alike.
"""

from __future__ import annotations

import numpy as np

from codecbench.core.contracts.image import Image
from codecbench.plugins.datasets.synthetic.scene import Panel, Skin, box, upright
from codecbench.plugins.datasets.synthetic.textures import (
    Color,
    add_mat,
    crop,
    photograph,
    recolor,
    resize,
    scatter_patches,
    wood,
)

Rng = np.random.Generator

_DENSITY = 330.0
_NEAR_DENSITY = 800.0
OAK: Color = (176.0, 132.0, 84.0)
WALNUT: Color = (104.0, 72.0, 48.0)
PALE: Color = (206.0, 186.0, 152.0)
_COVERS = ("motorcycle", "retina", "cat", "astronaut", "tissue", "coins", "rocket", "coffee", "galaxies", "camera")
_COVER_COLORS: tuple[Color, ...] = (
    (150, 44, 38), (38, 70, 120), (52, 98, 66), (196, 160, 72), (92, 58, 110), (198, 190, 172), (60, 62, 70),
    (186, 104, 52),
)  # fmt: skip


def texels(size_m: float, density: float = _DENSITY) -> int:
    """Number of texels along `size_m` meters, at least 4; density: texels per meter."""
    return max(4, round(size_m * density))


def wood_skin(rng: Rng, color: Color, density: float = _DENSITY) -> Skin:
    """Skin of wood on every face, the grain along the longer side."""

    def skin(face: str, width: float, height: float) -> Image:
        long, short = texels(max(width, height), density), texels(min(width, height), density)
        board = wood(short, long, rng, color)
        return board if width >= height else np.ascontiguousarray(np.rot90(board))

    return skin


def photo_skin(name: str, rng: Rng, density: float = _DENSITY, zoom: float = 1.0, color: Color | None = None) -> Skin:
    """Skin with another part of one photograph on every face, in its colors or in shades of `color`."""

    def skin(face: str, width: float, height: float) -> Image:
        piece = crop(name, texels(height, density), texels(width, density), rng, zoom)
        return piece if color is None else recolor(piece, color)

    return skin


def wall_picture(name: str, width: float, rng: Rng, frame: Color = WALNUT, mat_m: float = 0.045) -> list[Panel]:
    """A photograph behind a mat in a wooden frame; the origin is the middle of its back."""
    photo = photograph(name)
    inner_width = texels(width - 2 * mat_m - 0.06, 600.0)
    image = resize(photo, round(inner_width * photo.shape[0] / photo.shape[1]), inner_width)
    front = add_mat(image, texels(mat_m, 600.0)) if mat_m else image
    front = _add_frame(front, texels(0.03, 600.0), rng, frame)
    height = width * front.shape[0] / front.shape[1]
    sides = wood_skin(rng, frame)
    skin: Skin = lambda face, w, h: front if face == "front" else sides(face, w, h)  # noqa: E731
    return box((0.0, -0.015, -height / 2), (width, 0.03, height), skin, leave_out=("back",))


def _add_frame(image: Image, border: int, rng: Rng, color: Color) -> Image:
    """Put an image into a wooden frame of `border` texels."""
    height, width = image.shape[0] + 2 * border, image.shape[1] + 2 * border
    frame = wood(height, width, rng, color)
    frame[border:-border, border:-border] = image
    return frame


def bookcase(width: float, height: float, shelves: int, rng: Rng, color: Color, depth: float = 0.28) -> list[Panel]:
    """Shelves full of books, each row slightly behind the boards."""
    skin = wood_skin(rng, color)
    board = 0.022
    middle = -depth / 2
    panels = box((0, -0.01, 0), (width, 0.02, height), skin, leave_out=("back", "bottom"))
    for x in (-width / 2, width / 2):
        panels += box((x, middle, 0), (board, depth, height), skin, leave_out=("back", "bottom"))
    step = (height - 0.06) / shelves
    for shelf in range(shelves + 1):
        foot = 0.04 + shelf * step
        panels += box((0, middle, foot), (width, depth, board), skin, leave_out=("back",))
        if shelf < shelves:
            height_free = step - board
            spines = _books(texels(width - board, 450.0), texels(height_free, 450.0), rng)
            center = (0.0, -depth * float(rng.uniform(0.70, 0.85)), foot + board + height_free / 2)
            panels.append(upright(center, -90.0, width - board, height_free, spines))
    return panels


def _books(width: int, height: int, rng: Rng) -> Image:
    """Texture of a row of book spines of various sizes, with occasional gaps."""
    row = np.full((height, width, 3), 14, np.uint8)
    left = int(rng.integers(4))
    while True:
        thick = int(rng.integers(10, 27))
        if left + thick > width:
            return row
        tall = int(height * rng.uniform(0.70, 0.99))
        spine = _spine(tall, thick - 1, rng)
        spine[:, 0] //= 2
        spine[:, -1] //= 2
        row[height - tall :, left : left + thick - 1] = spine
        left += thick + (int(rng.integers(12, 50)) if rng.random() < 0.07 else 0)


def _spine(height: int, width: int, rng: Rng) -> Image:
    """Texture of one book spine: lettering on a color, or part of a photograph."""
    if rng.random() < 0.6:
        name, color = str(rng.choice(("page", "text"))), _COVER_COLORS[int(rng.integers(len(_COVER_COLORS)))]
        return recolor(np.ascontiguousarray(np.rot90(crop(name, width, height, rng, zoom=0.8))), color, 1.5)
    return crop(str(rng.choice(_COVERS)), height, width, rng, zoom=0.4)


def table(width: float, depth: float, height: float, rng: Rng, color: Color) -> list[Panel]:
    """Four legs and a top; the origin is below its middle."""
    skin = wood_skin(rng, color, 700.0)
    panels = box((0, 0, height - 0.035), (width, depth, 0.035), skin)
    panels += box((0, 0, height - 0.12), (width - 0.10, depth - 0.10, 0.085), skin, leave_out=("top",))
    for x in (-width / 2 + 0.07, width / 2 - 0.07):
        for y in (-depth / 2 + 0.07, depth / 2 - 0.07):
            panels += box((x, y, 0), (0.06, 0.06, height - 0.035), skin, leave_out=("top", "bottom"))
    return panels


def chair(rng: Rng, color: Color, fabric: str) -> list[Panel]:
    """A seat, legs and a slatted back; the origin is below its middle."""
    skin = wood_skin(rng, color)
    cushion = photo_skin(fabric, rng, 500.0, 0.8)
    panels = box((0, 0, 0.41), (0.42, 0.42, 0.03), skin) + box((0, 0, 0.44), (0.39, 0.39, 0.035), cushion)
    for x in (-0.19, 0.19):
        panels += box((x, -0.19, 0), (0.035, 0.035, 0.41), skin, leave_out=("bottom", "top"))
        panels += box((x, 0.19, 0), (0.035, 0.035, 0.88), skin, leave_out=("bottom",))
    for z in (0.52, 0.65, 0.78):
        panels += box((0, 0.19, z), (0.36, 0.02, 0.075), skin, leave_out=("left", "right"))
    return panels


def cabinet(width: float, height: float, doors: tuple[str, ...], rng: Rng, color: Color) -> list[Panel]:
    """A sideboard with a photograph on each of its doors."""
    depth = 0.38
    skin = wood_skin(rng, color)
    panels = box((0, -depth / 2, 0), (width, depth, height), skin, leave_out=("back", "bottom"))
    door_width = width / len(doors) - 0.03
    for number, name in enumerate(doors):
        x = (number + 0.5) * width / len(doors) - width / 2
        face = crop(name, texels(height - 0.12, 500.0), texels(door_width, 500.0), rng, zoom=1.2)
        front = _add_frame(face, 12, rng, color)
        sides = wood_skin(rng, color)
        door: Skin = lambda side, w, h, f=front, s=sides: f if side == "front" else s(side, w, h)  # type: ignore[misc]  # noqa: E731
        panels += box((x, -depth - 0.008, 0.05), (door_width, 0.016, height - 0.08), door, leave_out=("back",))
    return panels


def sofa(rng: Rng, color: Color, cushions: tuple[str, ...]) -> list[Panel]:
    """A couch of woven fabric, with one printed cushion per name in `cushions`."""
    width, depth = 1.9, 0.80

    def fabric(face: str, w: float, h: float) -> Image:
        return recolor(scatter_patches("grass", texels(h), texels(w), rng, 96, 0.5), color, 0.8)

    panels = box((0, -depth / 2, 0.08), (width, depth, 0.34), fabric, leave_out=("back", "bottom"))
    panels += box((0, -0.10, 0.42), (width, 0.20, 0.42), fabric, leave_out=("back", "bottom"))
    for x in (-width / 2 + 0.09, width / 2 - 0.09):
        panels += box((x, -depth / 2, 0.42), (0.18, depth, 0.20), fabric, leave_out=("back", "bottom"))
    for number, name in enumerate(cushions):
        x = (number + 0.5) * 1.45 / len(cushions) - 0.725
        print_ = photo_skin(name, rng, 700.0, 1.0)
        panels += box((x, -0.28, 0.42), (0.40, 0.13, 0.38), print_, float(rng.uniform(-12, 12)), ("bottom",))
    return panels


def carton(size: tuple[float, float, float], name: str, rng: Rng, density: float = _NEAR_DENSITY) -> list[Panel]:
    """A printed box; the origin is below its middle."""
    return box((0, 0, 0), size, photo_skin(name, rng, density, 1.6), leave_out=("bottom",))


def book_lying(rng: Rng, width: float = 0.17, depth: float = 0.23, height: float = 0.035) -> list[Panel]:
    """A book lying on its back cover; the origin is below its middle."""
    cover = str(rng.choice(_COVERS))
    skin = photo_skin(cover, rng, _NEAR_DENSITY, 1.3)
    pages = photo_skin("page", rng, _NEAR_DENSITY, 0.7)
    return box(
        (0, 0, 0), (width, depth, height), lambda f, w, h: (skin if f == "top" else pages)(f, w, h), 0, ("bottom",)
    )
