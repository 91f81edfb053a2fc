"""Fisheye lenses: the equidistant projection of Kannala and Brandt.

A ray at the angle theta from the axis falls at the radius theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8)
focal lengths from the principal point, in its own direction. Source: Kannala, Brandt, IEEE TPAMI 28(8), 2006,
doi:10.1109/TPAMI.2006.153, with the four coefficients that OpenCV and ROS keep.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
_STEPS = 20
_EXACT_RAD = 1e-10


def undistort_fisheye(pixels: Floats, intrinsics: Floats, k: Floats, widest_rad: float) -> Floats:
    """Where `pixels` (N, 2) would lie in a pinhole image of the same `intrinsics` (4,); `k` (4,).

    NaN for those that no ray within `widest_rad` of the axis falls on. Newton's method on the angle.
    """
    scaled = (pixels - intrinsics[2:]) / intrinsics[:2]
    radius = np.hypot(scaled[:, 0], scaled[:, 1])
    theta = np.minimum(radius, widest_rad)
    for _ in range(_STEPS):
        reached, slope = _radius_and_slope(theta, k)
        theta = np.clip(theta - (reached - radius) / np.where(slope > 0.0, slope, 1.0), 0.0, widest_rad)
    reached, slope = _radius_and_slope(theta, k)
    seen = (np.abs(reached - radius) < _EXACT_RAD) & (slope > 0.0)
    ratio = np.where(radius > 0.0, np.tan(theta) / np.where(radius > 0.0, radius, 1.0), 1.0)
    ratio = np.where(seen, ratio, np.nan)
    return np.asarray(scaled * ratio[:, None] * intrinsics[:2] + intrinsics[2:])


def distort_fisheye(pixels: Floats, intrinsics: Floats, k: Floats) -> Floats:
    """Where pinhole `pixels` (N, 2) lie in the image as taken (N, 2)."""
    scaled = (pixels - intrinsics[2:]) / intrinsics[:2]
    tangent = np.hypot(scaled[:, 0], scaled[:, 1])
    reached, _ = _radius_and_slope(np.arctan(tangent), k)
    ratio = np.where(tangent > 0.0, reached / np.where(tangent > 0.0, tangent, 1.0), 1.0)
    return np.asarray(scaled * ratio[:, None] * intrinsics[:2] + intrinsics[2:])


def _radius_and_slope(theta: Floats, k: Floats) -> tuple[Floats, Floats]:
    """The radius in focal lengths, and its derivative by the angle."""
    t = theta * theta
    radius = theta * (1.0 + t * (k[0] + t * (k[1] + t * (k[2] + t * k[3]))))
    slope = 1.0 + t * (3.0 * k[0] + t * (5.0 * k[1] + t * (7.0 * k[2] + t * 9.0 * k[3])))
    return radius, slope
