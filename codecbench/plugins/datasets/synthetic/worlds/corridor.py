"""A corridor around a block of offices: bays with a door, a poster and a carton, alike or each different.

Units are meters; the floor is at 0, and the corridor's center line is the rectangle of CORRIDOR_CORNERS_M.
"""

from __future__ import annotations

import numpy as np

from codecbench.core.contracts.image import Image
from codecbench.plugins.datasets.synthetic.furniture import OAK, PALE, WALNUT, Rng, photo_skin, texels, wood_skin
from codecbench.plugins.datasets.synthetic.lighting import bake_light
from codecbench.plugins.datasets.synthetic.scene import Panel, Skin, box, place_panels, uniform_skin, upright
from codecbench.plugins.datasets.synthetic.textures import add_mat, recolor, round_to_uint8, scatter_patches
from codecbench.plugins.datasets.synthetic.worlds.presets import CORRIDOR_CORNERS_M

_ARRANGEMENT = 20250311
_HALF_WIDTH, _HEIGHT = 1.1, 2.6
_BAY = 2.4
_WALL_DENSITY = 220.0
_GROUND_DENSITY = 150.0
_PRINTS = ("motorcycle", "retina", "cat", "astronaut", "tissue", "coins", "rocket", "coffee", "galaxies", "camera")
_PAINTS = ((206.0, 198.0, 182.0), (170.0, 184.0, 178.0), (202.0, 184.0, 156.0), (176.0, 172.0, 186.0))


def corridor(distinctness: float) -> list[Panel]:
    """All panels with the light in their textures. distinctness: at 1 every bay differs, at 0 all are alike."""
    rng = np.random.default_rng(_ARRANGEMENT)
    length, depth = CORRIDOR_CORNERS_M[2]
    panels: list[Panel] = []
    for quarter in range(4):
        side, half = (length, depth / 2) if quarter % 2 == 0 else (depth, length / 2)
        outer = place_panels(_wall(side + 2 * _HALF_WIDTH, distinctness, rng), (0.0, half + _HALF_WIDTH, 0.0))
        inner = place_panels(_wall(side - 2 * _HALF_WIDTH, distinctness, rng), (0.0, _HALF_WIDTH - half, 0.0))
        panels += place_panels(outer + inner, (length / 2, depth / 2, 0.0), 90.0 * quarter)
    return bake_light(panels + _ground(length, depth, distinctness, rng), _lamp_points(length, depth), rng)


def _wall(width: float, distinctness: float, rng: Rng) -> list[Panel]:
    """A wall along x about the origin, its front towards -y, divided into bays."""
    count = max(1, round(width / _BAY))
    panels: list[Panel] = []
    for bay in range(count):
        middle = ((bay + 0.5) / count - 0.5) * width
        panels += place_panels(_bay(width / count, distinctness, rng), (middle, 0.0, 0.0))
    return panels


def _bay(width: float, distinctness: float, rng: Rng) -> list[Panel]:
    """One bay: a blend of the surfaces common to all bays and of its individual ones."""
    individual, common = (
        _BaySurfaces(np.random.default_rng(rng.integers(2**32))),
        _BaySurfaces(np.random.default_rng(7)),
    )

    def blended_skin(name: str) -> Skin:
        first, second = getattr(individual, name), getattr(common, name)
        return lambda face, w, h: _blend(first(face, w, h), second(face, w, h), distinctness)

    shift = distinctness * float(rng.uniform(-0.12, 0.12))
    size = 0.34 + distinctness * float(rng.uniform(-0.1, 0.2))
    paint = blended_skin("paint")("front", width, _HEIGHT)
    panels = [upright((0.0, 0.0, _HEIGHT / 2), -90.0, width, _HEIGHT, paint)]
    panels += box(
        (shift - width / 4, -0.03, 0.0), (0.9, 0.06, 2.05), blended_skin("door"), leave_out=("back", "bottom")
    )
    panels += box(
        (shift + width / 4, -0.02, 1.25), (0.62 + size / 2, 0.04, 0.85), blended_skin("poster"), leave_out=("back",)
    )
    carton = box((width / 4 - shift, -0.2, 0.0), (size, 0.3, size * 1.3), blended_skin("carton"), leave_out=("bottom",))
    return panels + carton


