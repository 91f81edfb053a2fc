"""Farmland from above: fields with furrows, hedges, trees, farms.

Units are meters; the ground is at 0 and its middle at the origin.
"""

from __future__ import annotations

import numpy as np

from codecbench.core.contracts.image import Image
from codecbench.plugins.datasets.synthetic.furniture import Rng
from codecbench.plugins.datasets.synthetic.scene import Panel, Skin, box, place_panels, uniform_skin
from codecbench.plugins.datasets.synthetic.textures import crop, recolor, resize, round_to_uint8, scatter_patches

_ARRANGEMENT = 20250922
_HALF = 110.0
_DENSITY = 15.0
_LARGEST_FIELD_M = 46.0
_SOILS = (
    ("grass", (104.0, 128.0, 66.0)), ("grass", (150.0, 150.0, 80.0)), ("gravel", (136.0, 108.0, 78.0)),
    ("grass", (82.0, 112.0, 62.0)), ("moon", (176.0, 156.0, 104.0)), ("gravel", (112.0, 92.0, 70.0)),
    ("tissue", (120.0, 138.0, 84.0)),
)  # fmt: skip
_SUN = np.array([0.48, -0.36, 0.80])
Rectangle = tuple[float, float, float, float]


def farmland() -> list[Panel]:
    """All panels, with the sunlight in their textures."""
    rng = np.random.default_rng(_ARRANGEMENT)
    fields = _divide((-_HALF, -_HALF, _HALF, _HALF), rng)
    panels = [_field(field, rng) for field in fields]
    leaves = [_leaves(rng) for _ in range(16)]
    for left, low, right, high in fields:
        if rng.random() < 0.5:
            panels += _hedge((left, low), (right - left, 0.0), leaves, rng)
        if rng.random() < 0.5:
            panels += _hedge((left, low), (0.0, high - low), leaves, rng)
    for _ in range(150):
        x, y = (float(value) for value in rng.uniform(-_HALF, _HALF, 2))
        panels += place_panels(_tree(leaves, rng), (x, y, 0.0), float(rng.uniform(0, 90)))
    for _ in range(26):
        x, y = (float(value) for value in rng.uniform(-_HALF * 0.9, _HALF * 0.9, 2))
        panels += place_panels(_barn(rng), (x, y, 0.0), float(rng.uniform(0, 180)))
    return [_apply_sunlight(panel) for panel in panels]


def _divide(area: Rectangle, rng: Rng) -> list[Rectangle]:
    """Cut an area across its longer side repeatedly, down to the size of fields."""
    left, low, right, high = area
    wide, tall = right - left, high - low
    if max(wide, tall) < _LARGEST_FIELD_M:
        return [area]
    share = float(rng.uniform(0.35, 0.65))
    if wide > tall:
        cut = left + share * wide
        return _divide((left, low, cut, high), rng) + _divide((cut, low, right, high), rng)
    cut = low + share * tall
    return _divide((left, low, right, cut), rng) + _divide((left, cut, right, high), rng)


