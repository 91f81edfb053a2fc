"""Renders an atlas in perspective: exact visibility per sample, perspective-correct trilinear textures.

A point corner + s right + t down at depth z lies on the ray (x, y, 1) z. So s/z, t/z and 1/z are linear in the
pixel, and a panel covers a pixel if 0 <= s/z <= 1/z and 0 <= t/z <= 1/z: four inequalities that need no
clipping, even if a panel extends behind the camera (Olano and Greer, "Triangle Scan Conversion using 2D
Homogeneous Coordinates", 1997). Only exactly rounded arithmetic is used, so frames do not depend on the
math library.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.sequence import Camera
from codecbench.core.kernels.compiled import compiled
from codecbench.plugins.datasets.synthetic.scene import Atlas

Floats = NDArray[np.float64]
_LEVEL_BIAS = 0.33
"""Square of about 0.6: since several samples are averaged, each covers that share of a pixel's width."""


class Renderer:
    """Renders one atlas through one camera without distortion; reuses its buffers between frames."""

    def __init__(self, atlas: Atlas, camera: Camera) -> None:
        self.atlas = atlas
        self.camera = camera
        self._intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
        shape = (camera.height, camera.width)
        self._nearness = np.empty(shape, np.float64)
        self._panels = np.empty(shape, np.int32)

    def mean_of_samples(self, world_from_cameras: Floats, offsets_px: Floats) -> NDArray[np.float32]:
        """The mean image (H, W, 3), 0..255, over poses (S, 4, 4), each with a pixel offset (S, 2).

        Different offsets within a pixel antialias edges; different poses within the exposure make motion blur.
        """
        total = np.zeros((self.camera.height, self.camera.width, 3), np.float32)
        for pose, offset in zip(world_from_cameras, offsets_px, strict=True):
            planes = self._find_visible(pose, offset)
            a = self.atlas
            _shade(planes, self._panels, a.texels, a.first_level, a.level_count, a.levels, total)
        return np.asarray(total / np.float32(len(world_from_cameras) * _FULL_WEIGHT), dtype=np.float32)

    def visible(self, world_from_camera: Floats) -> tuple[NDArray[np.int32], Floats]:
        """The panel in each pixel (H, W), -1 for none, and its depth (H, W) in metres, infinity for none."""
        self._find_visible(world_from_camera, np.zeros(2))
        with np.errstate(divide="ignore"):
            return self._panels.copy(), 1.0 / self._nearness

    def _find_visible(self, world_from_camera: Floats, offset_px: Floats) -> Floats:
        """Fill the buffers with the panel and 1/z of each pixel; return the plane equations."""
        planes = plane_equations(self.atlas.edges, world_from_camera, self._intrinsics, offset_px)
        rows = candidate_rows(planes, self.camera.width, self.camera.height)
        self._nearness[:] = 0.0
        self._panels[:] = -1
        cover(planes, rows, self._nearness, self._panels)
        return planes


def plane_equations(edges: Floats, world_from_camera: Floats, intrinsics: Floats, offset_px: Floats) -> Floats:
    """For each panel the coefficients of x, y and 1 that give s/z, t/z and 1/z at a pixel: (P, 3, 3).

    The rows are the inverse of the matrix [right down corner] in the camera's frame, times that of the
    calibration matrix. All are zero if the panel is seen from behind or edge on.
    """
    rotation, center = world_from_camera[:3, :3], world_from_camera[:3, 3]
    corner = (edges[:, 0] - center) @ rotation
    right, down = edges[:, 1] @ rotation, edges[:, 2] @ rotation
    normal = _cross(right, down)
    volume = np.einsum("pi,pi->p", normal, corner)
    scale = np.where(volume > 1e-12, 1.0 / np.where(volume > 1e-12, volume, 1.0), 0.0)
    rows = np.stack([_cross(down, corner), _cross(corner, right), normal], axis=1) * scale[:, None, None]
    fx, fy, cx, cy = intrinsics
    dx, dy = offset_px
    planes = np.empty_like(rows)
    planes[:, :, 0] = rows[:, :, 0] / fx
    planes[:, :, 1] = rows[:, :, 1] / fy
    planes[:, :, 2] = rows[:, :, 2] + planes[:, :, 0] * (dx - cx) + planes[:, :, 1] * (dy - cy)
    return planes


def _cross(first: Floats, second: Floats) -> Floats:
    """Cross products (P, 3) of vectors; faster than np.cross, which checks its arguments."""
    (a, b, c), (d, e, f) = first.T, second.T
    return np.column_stack([b * f - c * e, c * d - a * f, a * e - b * d])


def candidate_rows(planes: Floats, width: int, height: int) -> NDArray[np.int64]:
    """First row and one past the last (P, 2) in which a panel may be visible; safe, not tight.

    The inverse of a panel's matrix gives its corners: (x, y, 1) z at s, t in {0, 1}.
    """
    rows = np.zeros((len(planes), 2), np.int64)
    facing = np.flatnonzero(planes[:, 2].any(axis=1))
    shares = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0], [1.0, 1.0, 1.0]])
    corners = np.linalg.inv(planes[facing]) @ shares.T
    x, y, z = corners[:, 0], corners[:, 1], corners[:, 2]
    outside = (x < -z).all(1) | (x > width * z).all(1) | (y < -z).all(1) | (y > height * z).all(1) | (z <= 0).all(1)
    whole = (z > 1e-3).all(axis=1)
    below = np.where(whole[:, None], y / np.where(whole[:, None], z, 1.0), [0.0, 0.0, 0.0, height])
    rows[facing, 0] = np.clip(np.floor(below.min(axis=1)), 0, height)
    rows[facing, 1] = np.where(outside, 0, np.clip(np.ceil(below.max(axis=1)) + 1, 0, height))
    return rows


