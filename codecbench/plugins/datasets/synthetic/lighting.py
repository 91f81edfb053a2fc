"""Bakes soft light into textures: lamps with soft shadows, and ambient light that is darker in corners.

Light is computed on a coarse grid on every panel and multiplied into its texture. Rendering a frame then costs
nothing extra, and a surface looks the same from every viewpoint.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.image import Image
from codecbench.core.kernels.compiled import compiled
from codecbench.plugins.datasets.synthetic.scene import Panel, panel_edges
from codecbench.plugins.datasets.synthetic.textures import round_to_uint8

Floats = NDArray[np.float64]

_GRID_M = 0.13
_GRID_MOST = 48
_SKY_RAYS = 24
_SKY_REACH_M = 0.7
_SKY = 0.80
_LAMP = 4.6
_LIFT_M = 1e-4
"""Distance in front of their surface at which rays start."""


def bake_light(panels: Sequence[Panel], lamps: Floats, rng: np.random.Generator) -> list[Panel]:
    """Multiply light into the textures of panels. lamps: (L, 3) points on lamps that shine downwards."""
    edges = panel_edges(panels)
    sky = _cosine_directions(rng)
    return [
        panel if panel.glows else replace(panel, texture=_lit_texture(panel, edges, lamps, sky)) for panel in panels
    ]


def _lit_texture(panel: Panel, edges: Floats, lamps: Floats, sky: Floats) -> Image:
    """The panel's texture times its light."""
    counts = [max(2, min(_GRID_MOST, int(np.sqrt(edge @ edge) / _GRID_M) + 1)) for edge in (panel.down, panel.right)]
    along, below = ((np.arange(count) + 0.5) / count for count in (counts[1], counts[0]))
    points = panel.corner + below[:, None, None] * panel.down + along[None, :, None] * panel.right
    starts = points.reshape(-1, 3) + _LIFT_M * panel.normal
    light = _light(starts, panel.normal, edges, _nearby_panels(panel, edges, _SKY_REACH_M), lamps, sky)
    height, width = panel.texture.shape[:2]
    shade = _upsample_grid(light.reshape(counts[0], counts[1]), height, width)
    return round_to_uint8(panel.texture.astype(np.float32) * shade[:, :, None])


def _nearby_panels(panel: Panel, edges: Floats, reach: float) -> Floats:
    """Edges of the panels whose bounding boxes come within `reach` of this panel's."""
    low, high = _bounds(edges)
    panel_low, panel_high = _bounds(panel_edges([panel]))
    return np.ascontiguousarray(edges[((low - reach <= panel_high) & (high + reach >= panel_low)).all(axis=1)])


def _bounds(edges: Floats) -> tuple[Floats, Floats]:
    """Lowest and highest coordinates (P, 3) of each panel."""
    corners = edges[:, :1] + np.stack([0 * edges[:, 1], edges[:, 1], edges[:, 2], edges[:, 1] + edges[:, 2]], axis=1)
    return corners.min(axis=1), corners.max(axis=1)


def _upsample_grid(grid: Floats, height: int, width: int) -> NDArray[np.float32]:
    """Interpolate the grid, whose values lie at cell centers, linearly at every texel."""
    rows = np.clip((np.arange(height) + 0.5) * grid.shape[0] / height - 0.5, 0, grid.shape[0] - 1.0)
    columns = np.clip((np.arange(width) + 0.5) * grid.shape[1] / width - 0.5, 0, grid.shape[1] - 1.0)
    top, left = np.minimum(rows.astype(int), grid.shape[0] - 2), np.minimum(columns.astype(int), grid.shape[1] - 2)
    fv, fu = (rows - top)[:, None], columns - left
    between_rows = grid[top] * (1 - fv) + grid[top + 1] * fv
    spread = between_rows[:, left] * (1 - fu) + between_rows[:, left + 1] * fu
    return np.asarray(spread, dtype=np.float32)