def _field(area: Rectangle, rng: Rng) -> Panel:
    """One field: soil or crop, furrows, and a path along one border."""
    left, low, right, high = area
    rows, columns = (max(8, round(side * _DENSITY)) for side in (high - low, right - left))
    name, color = _SOILS[int(rng.integers(len(_SOILS)))]
    soil = recolor(
        scatter_patches(name, rows, columns, rng, 70, float(rng.uniform(0.3, 0.7))), color, float(rng.uniform(0.7, 1.1))
    )
    coarse = recolor(scatter_patches("moon", rows // 4 + 1, columns // 4 + 1, rng, 90, 0.5), (128.0, 128.0, 128.0), 0.8)
    shades = resize(coarse, rows, columns).astype(np.float32) / 128.0
    spacing = int(rng.integers(14, 40))
    furrows = np.where(np.arange(columns if rng.random() < 0.5 else rows) % spacing < spacing // 3, 0.86, 1.04)
    shades *= furrows[None, :, None] if len(furrows) == columns else furrows[:, None, None]
    top = round_to_uint8(soil * shades)
    border = round(0.8 * _DENSITY)
    top[:border] = recolor(scatter_patches("gravel", border, columns, rng, 8, 0.4), (168.0, 150.0, 122.0), 0.7)
    corner = np.array([left, high, 0.0])
    return Panel(corner, np.array([right - left, 0.0, 0.0]), np.array([0.0, low - high, 0.0]), top)


def _leaves(rng: Rng) -> Image:
    green = float(rng.uniform(0.75, 1.25))
    return recolor(crop("grass", 96, 96, rng, 0.5), (66.0 * green, 90.0 * green, 46.0 * green), 1.2)


def _random_skin(images: list[Image], rng: Rng) -> Skin:
    """Skin of a random one of the images, the same on every face."""
    return uniform_skin(images[int(rng.integers(len(images)))])


def _hedge(start: tuple[float, float], along: tuple[float, float], leaves: list[Image], rng: Rng) -> list[Panel]:
    """A row of bushes."""
    panels: list[Panel] = []
    count = max(1, round((along[0] + along[1]) / 6.0))
    for number in range(count):
        share = (number + 0.5) / count
        foot = start[0] + share * along[0], start[1] + share * along[1], 0.0
        size = max(along[0] / count - 0.6, 1.4), max(along[1] / count - 0.6, 1.4), float(rng.uniform(1.4, 2.6))
        panels += box(foot, size, _random_skin(leaves, rng), leave_out=("bottom",))
    return panels


def _tree(leaves: list[Image], rng: Rng) -> list[Panel]:
    size = float(rng.uniform(2.2, 5.0))
    skin = _random_skin(leaves, rng)
    panels = box((0.0, 0.0, 0.5), (size, size, size * 0.9), skin, leave_out=("bottom",))
    panels += box((0.2 * size, 0.0, 0.5), (size * 0.8, size * 0.8, size * 1.15), skin, 45.0, ("bottom",))
    return [*panels, _shadow(size * 1.1, size * 1.1)]


def _barn(rng: Rng) -> list[Panel]:
    """A farm building: walls and a gable roof."""
    length, width, height = float(rng.uniform(9, 20)), float(rng.uniform(6, 10)), float(rng.uniform(3, 5))
    wall = recolor(crop("brick", 60, 200, rng, 0.6), (176.0, 160.0, 140.0), 0.8)
    tint = ((150.0, 82.0, 62.0), (112.0, 108.0, 106.0), (128.0, 70.0, 58.0))[int(rng.integers(3))]
    tiles = recolor(
        scatter_patches("brick", round(width * _DENSITY), round(length * _DENSITY), rng, 60, 0.4), tint, 0.9
    )
    panels = box((0.0, 0.0, 0.0), (length, width, height), uniform_skin(wall), leave_out=("top", "bottom"))
    rise = 0.35 * width
    for sign in (-1.0, 1.0):
        ridge = np.array([sign * length / 2, 0.0, height + rise])
        slope = np.array([0.0, sign * (width / 2 + 0.4), -rise * (1 + 0.8 / width)])
        panels.append(Panel(ridge, np.array([-sign * length, 0.0, 0.0]), slope, tiles))
    return [*panels, _shadow(length + 2.0, width + 2.0)]


def _shadow(length: float, width: float) -> Panel:
    """The dark ground around an object, slightly above the field."""
    dark = np.full((8, 8, 3), (44, 50, 34), np.uint8)
    corner = np.array([-length / 2 - 0.5, width / 2 + 0.8, 0.02])
    return Panel(corner, np.array([length, 0.0, 0.0]), np.array([0.0, -width, 0.0]), dark)


def _apply_sunlight(panel: Panel) -> Panel:
    """Multiply the light of sun and sky into a panel's texture."""
    light = 0.55 + 0.55 * max(0.0, float(panel.normal @ _SUN))
    return Panel(panel.corner, panel.right, panel.down, round_to_uint8(panel.texture * np.float32(light)))
