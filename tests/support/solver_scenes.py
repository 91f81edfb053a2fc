"""Cameras, points and what the cameras see of them, with the answer known."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from codecbench.slam.geometry.rotations import so3_exp
from codecbench.slam.geometry.transforms import se3_exp

INTRINSICS = np.array([520.0, 510.0, 320.0, 240.0])


@dataclass(frozen=True)
class Scene:
    """Arguments of a bundle adjustment; the true values, or a guess of them."""

    camera_from_world: NDArray[np.float64]
    points_world: NDArray[np.float64]
    camera_indices: NDArray[np.int64]
    point_indices: NDArray[np.int64]
    pixels: NDArray[np.float64]
    inverse_sigma2: NDArray[np.float64]
    intrinsics: NDArray[np.float64]
    fixed: NDArray[np.bool_]

    def arguments(self) -> tuple[Any, ...]:
        return tuple(vars(self).values())

    def with_(self, **changes: Any) -> Scene:
        return replace(self, **changes)


def project(points_camera: NDArray[np.float64]) -> NDArray[np.float64]:
    """Pixels (N, 2) of points (N, 3) in the camera's frame."""
    return points_camera[:, :2] / points_camera[:, 2:] * INTRINSICS[:2] + INTRINSICS[2:]


def moved(motion: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points (N, 3) after a (4, 4) rigid motion or similarity."""
    return points @ motion[:3, :3].T + motion[:3, 3]


def similarity_from_tangent(tangent: tuple[float, ...]) -> NDArray[np.float64]:
    """The (4, 4) similarity of a tangent vector (v, w, sigma), as the exponential of a matrix; compiles nothing."""
    x, y, z, a, b, c, sigma = tangent
    return np.asarray(expm(np.array([[sigma, -c, b, x], [c, sigma, -a, y], [-b, a, sigma, z], [0.0, 0.0, 0.0, 0.0]])))


def corridor(rng: np.random.Generator, cameras: int, points: int, observations: int, noise_px: float = 0.0) -> Scene:
    """Cameras that move sideways past a band of points, each seen by the few cameras nearest to it; two are fixed."""
    poses = np.tile(np.eye(4), (cameras, 1, 1))
    for k in range(cameras):
        rotation = so3_exp(rng.normal(0.0, 0.05, 3))
        poses[k, :3, :3] = rotation
        poses[k, :3, 3] = -rotation @ np.array([0.3 * k, 0.05 * np.sin(k), 0.0])
    places = rng.uniform(0.0, cameras - 1, points)
    band = np.stack([0.3 * places, np.zeros(points), np.zeros(points)], axis=1)
    band += rng.uniform([-0.5, -1.5, 3.0], [0.5, 1.5, 7.0], (points, 3))
    counts = np.clip(rng.poisson(observations / points, points), 2, cameras)
    starts = np.clip(np.round(places - counts / 2), 0, cameras - counts).astype(np.int64)
    point_indices = np.repeat(np.arange(points), counts)
    within = np.arange(len(point_indices)) - np.repeat(np.cumsum(counts) - counts, counts)
    camera_indices = starts[point_indices] + within
    seen = np.einsum("mij,mj->mi", poses[camera_indices, :3, :3], band[point_indices])
    octaves = rng.integers(0, 4, len(camera_indices))
    sigma = 1.2**octaves
    pixels = project(seen + poses[camera_indices, :3, 3])
    pixels += rng.normal(0.0, 1.0, pixels.shape) * noise_px * sigma[:, None]
    shuffled = rng.permutation(len(camera_indices))
    fixed = np.zeros(cameras, dtype=np.bool_)
    fixed[:2] = True
    return Scene(
        poses, band, camera_indices[shuffled], point_indices[shuffled], pixels[shuffled], 1.0 / sigma[shuffled] ** 2,
        INTRINSICS, fixed,
    )  # fmt: skip


def disturbed(
    scene: Scene, rng: np.random.Generator, translation: float = 0.03, angle_rad: float = 0.01, points: float = 0.1
) -> Scene:
    """The scene with the free cameras and all points moved at random."""
    poses = scene.camera_from_world.copy()
    for k in np.flatnonzero(~scene.fixed):
        poses[k] = se3_exp(rng.normal(0.0, [translation] * 3 + [angle_rad] * 3)) @ poses[k]
    return scene.with_(
        camera_from_world=poses, points_world=scene.points_world + rng.normal(0.0, points, scene.points_world.shape)
    )
