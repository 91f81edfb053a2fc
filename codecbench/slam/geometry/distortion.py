"""Lens distortion: Brown-Conrady, OpenCV's rational model, and the equidistant fisheye.

In the rational model, a ray at radius r falls (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6) times as
far out; p1 and p2 move it tangentially as in Brown's model. Source: OpenCV, "Camera Calibration and 3D Reconstruction".

In the fisheye model, a ray at the angle theta from the axis falls at the radius
theta (1 + k1 theta^2 + k2 theta^4 + k3 theta^6 + k4 theta^8) focal lengths from the principal point, in its own
direction. Source: Kannala, Brandt, IEEE TPAMI 28(8), 2006, doi:10.1109/TPAMI.2006.153, with the four coefficients that
OpenCV and ROS keep.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from codecbench.core.kernels.compiled import compiled

Floats = NDArray[np.float64]
_RATIONAL_STEPS = 30
_RATIONAL_TOLERANCE = 1e-10
_FISHEYE_STEPS = 20
_FISHEYE_TOLERANCE_RAD = 1e-10

# Brown-Conrady -----------------------------------------------------------------------------------------------------


@compiled
def _distort_normalized(x: float, y: float, k: Any) -> Any:
    """Return distorted normalized coordinates, and the Jacobian of x_d, y_d by x, y."""
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))
    slope = 2.0 * (k[0] + r2 * (2.0 * k[1] + 3.0 * r2 * k[4]))  # d radial / d(r2 / 2): times x or y
    xd = x * radial + 2.0 * k[2] * x * y + k[3] * (r2 + 2.0 * x * x)
    yd = y * radial + k[2] * (r2 + 2.0 * y * y) + 2.0 * k[3] * x * y
    xx = radial + x * slope * x + 2.0 * k[2] * y + 6.0 * k[3] * x
    xy = x * slope * y + 2.0 * k[2] * x + 2.0 * k[3] * y
    yy = radial + y * slope * y + 6.0 * k[2] * y + 2.0 * k[3] * x
    return xd, yd, xx, xy, yy


@compiled
def distort_brown(pixels: Any, intrinsics: Any, k: Any) -> Any:
    """Return where undistorted `pixels` (N, 2) lie in the image as taken; `k` (5,): k1, k2, p1, p2, k3."""
    fx, fy, cx, cy = intrinsics
    distorted = np.empty_like(pixels)
    for i in range(len(pixels)):
        xd, yd, _, _, _ = _distort_normalized((pixels[i, 0] - cx) / fx, (pixels[i, 1] - cy) / fy, k)
        distorted[i, 0] = xd * fx + cx
        distorted[i, 1] = yd * fy + cy
    return distorted


@compiled
def undistort_brown(pixels: Any, intrinsics: Any, k: Any) -> Any:
    """Return where `pixels` (N, 2) would lie without distortion; `k` (5,): k1, k2, p1, p2, k3.

    Newton's method on the distortion; 20 steps are ample, most pixels need four.
    """
    fx, fy, cx, cy = intrinsics
    undistorted = np.empty_like(pixels)
    for i in range(len(pixels)):
        target_x = (pixels[i, 0] - cx) / fx
        target_y = (pixels[i, 1] - cy) / fy
        x, y = target_x, target_y
        for _ in range(20):
            xd, yd, xx, xy, yy = _distort_normalized(x, y, k)
            ex, ey = xd - target_x, yd - target_y
            determinant = xx * yy - xy * xy
            if ex * ex + ey * ey < 1e-24 or abs(determinant) < 1e-9:
                break
            x -= (yy * ex - xy * ey) / determinant
            y -= (xx * ey - xy * ex) / determinant
        undistorted[i, 0] = x * fx + cx
        undistorted[i, 1] = y * fy + cy
    return undistorted


# Rational ----------------------------------------------------------------------------------------------------------


def undistort_rational(pixels: Floats, intrinsics: Floats, k: Floats) -> Floats:
    """Return where `pixels` (N, 2) would lie without distortion; `k` (8,): k1, k2, p1, p2, k3, k4, k5, k6.

    NaN if no ray falls on a pixel. Newton's method from where the ray would be without distortion.
    """
    target = ((pixels - intrinsics[2:]) / intrinsics[:2]).T
    x, y = target
    with np.errstate(all="ignore"):
        for _ in range(_RATIONAL_STEPS):
            (reached_x, reached_y), (xx, xy, yy) = _distort_rational_normalized(x, y, k)
            off_x, off_y = reached_x - target[0], reached_y - target[1]
            determinant = xx * yy - xy * xy
            x, y = x - (yy * off_x - xy * off_y) / determinant, y - (xx * off_y - xy * off_x) / determinant
        (reached_x, reached_y), (xx, xy, yy) = _distort_rational_normalized(x, y, k)
        converged = np.hypot(reached_x - target[0], reached_y - target[1]) < _RATIONAL_TOLERANCE
        converged &= (xx > 0.0) & (xx * yy > xy * xy)  # not beyond a fold
    undistorted = np.where(converged[:, None], np.stack([x, y], axis=1), np.nan)
    return np.asarray(undistorted * intrinsics[:2] + intrinsics[2:])


def distort_rational(pixels: Floats, intrinsics: Floats, k: Floats) -> Floats:
    """Return where undistorted `pixels` (N, 2) lie in the image as taken (N, 2)."""
    x, y = ((pixels - intrinsics[2:]) / intrinsics[:2]).T
    (taken_x, taken_y), _ = _distort_rational_normalized(x, y, k)
    return np.asarray(np.stack([taken_x, taken_y], axis=1) * intrinsics[:2] + intrinsics[2:])


def _distort_rational_normalized(
    x: Floats, y: Floats, k: Floats
) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats, Floats]]:
    """Return distorted coordinates in focal lengths, and their symmetric Jacobian: xx, xy, yy."""
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


# Fisheye -----------------------------------------------------------------------------------------------------------


def undistort_fisheye(pixels: Floats, intrinsics: Floats, k: Floats, widest_rad: float) -> Floats:
    """Return where `pixels` (N, 2) would lie in a pinhole image of the same `intrinsics` (4,); `k` (4,).

    NaN if no ray within `widest_rad` of the axis falls on a pixel. Newton's method on the angle.
    """
    scaled = (pixels - intrinsics[2:]) / intrinsics[:2]
    radius = np.hypot(scaled[:, 0], scaled[:, 1])
    theta = np.minimum(radius, widest_rad)
    for _ in range(_FISHEYE_STEPS):
        reached, slope = _radius_and_slope(theta, k)
        theta = np.clip(theta - (reached - radius) / np.where(slope > 0.0, slope, 1.0), 0.0, widest_rad)
    reached, slope = _radius_and_slope(theta, k)
    converged = (np.abs(reached - radius) < _FISHEYE_TOLERANCE_RAD) & (slope > 0.0)
    ratio = np.where(radius > 0.0, np.tan(theta) / np.where(radius > 0.0, radius, 1.0), 1.0)
    ratio = np.where(converged, ratio, np.nan)
    return np.asarray(scaled * ratio[:, None] * intrinsics[:2] + intrinsics[2:])


def distort_fisheye(pixels: Floats, intrinsics: Floats, k: Floats) -> Floats:
    """Return where pinhole `pixels` (N, 2) lie in the image as taken (N, 2)."""
    scaled = (pixels - intrinsics[2:]) / intrinsics[:2]
    tangent = np.hypot(scaled[:, 0], scaled[:, 1])
    reached, _ = _radius_and_slope(np.arctan(tangent), k)
    ratio = np.where(tangent > 0.0, reached / np.where(tangent > 0.0, tangent, 1.0), 1.0)
    return np.asarray(scaled * ratio[:, None] * intrinsics[:2] + intrinsics[2:])


def _radius_and_slope(theta: Floats, k: Floats) -> tuple[Floats, Floats]:
    """Return the radius in focal lengths, and its derivative by the angle."""
    t = theta * theta
    radius = theta * (1.0 + t * (k[0] + t * (k[1] + t * (k[2] + t * k[3]))))
    slope = 1.0 + t * (3.0 * k[0] + t * (5.0 * k[1] + t * (7.0 * k[2] + t * 9.0 * k[3])))
    return radius, slope
