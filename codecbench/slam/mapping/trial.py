"""The trial of a young map: it must explain the next frames far better than a camera that only turns."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from codecbench.slam import thresholds
from codecbench.slam.geometry.camera import Camera
from codecbench.slam.geometry.two_view import fit_rotation, fundamental_between
from codecbench.slam.map.frame import TrackingFrame
from codecbench.slam.map.map import Map
from codecbench.slam.mapping.initialization import match_for_initialization

Floats = NDArray[np.float64]


class Trial:
    """Compares a young map's misfit with that of a rotation, on each frame's matches with the first keyframe.

    A false start agrees with the two frames that it was made of, but not with those that follow. The trial is passed
    after TRIAL_FRAMES, or as soon as a frame shows fewer than INIT_MIN_MATCHES features of the first keyframe.
    """

    def __init__(self, slam_map: Map, camera: Camera, rng: np.random.Generator) -> None:
        self._map = slam_map
        self._camera = camera
        self._rng = rng.spawn(1)[0]  # leaves the random draws of others unchanged
        self._frames_left = thresholds.TRIAL_FRAMES
        self._map_misfit = self._rotation_misfit = 0.0  # of all frames so far

    def rejection_reason(self, frame: TrackingFrame) -> str:
        """Return why the map is to be dropped, by `frame`, tracked in it, and those before; empty if it may stay."""
        if self._frames_left == 0:
            return ""
        self._frames_left -= 1
        first = self._map.keyframes.features[0]
        matches = match_for_initialization(first, frame.features, self._camera)
        seen = np.nonzero(matches >= 0)[0]
        if len(seen) < thresholds.INIT_MIN_MATCHES:
            self.end()
            return ""
        pixels_a = first.pixels[seen].astype(np.float64)
        pixels_b = frame.features.pixels[matches[seen]].astype(np.float64)
        variances = self._map.pixel_variances[first.octaves[seen]]
        self._map_misfit += _capped_misfit(self._squares_by_map(seen, frame, pixels_a, pixels_b), variances)
        self._rotation_misfit += _misfit_of_rotation(pixels_a, pixels_b, variances, self._camera, self._rng)
        if self._map_misfit <= thresholds.TRIAL_MISFIT * self._rotation_misfit:
            return ""
        share = self._map_misfit / max(self._rotation_misfit, 1e-12)
        return f"the map leaves {100.0 * share:.0f} % of a rotation's misfit of the matches with its first frame"

    def end(self) -> None:
        """End the trial: the map stays."""
        self._frames_left = 0

    def _squares_by_map(
        self, seen: NDArray[np.int64], frame: TrackingFrame, pixels_a: Floats, pixels_b: Floats
    ) -> Floats:
        """Return squared distances (N,), px^2, of matches from where the map has their point.

        For a match without a point, the distance is that from its epipolar line.
        """
        keyframes = self._map.keyframes
        matrix, pose = self._camera.matrix, frame.camera_from_world
        fundamental, _ = fundamental_between(keyframes.camera_from_world[0], pose, matrix)
        squares = _line_squares(fundamental, pixels_a, pixels_b)
        points = keyframes.points[0][seen]
        has_point = points >= 0
        in_camera = self._map.points.positions[points[has_point]] @ pose[:3, :3].T + pose[:3, 3]
        squares[has_point] = _pixel_squares(in_camera @ matrix.T, pixels_b[has_point])
        return squares


def _capped_misfit(squares: Floats, variances: Floats) -> float:
    """Return the sum of chi-squares, none of which counts more than the gate of an outlier."""
    return float(np.minimum(squares / variances, thresholds.CHI2_95_2DOF).sum())


def _misfit_of_rotation(
    pixels_a: Floats, pixels_b: Floats, variances: Floats, camera: Camera, rng: np.random.Generator
) -> float:
    """Return the least misfit of matches (N, 2) under a rotation of the camera, by RANSAC on pairs of them."""
    rays_a, rays_b = (
        rays / np.linalg.norm(rays, axis=1, keepdims=True) for rays in (camera.rays(pixels_a), camera.rays(pixels_b))
    )
    least = np.inf
    for chosen in rng.integers(0, len(pixels_a), (thresholds.TRIAL_RANSAC_ITERATIONS, 2)):
        while len(chosen) > 1:
            rotation = fit_rotation(rays_a[chosen], rays_b[chosen])
            squares = _pixel_squares(rays_a @ rotation.T @ camera.matrix.T, pixels_b)
            misfit = _capped_misfit(squares, variances)
            if misfit >= least:
                break
            least, chosen = misfit, np.nonzero(squares < thresholds.CHI2_95_2DOF * variances)[0]
    return float(least)


def _pixel_squares(homogeneous: Floats, pixels: Floats) -> Floats:
    """Return squared distances (N,), px^2, of `pixels` (N, 2) from projections of (N, 3); infinite behind."""
    ahead = homogeneous[:, 2:] > 0.0
    seen = homogeneous[:, :2] / np.where(ahead, homogeneous[:, 2:], 1.0)
    return np.where(ahead[:, 0], ((seen - pixels) ** 2).sum(axis=1), np.inf)


def _line_squares(fundamental: Floats, pixels_a: Floats, pixels_b: Floats) -> Floats:
    """Return squared distances (N,), px^2, of `pixels_b` (N, 2) from the epipolar lines of `pixels_a` (N, 2)."""
    lines = np.column_stack([pixels_a, np.ones(len(pixels_a))]) @ fundamental.T
    distances = (lines[:, :2] * pixels_b).sum(axis=1) + lines[:, 2]
    return np.asarray(distances**2 / np.maximum((lines[:, :2] ** 2).sum(axis=1), 1e-300))