def _cosine_directions(rng: np.random.Generator) -> Floats:
    """Cosine-weighted random directions (R, 3) about +z: points on a sphere that touches the origin."""
    points = rng.normal(size=(_SKY_RAYS, 3))
    points /= np.sqrt((points * points).sum(axis=1, keepdims=True))
    points[:, 2] += 1.0
    return np.asarray(points / np.sqrt((points * points).sum(axis=1, keepdims=True)))


@compiled
def _light(points: Any, normal: Any, edges: Any, nearby: Any, lamps: Any, sky: Any) -> Any:
    """The light (N,) at points of one surface; `nearby` are the edges that its sky rays can reach."""
    helper, first, second, towards = np.zeros(3), np.empty(3), np.empty(3), np.empty(3)
    helper[0 if abs(normal[0]) < 0.7 else 1] = 1.0
    _cross(normal, helper, first)
    length = np.sqrt(first[0] * first[0] + first[1] * first[1] + first[2] * first[2])
    for k in range(3):
        first[k] /= length
    _cross(normal, first, second)
    normals, nearby_normals = _normals(edges), _normals(nearby)
    light = np.empty(len(points))
    for i in range(len(points)):
        point = points[i]
        free = 0.0
        for ray in range(len(sky)):
            for k in range(3):
                towards[k] = _SKY_REACH_M * (sky[ray, 0] * first[k] + sky[ray, 1] * second[k] + sky[ray, 2] * normal[k])
            free += 1.0 - _occlusion(point, towards, nearby, nearby_normals)
        direct = 0.0
        for lamp in range(len(lamps)):
            square, incidence = 0.0, 0.0
            for k in range(3):
                towards[k] = lamps[lamp, k] - point[k]
                square += towards[k] * towards[k]
                incidence += towards[k] * normal[k]
            if incidence > 0.0 and towards[2] > 0.0 and _occlusion(point, towards, edges, normals) == 0.0:
                direct += incidence * towards[2] / (square * square + 0.5 * square)
        light[i] = _SKY * free / len(sky) + _LAMP * direct / len(lamps)
    return light


@compiled
def _normals(edges: Any) -> Any:
    """(K, 3) cross products of the second and the first side of each panel."""
    normals = np.empty((len(edges), 3))
    for k in range(len(edges)):
        _cross(edges[k, 2], edges[k, 1], normals[k])
    return normals


@compiled
def _cross(a: Any, b: Any, out: Any) -> None:
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@compiled
def _occlusion(point: Any, towards: Any, edges: Any, normals: Any) -> float:
    """The share of light from one direction that an obstacle blocks: 1 at `point`, falling to 0 at point + towards.

    Only the fronts of panels block: a ray into a box enters through one.
    """
    nearest = 1.0
    for k in range(len(edges)):
        slope = normals[k, 0] * towards[0] + normals[k, 1] * towards[1] + normals[k, 2] * towards[2]
        if slope >= 0.0:
            continue
        ox, oy, oz = edges[k, 0, 0] - point[0], edges[k, 0, 1] - point[1], edges[k, 0, 2] - point[2]
        height = normals[k, 0] * ox + normals[k, 1] * oy + normals[k, 2] * oz
        if height >= 0.0 or height <= nearest * slope:
            continue
        distance = height / slope
        hx, hy, hz = distance * towards[0] - ox, distance * towards[1] - oy, distance * towards[2] - oz
        along = hx * edges[k, 1, 0] + hy * edges[k, 1, 1] + hz * edges[k, 1, 2]
        below = hx * edges[k, 2, 0] + hy * edges[k, 2, 1] + hz * edges[k, 2, 2]
        wide = edges[k, 1, 0] ** 2 + edges[k, 1, 1] ** 2 + edges[k, 1, 2] ** 2
        high = edges[k, 2, 0] ** 2 + edges[k, 2, 1] ** 2 + edges[k, 2, 2] ** 2
        if 0.0 <= along <= wide and 0.0 <= below <= high:
            nearest = distance
    return 1.0 - nearest
