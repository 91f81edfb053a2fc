"""Points triangulated from two views, with their errors, depths and parallax.

Source of the algorithms: Hartley and Zisserman, "Multiple View Geometry", 2nd edition, chapter 12. Pixels are
undistorted; poses are camera_from_world.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from codecbench.core.kernels.compiled import compiled

Floats = NDArray[np.float64]
_MAX_SWEEPS = 30


@compiled
def triangulate(a_from_world: Any, b_from_world: Any, pixels_a: Any, pixels_b: Any, intrinsics: Any) -> Any:
    """Return the points (N, 3) in the world seen at `pixels_a`, `pixels_b` (N, 2): linear triangulation (section 12.2).

    Poses are camera_from_world (4, 4), `intrinsics` fx, fy, cx, cy. Coordinates of points at infinity are not finite.
    """
    points = np.empty((len(pixels_a), 3))
    system = np.empty((4, 4))
    for i in range(len(pixels_a)):
        x, y, z, w = triangulate_pair(a_from_world, b_from_world, pixels_a[i], pixels_b[i], intrinsics, system)
        if w != 0.0:
            points[i, 0], points[i, 1], points[i, 2] = x / w, y / w, z / w
        else:
            points[i] = np.inf
    return points


@compiled
def triangulate_pair(
    a_from_world: Any, b_from_world: Any, pixel_a: Any, pixel_b: Any, intrinsics: Any, system: Any
) -> Any:
    """Return homogeneous coordinates of the point at two pixels; see `triangulate`. Overwrites `system` (4, 4)."""
    fx, fy, cx, cy = intrinsics
    xa, ya = (pixel_a[0] - cx) / fx, (pixel_a[1] - cy) / fy
    xb, yb = (pixel_b[0] - cx) / fx, (pixel_b[1] - cy) / fy
    for k in range(4):
        system[0, k] = xa * a_from_world[2, k] - a_from_world[0, k]
        system[1, k] = ya * a_from_world[2, k] - a_from_world[1, k]
        system[2, k] = xb * b_from_world[2, k] - b_from_world[0, k]
        system[3, k] = yb * b_from_world[2, k] - b_from_world[1, k]
    return _null_vector(system)


@compiled
def _null_vector(system: Any) -> Any:
    """Return the right singular vector of the least singular value of a (4, 4), which is overwritten.

    One-sided Jacobi rotations make the columns orthogonal (Golub and Van Loan, section 8.6.3): as accurate as LAPACK's
    decomposition, which takes ten times as long at this size.
    """
    turned = np.eye(4)
    for _ in range(_MAX_SWEEPS):
        settled = True
        for p in range(3):
            for q in range(p + 1, 4):
                pp, qq, pq = 0.0, 0.0, 0.0
                for k in range(4):
                    pp += system[k, p] * system[k, p]
                    qq += system[k, q] * system[k, q]
                    pq += system[k, p] * system[k, q]
                if abs(pq) <= 1e-15 * math.sqrt(pp * qq):
                    continue
                settled = False
                zeta = (qq - pp) / (2.0 * pq)
                tangent = math.copysign(1.0, zeta) / (abs(zeta) + math.sqrt(1.0 + zeta * zeta))
                c = 1.0 / math.sqrt(1.0 + tangent * tangent)
                s = c * tangent
                for k in range(4):
                    a, b = system[k, p], system[k, q]
                    system[k, p], system[k, q] = c * a - s * b, s * a + c * b
                    a, b = turned[k, p], turned[k, q]
                    turned[k, p], turned[k, q] = c * a - s * b, s * a + c * b
        if settled:
            break
    least, shortest = 0, np.inf
    for q in range(4):
        length = 0.0
        for k in range(4):
            length += system[k, q] * system[k, q]
        if length < shortest:
            least, shortest = q, length
    return turned[0, least], turned[1, least], turned[2, least], turned[3, least]


@compiled
def judge_points(
    points: Any, a_from_world: Any, b_from_world: Any, pixels_a: Any, pixels_b: Any, intrinsics: Any,
    errors_a: Any, errors_b: Any, depths_a: Any, depths_b: Any, cosines: Any,
) -> None:  # fmt: skip
    """Fill in squared reprojection errors, depths and the cosine between the two rays of each point (N, 3)."""
    fx, fy, cx, cy = intrinsics
    a, b = a_from_world, b_from_world
    center_a = -(a[:3, 3].copy() @ a[:3, :3].copy())
    center_b = -(b[:3, 3].copy() @ b[:3, :3].copy())
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        depths_a[i] = a[2, 0] * x + a[2, 1] * y + a[2, 2] * z + a[2, 3]
        depths_b[i] = b[2, 0] * x + b[2, 1] * y + b[2, 2] * z + b[2, 3]
        za = depths_a[i] if depths_a[i] != 0.0 else 1e-12
        zb = depths_b[i] if depths_b[i] != 0.0 else 1e-12
        ua = fx * (a[0, 0] * x + a[0, 1] * y + a[0, 2] * z + a[0, 3]) / za + cx - pixels_a[i, 0]
        va = fy * (a[1, 0] * x + a[1, 1] * y + a[1, 2] * z + a[1, 3]) / za + cy - pixels_a[i, 1]
        ub = fx * (b[0, 0] * x + b[0, 1] * y + b[0, 2] * z + b[0, 3]) / zb + cx - pixels_b[i, 0]
        vb = fy * (b[1, 0] * x + b[1, 1] * y + b[1, 2] * z + b[1, 3]) / zb + cy - pixels_b[i, 1]
        errors_a[i], errors_b[i] = ua * ua + va * va, ub * ub + vb * vb
        xa, ya, wa = x - center_a[0], y - center_a[1], z - center_a[2]
        xb, yb, wb = x - center_b[0], y - center_b[1], z - center_b[2]
        norm = math.sqrt((xa * xa + ya * ya + wa * wa) * (xb * xb + yb * yb + wb * wb))
        cosines[i] = (xa * xb + ya * yb + wa * wb) / norm if norm > 0.0 else 1.0


class TwoViewPoints:
    """Points triangulated from two views, with their errors, depths and parallax.

    `points` (N, 3) in the world; `errors_a`, `errors_b` squared reprojection errors, px^2; `depths_a`, `depths_b`;
    `cosines` between the two rays; (N,) each. Points at infinity have depth -1 and cosine 1.
    """

    def __init__(
        self, a_from_world: Floats, b_from_world: Floats, pixels_a: Floats, pixels_b: Floats, intrinsics: Floats
    ) -> None:
        points = triangulate(a_from_world, b_from_world, pixels_a, pixels_b, intrinsics)
        far = ~np.isfinite(points).all(axis=1)
        points[far] = 0.0
        self.points: Floats = points
        self.errors_a, self.errors_b, self.depths_a, self.depths_b, self.cosines = np.empty((5, len(points)))
        judge_points(
            points, np.ascontiguousarray(a_from_world), np.ascontiguousarray(b_from_world), pixels_a, pixels_b,
            intrinsics, self.errors_a, self.errors_b, self.depths_a, self.depths_b, self.cosines,
        )  # fmt: skip
        self.depths_a[far] = self.depths_b[far] = -1.0
        self.cosines[far] = 1.0
