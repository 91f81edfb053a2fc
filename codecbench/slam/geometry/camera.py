"""The camera model: pinhole with Brown-Conrady or rational distortion, or equidistant fisheye."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from codecbench.slam.geometry.distortion import (
    distort_brown,
    distort_fisheye,
    distort_rational,
    undistort_brown,
    undistort_fisheye,
    undistort_rational,
)
from codecbench.slam.thresholds import FISHEYE_ANGLE_DEG

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Camera:
    """A pinhole camera with Brown-Conrady or rational distortion, or a fisheye.

    Raises ValueError for sizes below 1, focal lengths not above 0 and numbers that are not finite. Source: Brown,
    Photometric Engineering 37(8), 1971, in OpenCV's order of coefficients; distortion.py has those of the other models.
    """

    width: int
    """Pixels."""
    height: int
    """Pixels."""
    fx: float
    """Focal length, pixels."""
    fy: float
    """Focal length, pixels."""
    cx: float
    """Principal point, pixels; pixel centers are at integers."""
    cy: float
    """Principal point, pixels."""
    distortion: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """k1, k2, p1, p2, k3, and k4, k5, k6 of a rational lens; k1, k2, k3, k4 of a fisheye. Missing ones are 0."""
    model: Literal["pinhole", "equidistant"] = "pinhole"
    """The fisheye is "equidistant"."""

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1:
            raise ValueError(f"Camera: size {self.width}x{self.height} has a side below 1")
        numbers = (self.fx, self.fy, self.cx, self.cy, *self.distortion)
        if not all(math.isfinite(number) for number in numbers):
            raise ValueError(f"Camera: calibration {numbers} has a number that is not finite")
        if self.fx <= 0.0 or self.fy <= 0.0:
            raise ValueError(f"Camera: focal lengths {self.fx}, {self.fy} are not above 0")
        if len(self.distortion) > 8:
            raise ValueError(f"Camera: {len(self.distortion)} distortion coefficients; k1, k2, p1, p2, k3..k6 are read")
        padded = tuple(float(k) for k in self.distortion) + (0.0,) * (8 - len(self.distortion))
        padded = padded if any(padded[5:]) else padded[:5]
        object.__setattr__(self, "distortion", padded)

    @cached_property
    def intrinsics(self) -> Floats:
        """fx, fy, cx, cy as an array (4,)."""
        return np.array([self.fx, self.fy, self.cx, self.cy])

    @cached_property
    def matrix(self) -> Floats:
        """The calibration matrix K (3, 3)."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def pixels_across(self, angle_deg: float) -> float:
        """Return how many pixels in the middle of the image cover a small angle, degrees."""
        return math.radians(angle_deg) * math.sqrt(self.fx * self.fy)

    @property
    def is_distorted(self) -> bool:
        return self.is_fisheye or any(k != 0.0 for k in self.distortion)

    @property
    def is_fisheye(self) -> bool:
        return self.model == "equidistant"

    @property
    def is_rational(self) -> bool:
        return not self.is_fisheye and len(self.distortion) > 5

    @property
    def has_blind_pixels(self) -> bool:
        """Whether `undistort` may give NaN for some pixels."""
        return self.is_fisheye or self.is_rational

    @cached_property
    def bounds(self) -> Floats:
        """x_min, y_min, x_max, y_max of the undistorted image (4,), pixels."""
        if not self.is_distorted:
            return np.array([0.0, 0.0, self.width - 1.0, self.height - 1.0])
        columns = np.linspace(0.0, self.width - 1.0, 33)
        rows = np.linspace(0.0, self.height - 1.0, 33)
        x, y = np.meshgrid(columns, rows)
        pixels = self.undistort(np.stack([x.ravel(), y.ravel()], axis=1))
        pixels = pixels[np.isfinite(pixels).all(axis=1)]
        return np.concatenate([pixels.min(axis=0), pixels.max(axis=0)])

    def undistort(self, pixels: Floats) -> Floats:
        """Return where `pixels` (N, 2) would lie without distortion (N, 2); NaN for blind pixels."""
        pixels = np.ascontiguousarray(pixels, dtype=np.float64)
        if self.is_fisheye:
            widest_rad = math.radians(FISHEYE_ANGLE_DEG)
            return undistort_fisheye(pixels, self.intrinsics, np.array(self.distortion), widest_rad)
        if self.is_rational:
            return undistort_rational(pixels, self.intrinsics, np.array(self.distortion))
        if not self.is_distorted:
            return pixels.copy()
        return np.asarray(undistort_brown(pixels, self.intrinsics, np.array(self.distortion)))

    def distort(self, pixels: Floats) -> Floats:
        """Return where undistorted `pixels` (N, 2) lie in the image as taken (N, 2)."""
        pixels = np.ascontiguousarray(pixels, dtype=np.float64)
        if self.is_fisheye:
            return distort_fisheye(pixels, self.intrinsics, np.array(self.distortion))
        if self.is_rational:
            return distort_rational(pixels, self.intrinsics, np.array(self.distortion))
        return np.asarray(distort_brown(pixels, self.intrinsics, np.array(self.distortion)))

    def project(self, points_camera: Floats) -> Floats:
        """Return the undistorted pixels (N, 2) of `points_camera` (N, 3)."""
        scaled = points_camera[:, :2] / points_camera[:, 2:]
        return np.asarray(scaled * self.intrinsics[:2] + self.intrinsics[2:])

    def rays(self, pixels: Floats) -> Floats:
        """Return the directions (N, 3), of depth 1, of undistorted `pixels` (N, 2)."""
        return np.asarray(np.column_stack([pixels, np.ones(len(pixels))]) @ np.linalg.inv(self.matrix).T)