@compiled
def _span(plane: Any, y: float, width: int) -> tuple[int, int]:
    """First column and one past the last at which a panel covers row y; empty if first >= last."""
    first, last = 0.0, width - 1.0
    for side in range(4):
        row = side >> 1
        slope, level = plane[row, 0], plane[row, 1] * y + plane[row, 2]
        if side & 1:
            slope = plane[2, 0] - slope
            level = plane[2, 1] * y + plane[2, 2] - level
        if slope > 0.0:
            first = max(first, -level / slope)
        elif slope < 0.0:
            last = min(last, -level / slope)
        elif level < 0.0:
            return 0, 0
    if not first <= last:
        return 0, 0
    return int(np.ceil(first)), int(np.floor(last)) + 1


@compiled
def cover(planes: Any, rows: Any, nearness: Any, panels: Any) -> None:
    """Set each pixel of `panels` to the panel with the largest 1/z, kept in `nearness`."""
    width = nearness.shape[1]
    for panel in range(len(planes)):
        plane = planes[panel]
        for y in range(rows[panel, 0], rows[panel, 1]):
            first, last = _span(plane, y, width)
            level = plane[2, 1] * y + plane[2, 2]
            for x in range(first, last):
                near = plane[2, 0] * x + level
                if near > nearness[y, x]:
                    nearness[y, x] = near
                    panels[y, x] = panel


@compiled
def _shade(planes: Any, panels: Any, texels: Any, first_level: Any, level_count: Any, levels: Any, total: Any) -> None:
    """Add the texture's color at every covered pixel to `total`."""
    height, width = panels.shape
    for y in range(height):
        x = 0
        while x < width:
            panel, begin = panels[y, x], x
            while x < width and panels[y, x] == panel:
                x += 1
            if panel >= 0:
                some = levels[first_level[panel] : first_level[panel] + level_count[panel]]
                _shade_run(planes[panel], y, begin, x, some, texels, total)


@compiled
def _shade_run(plane: Any, y: int, begin: int, end: int, levels: Any, texels: Any, total: Any) -> None:
    """Add one panel's color to the pixels begin <= x < end of row y."""
    sx, tx, nx = plane[0, 0], plane[1, 0], plane[2, 0]
    s1, t1, n1 = plane[0, 1] * y + plane[0, 2], plane[1, 1] * y + plane[1, 2], plane[2, 1] * y + plane[2, 2]
    level, share = 0, 0
    for x in range(begin, end):
        depth = 1.0 / (nx * x + n1)
        along, below = (sx * x + s1) * depth, (tx * x + t1) * depth
        if (x - begin) & 7 == 0:
            level, share = texture_level(plane, along, below, depth, levels)
        color = np.uint64(8 - share) * texel(texels, levels, level, along, below)
        if share > 0:
            color += np.uint64(share) * texel(texels, levels, level + 1, along, below)
        total[y, x, 0] += np.float32(color & LANE)
        total[y, x, 1] += np.float32((color >> np.uint64(21)) & LANE)
        total[y, x, 2] += np.float32(color >> np.uint64(42))


@compiled
def texture_level(plane: Any, along: float, below: float, depth: float, levels: Any) -> tuple[int, int]:
    """The mip level that suits a pixel, and the share in eighths of the next coarser one."""
    reach = 0.0
    for axis in range(2):
        u = (plane[0, axis] - along * plane[2, axis]) * depth * levels[0, 2]
        v = (plane[1, axis] - below * plane[2, axis]) * depth * levels[0, 1]
        reach = max(reach, u * u + v * v)
    reach *= _LEVEL_BIAS
    level, last = 0, len(levels) - 1
    while reach > 4.0 and level < last:
        reach *= 0.25
        level += 1
    if level == last or reach <= 1.0:
        return level, 0
    return level, int((reach - 1.0) * (8.0 / 3.0) + 0.5)


LANE = np.uint64((1 << 21) - 1)
TEXEL_WEIGHT = 32 * 32
"""Sum of the weights of the four texels in a bilinear color."""

_FULL_WEIGHT = 8 * TEXEL_WEIGHT
"""Sum of the texels' weights in a blend of two levels; 255 times this fits into 21 bits."""


@compiled(inline="always")
def texel(texels: Any, levels: Any, level: int, along: float, below: float) -> Any:
    """1024 times the bilinear color of one level at (along, below) in 0..1: three numbers of 21 bits in one word.

    One multiplication weights all three channels; weights are multiples of 1/32 in each direction.
    """
    offset, rows, columns = levels[level, 0], levels[level, 1], levels[level, 2]
    u = min(max(int(along * (32.0 * columns) - 15.5), 0), (columns - 1) << 5)
    v = min(max(int(below * (32.0 * rows) - 15.5), 0), (rows - 1) << 5)
    left, top = u >> 5, v >> 5
    fu, fv = np.uint64(u & 31), np.uint64(v & 31)
    a = np.uint64(offset + top * columns + left)
    c = a + np.uint64(columns if top + 1 < rows else 0)
    step = np.uint64(1 if left + 1 < columns else 0)
    gu, gv = np.uint64(32) - fu, np.uint64(32) - fv
    upper = gu * _lanes(texels[a]) + fu * _lanes(texels[a + step])
    lower = gu * _lanes(texels[c]) + fu * _lanes(texels[c + step])
    return gv * upper + fv * lower


@compiled(inline="always")
def _lanes(texel: Any) -> Any:
    """Spread a texel's three bytes to 21 bits each."""
    word = np.uint64(texel)
    green, blue = word & np.uint64(0xFF00), word & np.uint64(0xFF0000)
    return (word & np.uint64(0xFF)) | (green << np.uint64(13)) | (blue << np.uint64(26))