class _BaySurfaces:
    """The surfaces of one bay as skins, chosen by the random generator."""

    def __init__(self, rng: Rng) -> None:
        self._rng = rng
        self._names = [str(name) for name in rng.permutation(_PRINTS)]
        self.door = wood_skin(rng, (OAK, WALNUT, PALE)[int(rng.integers(3))])
        self.carton = photo_skin(self._names[0], rng, 420.0, 1.4)

    def paint(self, face: str, width: float, height: float) -> Image:
        name = ("moon", "gravel", "grass")[int(self._rng.integers(3))]
        color = _PAINTS[int(self._rng.integers(len(_PAINTS)))]
        return recolor(
            scatter_patches(name, texels(height, _WALL_DENSITY), texels(width, _WALL_DENSITY), self._rng, 130, 0.9),
            color,
            0.4,
        )

    def poster(self, face: str, width: float, height: float) -> Image:
        print_ = photo_skin(self._names[1], self._rng, 500.0, 1.0)(face, width - 0.02, height - 0.02)
        return add_mat(print_, 5) if face == "front" else print_


def _blend(first: Image, second: Image, share: float) -> Image:
    """Blend two images, whose sizes may differ by a texel; share: weight of the first."""
    rows, columns = min(first.shape[0], second.shape[0]), min(first.shape[1], second.shape[1])
    pair = first[:rows, :columns].astype(np.float32), second[:rows, :columns].astype(np.float32)
    return round_to_uint8(pair[0] * np.float32(share) + pair[1] * np.float32(1 - share))


def _ground(length: float, depth: float, distinctness: float, rng: Rng) -> list[Panel]:
    """Floor and ceiling of the whole corridor, and the lamps."""
    w, d = length + 2 * _HALF_WIDTH, depth + 2 * _HALF_WIDTH
    east, north = np.array([w, 0.0, 0.0]), np.array([0.0, d, 0.0])
    west_south = np.array([-_HALF_WIDTH, -_HALF_WIDTH, 0.0])
    rows, columns = texels(d, _GROUND_DENSITY), texels(w, _GROUND_DENSITY)
    floor = _tile(recolor(scatter_patches("gravel", rows, columns, rng, 110, 0.7), (138, 122, 108), 0.5), distinctness)
    ceiling = _tile(recolor(scatter_patches("moon", rows, columns, rng, 110, 0.7), (222, 220, 214), 0.4), distinctness)
    glass = np.full((8, 8, 3), 250, np.uint8)
    lamps = [
        Panel(panel.corner, panel.right, panel.down, glass, glows=True)
        for x, y in _lamps(length, depth)
        for panel in box((x, y, _HEIGHT - 0.05), (0.5, 0.5, 0.05), uniform_skin(glass), leave_out=("top",))
    ]
    return [
        Panel(west_south + north, east, -north, floor),
        Panel(west_south + np.array([0.0, 0.0, _HEIGHT]), east, north, ceiling),
        *lamps,
    ]


def _tile(surface: Image, distinctness: float) -> Image:
    """Divide a surface into slabs of 60 cm with joints; at distinctness 0 all slabs are the same."""
    slab = round(0.6 * _GROUND_DENSITY)
    rows, columns = -(-surface.shape[0] // slab), -(-surface.shape[1] // slab)
    repeated = np.tile(surface[:slab, :slab], (rows, columns, 1))
    blended = _blend(surface, repeated, distinctness)
    for start in (0, 1):
        blended[start::slab] = blended[start::slab] // 5 * 3
        blended[:, start::slab] = blended[:, start::slab] // 5 * 3
    return blended


def _lamps(length: float, depth: float) -> list[tuple[float, float]]:
    """Positions of the lamps."""
    lamps = [(x, y) for x in np.linspace(0.0, length, 5) for y in (0.0, depth)]
    lamps += [(x, y) for x in (0.0, length) for y in np.linspace(0.0, depth, 4)[1:-1]]
    return [(float(x), float(y)) for x, y in lamps]


def _lamp_points(length: float, depth: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Four points on each lamp."""
    spread = ((-0.15, -0.15), (0.15, -0.15), (-0.15, 0.15), (0.15, 0.15))
    points = [(x + dx, y + dy, _HEIGHT - 0.06) for x, y in _lamps(length, depth) for dx, dy in spread]
    return np.array(points)
