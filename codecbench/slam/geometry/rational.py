"""Lenses whose radial distortion is a ratio of two polynomials, as OpenCV's rational model has it.

A ray at the radius r falls (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6) times as far out, and is
moved by the tangential p1 and p2 as in the model of Brown. Source: OpenCV, "Camera Calibration and 3D Reconstruction".
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
_STEPS = 30
_EXACT = 1e-10


def undistort_rational(pixels: Floats, intrinsics: Floats, k: Floats) -> Floats:
    """Where `pixels` (N, 2) would lie without distortion; `k` (8,): k1, k2, p1, p2, k3, k4, k5, k6.

    NaN for those that no ray is found for. Newton's method from where the ray would be without distortion.
    """
    target = ((pixels - intrinsics[2:]) / intrinsics[:2]).T
    x, y = target
    with np.errstate(all="ignore"):
        for _ in range(_STEPS):
            (reached_x, reached_y), (xx, xy, yy) = _distorted(x, y, k)
            off_x, off_y = reached_x - target[0], reached_y - target[1]
            determinant = xx * yy - xy * xy
            x, y = x - (yy * off_x - xy * off_y) / determinant, y - (xx * off_y - xy * off_x) / determinant
        (reached_x, reached_y), (xx, xy, yy) = _distorted(x, y, k)
        found = np.hypot(reached_x - target[0], reached_y - target[1]) < _EXACT
        found &= (xx > 0.0) & (xx * yy > xy * xy)  # not beyond a fold
    straight = np.where(found[:, None], np.stack([x, y], axis=1), np.nan)
    return np.asarray(straight * intrinsics[:2] + intrinsics[2:])


def distort_rational(pixels: Floats, intrinsics: Floats, k: Floats) -> Floats:
    """Where undistorted `pixels` (N, 2) lie in the image as taken (N, 2)."""
    x, y = ((pixels - intrinsics[2:]) / intrinsics[:2]).T
    (taken_x, taken_y), _ = _distorted(x, y, k)
    return np.asarray(np.stack([taken_x, taken_y], axis=1) * intrinsics[:2] + intrinsics[2:])


def _distorted(x: Floats, y: Floats, k: Floats) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats, Floats]]:
    """Distorted coordinates in focal lengths, and their symmetric Jacobian: xx, xy, yy."""
    k1, k2, p1, p2, k3, k4, k5, k6 = k
    r2 = x * x + y * y
    above, below = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)), 1.0 + r2 * (k4 + r2 * (k5 + r2 * k6))
    above_slope, below_slope = k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3), k4 + r2 * (2.0 * k5 + 3.0 * r2 * k6)
    radial = above / below
    slope = 2.0 * (above_slope - radial * below_slope) / below  # by r^2 / 2: times x or y
    distorted_x = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    distorted_y = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    xx = radial + x * slope * x + 2.0 * p1 * y + 6.0 * p2 * x
    xy = x * slope * y + 2.0 * p1 * x + 2.0 * p2 * y
    yy = radial + y * slope * y + 6.0 * p1 * y + 2.0 * p2 * x
    return (distorted_x, distorted_y), (xx, xy, yy)
