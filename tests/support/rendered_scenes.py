"""Scenes with known answers for the SLAM tests: points before two cameras, and a textured room to be filmed."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from codecbench.slam.features.extractor import CELL_PX, Features
from codecbench.slam.features.orb_kernels import index_cells
from codecbench.slam.geometry.camera import Camera
from codecbench.slam.geometry.transforms import se3_exp

Floats = NDArray[np.float64]

CAMERA = Camera(320, 240, 260.0, 262.0, 158.5, 121.0)


def looking(position: tuple[float, float, float], yaw: float = 0.0, pitch: float = 0.0) -> Floats:
    """camera_from_world of a camera at `position` turned by `yaw` and `pitch` radians from the z axis; y is down."""
    cy, sy, cp, sp = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch)
    turn_yaw = np.array([[cy, 0.0, sy], [0.0, 1.0, 0.0], [-sy, 0.0, cy]])
    turn_pitch = np.array([[1.0, 0.0, 0.0], [0.0, cp, -sp], [0.0, sp, cp]])
    world_from_camera = np.eye(4)
    world_from_camera[:3, :3] = turn_yaw @ turn_pitch
    world_from_camera[:3, 3] = position
    return np.linalg.inv(world_from_camera)


def path_pose(step: float) -> Floats:
    """A walk sideways and forwards through the room, looking about."""
    t = step / 30.0
    return looking((-1.5 + 1.1 * t, 0.15 * np.sin(3.0 * t), -1.5 + 0.3 * t), 0.15 * np.sin(2.0 * t), 0.1)


@dataclass(frozen=True)
class TwoViews:
    """Points (N, 3) in camera a, `b_from_a`, and the pixels (N, 2) of both."""

    points: Floats
    b_from_a: Floats
    pixels_a: Floats
    pixels_b: Floats


def two_views(
    rng: np.random.Generator, count: int = 300, planar: bool = False, noise_px: float = 0.0, baseline: float = 0.4
) -> TwoViews:
    """Two views of points 3 to 8 in front of the camera, or on a slanted plane."""
    pixels = rng.uniform([20.0, 20.0], [300.0, 220.0], (count, 2))
    rays = np.column_stack([(pixels - CAMERA.intrinsics[2:]) / CAMERA.intrinsics[:2], np.ones(count)])
    depths = 5.0 / (1.0 + 0.1 * rays[:, 0] + 0.2 * rays[:, 1]) if planar else rng.uniform(3.0, 8.0, count)
    points = rays * depths[:, None]
    # Of the two motions that a plane allows, this one leaves the other with points behind it.
    motion = [1.5, 0.03, -0.3] if planar else [-baseline, 0.03, 0.1]
    b_from_a = np.asarray(se3_exp(np.array([*motion, 0.02, -0.05, 0.01])))
    in_b = points @ b_from_a[:3, :3].T + b_from_a[:3, 3]
    noise = rng.normal(0.0, noise_px, (2, count, 2)) if noise_px else np.zeros((2, count, 2))
    return TwoViews(points, b_from_a, pixels + noise[0], CAMERA.project(in_b) + noise[1])


def features_at(pixels: Floats, descriptors: NDArray[np.uint64], octaves: NDArray[np.int32] | None = None) -> Features:
    """Features at given places with given descriptors, all upright."""
    grid = np.array([0.0, 0.0, np.ceil(CAMERA.width / CELL_PX), np.ceil(CAMERA.height / CELL_PX)])
    starts, members = index_cells(pixels, grid, CELL_PX)
    levels = np.zeros(len(pixels), np.int32) if octaves is None else octaves
    return Features(pixels.copy(), levels, np.zeros(len(pixels)), descriptors.copy(), starts, members, grid)


def random_descriptors(rng: np.random.Generator, count: int) -> NDArray[np.uint64]:
    return rng.integers(0, 2**64, (count, 4), dtype=np.uint64)


class Room:
    """A square room with textured walls and floor, 8 units wide and 3 high, filmed from inside."""

    def __init__(self, seed: int = 3, size: float = 8.0) -> None:
        rng = np.random.default_rng(seed)
        half, high = size / 2.0, 1.5
        corners = [(-half, -half), (half, -half), (half, half), (-half, half)]
        self._faces: list[tuple[Floats, NDArray[np.uint8]]] = []
        for (x0, z0), (x1, z1) in zip(corners, corners[1:] + corners[:1], strict=True):
            wall = np.array([[x0, -high, z0], [x1, -high, z1], [x1, high, z1], [x0, high, z0]])
            self._faces.append((wall, _texture(rng, 1200, 450)))
        floor = np.array([[x, high, z] for x, z in corners])
        self._faces.append((floor, _texture(rng, 1200, 1200)))

    def image(self, camera_from_world: Floats, camera: Camera = CAMERA) -> NDArray[np.uint8]:
        """What the camera sees: each pixel's ray is cut with every face, the nearest in front wins."""
        x, y = np.meshgrid(np.arange(camera.width, dtype=np.float64), np.arange(camera.height, dtype=np.float64))
        rays = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones_like(x)], axis=-1)
        world_from_camera = np.linalg.inv(camera_from_world)
        rays = rays @ world_from_camera[:3, :3].T
        origin = world_from_camera[:3, 3]
        nearest = np.full(x.shape, np.inf)
        image = np.full(x.shape, 90, np.uint8)
        for corners, texture in self._faces:
            side, down = corners[1] - corners[0], corners[3] - corners[0]
            normal = np.cross(side, down)
            with np.errstate(divide="ignore", invalid="ignore"):
                distance = ((corners[0] - origin) @ normal) / (rays @ normal)
                hit = origin + rays * distance[..., None] - corners[0]
            u, v = hit @ side / (side @ side), hit @ down / (down @ down)
            seen = (distance > 1e-6) & (distance < nearest) & (u >= 0) & (u <= 1) & (v >= 0) & (v <= 1)
            maps = [
                np.where(seen, s * (n - 1), -1.0).astype(np.float32)
                for s, n in ((u, texture.shape[1]), (v, texture.shape[0]))
            ]
            painted = cv2.remap(texture, maps[0], maps[1], cv2.INTER_LINEAR)
            image[seen] = painted[seen]
            nearest[seen] = distance[seen]
        return image


def _texture(rng: np.random.Generator, width: int, height: int) -> NDArray[np.uint8]:
    """Overlapping rectangles of many sizes: corners at every scale."""
    texture = np.full((height, width), 110, np.uint8)
    for _ in range(width * height // 700):
        w, h = (rng.gamma(1.3, 14.0, 2) + 4).astype(int)
        x, y = int(rng.integers(-10, width)), int(rng.integers(-10, height))
        cv2.rectangle(texture, (x, y), (x + int(w), y + int(h)), int(rng.integers(20, 235)), -1)
    # Half as fine as it was painted, about a texel a pixel from where the camera is: finer ones would flicker.
    return np.asarray(cv2.resize(texture, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def position_error(estimated: Floats, true: Floats) -> float:
    """Root mean square distance (N, 3) to (N, 3) after the best similarity (Umeyama's, by scipy's rotation fit)."""
    a, b = true - true.mean(axis=0), estimated - estimated.mean(axis=0)
    u, s, vt = np.linalg.svd(a.T @ b)
    signs = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    scale = float((s * signs).sum() / (b**2).sum())
    aligned = scale * b @ (u * signs @ vt).T
    return float(np.sqrt(((aligned - a) ** 2).sum(axis=1).mean()))
