"""Two-view geometry: homography, fundamental matrix, and the motions that they allow.

Source of the algorithms: Hartley and Zisserman, "Multiple View Geometry", 2nd edition, chapters 4, 5, 9, 11. Pixels are
undistorted; `b_from_a` maps image or camera a to b.
"""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from codecbench.core.kernels.compiled import compiled
from codecbench.slam.geometry.rotations import skew
from codecbench.slam.geometry.transforms import se3_exp, se3_inverse, sim3_compose
from codecbench.slam.thresholds import CHI2_95_1DOF, CHI2_95_2DOF

Floats = NDArray[np.float64]


@compiled
def normalize_pixels(pixels: Any) -> Any:
    """Return pixels (N, 2) moved to their centroid, at a mean distance of sqrt(2), and the matrix (3, 3) for it."""
    count, x, y, distance = len(pixels), 0.0, 0.0, 0.0
    for i in range(count):
        x += pixels[i, 0]
        y += pixels[i, 1]
    x, y = x / count, y / count
    for i in range(count):
        distance += math.sqrt((pixels[i, 0] - x) * (pixels[i, 0] - x) + (pixels[i, 1] - y) * (pixels[i, 1] - y))
    scale = math.sqrt(2.0) / max(distance / count, 1e-12)
    normalizer, normalized = np.zeros((3, 3)), np.empty_like(pixels)
    normalizer[0, 0] = normalizer[1, 1] = scale
    normalizer[0, 2], normalizer[1, 2], normalizer[2, 2] = -scale * x, -scale * y, 1.0
    for i in range(count):
        normalized[i, 0], normalized[i, 1] = (pixels[i, 0] - x) * scale, (pixels[i, 1] - y) * scale
    return normalized, normalizer


@compiled
def fit_homography(pixels_a: Any, pixels_b: Any) -> Any:
    """Return the homography `b_from_a` (3, 3) of N >= 4 normalized matches (N, 2): direct linear transform."""
    n = len(pixels_a)
    system = np.zeros((max(2 * n, 9), 9))
    for i in range(n):
        x, y, u, v = pixels_a[i, 0], pixels_a[i, 1], pixels_b[i, 0], pixels_b[i, 1]
        system[2 * i, 3], system[2 * i, 4], system[2 * i, 5] = -x, -y, -1.0
        system[2 * i, 6], system[2 * i, 7], system[2 * i, 8] = v * x, v * y, v
        system[2 * i + 1, 0], system[2 * i + 1, 1], system[2 * i + 1, 2] = x, y, 1.0
        system[2 * i + 1, 6], system[2 * i + 1, 7], system[2 * i + 1, 8] = -u * x, -u * y, -u
    return _least_vector(system, 2 * n).reshape((3, 3))


@compiled
def fit_fundamental(pixels_a: Any, pixels_b: Any) -> Any:
    """Return the fundamental matrix (3, 3), x_b' F x_a = 0, of rank two, of N >= 8 normalized matches (N, 2)."""
    n = len(pixels_a)
    system = np.zeros((max(n, 9), 9))
    for i in range(n):
        x, y, u, v = pixels_a[i, 0], pixels_a[i, 1], pixels_b[i, 0], pixels_b[i, 1]
        system[i, 0], system[i, 1], system[i, 2] = u * x, u * y, u
        system[i, 3], system[i, 4], system[i, 5] = v * x, v * y, v
        system[i, 6], system[i, 7], system[i, 8] = x, y, 1.0
    u, s, vt = np.linalg.svd(_least_vector(system, n).reshape((3, 3)), True)
    s[2] = 0.0
    for i in range(3):
        for k in range(3):
            u[i, k] *= s[k]
    return u @ vt


@compiled
def _least_vector(system: Any, equations: int) -> Any:
    """Return the vector (9,) that the first `equations` rows of a system (M, 9) make least for its length.

    Eight equations make it zero, and Gaussian elimination finds it soonest; zeros if they depend on each other. For
    more, the normal equations are decomposed: LAPACK would share a long system out among threads.
    """
    if equations != 8:
        normal = np.zeros((9, 9))
        for i in range(equations):
            for k in range(9):
                for m in range(9):
                    normal[k, m] += system[i, k] * system[i, m]
        return np.linalg.eigh(normal)[1][:, 0].copy()
    order, vector = np.empty(9, np.int64), np.zeros(9)
    for k in range(9):
        order[k] = k
    for k in range(8):
        pivot = k
        for j in range(k + 1, 9):
            if abs(system[k, j]) > abs(system[k, pivot]):
                pivot = j
        order[k], order[pivot] = order[pivot], order[k]
        for i in range(8):
            system[i, k], system[i, pivot] = system[i, pivot], system[i, k]
        if abs(system[k, k]) < 1e-12:
            return vector
        for i in range(k + 1, 8):
            factor = system[i, k] / system[k, k]
            for j in range(k, 9):
                system[i, j] -= factor * system[k, j]
    vector[order[8]] = 1.0
    for k in range(7, -1, -1):
        product = 0.0
        for j in range(k + 1, 9):
            product += system[k, j] * vector[order[j]]
        vector[order[k]] = -product / system[k, k]
    return vector


def fit_rotation(rays_a: Floats, rays_b: Floats) -> Floats:
    """Return the rotation `b_from_a` (3, 3) that best aligns N >= 2 directions (N, 3) (Kabsch 1976)."""
    u, _, vt = np.linalg.svd(rays_b.T @ rays_a)
    return np.asarray(u * [1.0, 1.0, np.sign(np.linalg.det(u @ vt))] @ vt)


@compiled
def score_homography(b_from_a: Any, pixels_a: Any, pixels_b: Any, variances: Any, inliers: Any) -> float:
    """Return ORB-SLAM's score of a homography (equation 2), by symmetric transfer errors; fills `inliers` (N,).

    `variances` (N,) are those of the pixels along each axis, px^2.
    """
    determinant = np.linalg.det(b_from_a)
    if abs(determinant) < 1e-12:
        for i in range(len(inliers)):
            inliers[i] = False
        return 0.0
    a_from_b = np.linalg.inv(b_from_a)
    score = 0.0
    for i in range(len(pixels_a)):
        forward = _transfer_error2(b_from_a, pixels_a[i], pixels_b[i]) / variances[i]
        backward = _transfer_error2(a_from_b, pixels_b[i], pixels_a[i]) / variances[i]
        inliers[i] = forward <= CHI2_95_2DOF and backward <= CHI2_95_2DOF
        score += max(CHI2_95_2DOF - forward, 0.0) + max(CHI2_95_2DOF - backward, 0.0)
    return score


@compiled
def _transfer_error2(b_from_a: Any, pixel_a: Any, pixel_b: Any) -> float:
    x, y = pixel_a[0], pixel_a[1]
    w = b_from_a[2, 0] * x + b_from_a[2, 1] * y + b_from_a[2, 2]
    if abs(w) < 1e-12:
        return np.inf
    dx = (b_from_a[0, 0] * x + b_from_a[0, 1] * y + b_from_a[0, 2]) / w - pixel_b[0]
    dy = (b_from_a[1, 0] * x + b_from_a[1, 1] * y + b_from_a[1, 2]) / w - pixel_b[1]
    return float(dx * dx + dy * dy)


@compiled
def score_fundamental(b_from_a: Any, pixels_a: Any, pixels_b: Any, variances: Any, inliers: Any) -> float:
    """Return ORB-SLAM's score of a fundamental matrix (equation 2), by epipolar distances; fills `inliers` (N,).

    `variances` (N,) as in `score_homography`.
    """
    a_from_b = b_from_a.T.copy()
    score = 0.0
    for i in range(len(pixels_a)):
        forward = _line_distance2(b_from_a, pixels_a[i], pixels_b[i]) / variances[i]
        backward = _line_distance2(a_from_b, pixels_b[i], pixels_a[i]) / variances[i]
        inliers[i] = forward <= CHI2_95_1DOF and backward <= CHI2_95_1DOF
        if forward <= CHI2_95_1DOF:
            score += CHI2_95_2DOF - forward
        if backward <= CHI2_95_1DOF:
            score += CHI2_95_2DOF - backward
    return score


@compiled
def _line_distance2(b_from_a: Any, pixel_a: Any, pixel_b: Any) -> float:
    x, y = pixel_a[0], pixel_a[1]
    a = b_from_a[0, 0] * x + b_from_a[0, 1] * y + b_from_a[0, 2]
    b = b_from_a[1, 0] * x + b_from_a[1, 1] * y + b_from_a[1, 2]
    c = b_from_a[2, 0] * x + b_from_a[2, 1] * y + b_from_a[2, 2]
    norm2 = a * a + b * b
    if norm2 < 1e-24:
        return np.inf
    distance = a * pixel_b[0] + b * pixel_b[1] + c
    return float(distance * distance / norm2)


def decompose_homography(b_from_a: Floats, camera_matrix: Floats) -> list[Floats]:
    """Return the motions `b_from_a` (4, 4) that a homography of pixels allows (Malis 2007).

    Their translations have unit length or are zero.
    """
    _, rotations, translations, _ = cv2.decomposeHomographyMat(b_from_a, camera_matrix)
    pairs = zip(rotations, translations, strict=True)
    return [_motion(np.asarray(r, np.float64), np.asarray(t, np.float64).ravel()) for r, t in pairs]


def decompose_fundamental(b_from_a: Floats, camera_matrix: Floats) -> list[Floats]:
    """Return the four motions `b_from_a` (4, 4), of unit translation, of a fundamental matrix (section 9.6.2)."""
    u, _, vt = np.linalg.svd(camera_matrix.T @ b_from_a @ camera_matrix)
    u, vt = u * np.sign(np.linalg.det(u)), vt * np.sign(np.linalg.det(vt))
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    rotations = (u @ turn @ vt, u @ turn.T @ vt)
    return [_motion(rotation, sign * u[:, 2]) for rotation in rotations for sign in (1.0, -1.0)]


def _motion(rotation: Floats, translation: Floats) -> Floats:
    motion = np.eye(4)
    motion[:3, :3] = rotation
    length = float(np.linalg.norm(translation))
    motion[:3, 3] = translation / length if length > 1e-12 else translation
    return motion


@compiled
def fundamental_between(a_from_world: Any, b_from_world: Any, camera_matrix: Any) -> Any:
    """Return the fundamental matrix (3, 3), x_b' F x_a = 0, of two poses (4, 4), and the epipole (2,), pixels of b.

    `camera_matrix` (3, 3) has no skew. An epipole at infinity is returned 1e6 pixels out in its direction.
    """
    b_from_a = sim3_compose(b_from_world, se3_inverse(a_from_world))
    t = b_from_a[:3, 3].copy()
    fx, fy, cx, cy = camera_matrix[0, 0], camera_matrix[1, 1], camera_matrix[0, 2], camera_matrix[1, 2]
    inverse = np.array([[1.0 / fx, 0.0, -cx / fx], [0.0, 1.0 / fy, -cy / fy], [0.0, 0.0, 1.0]])
    rotation = np.ascontiguousarray(b_from_a[:3, :3])
    fundamental = inverse.T @ (skew(t) @ rotation @ inverse)
    u, v = fx * t[0] + cx * t[2], fy * t[1] + cy * t[2]
    length = math.sqrt(u * u + v * v)
    scale = 1.0 / t[2] if abs(t[2]) > 1e-6 * length else 1e6 / max(length, 1e-300)
    return fundamental, np.array([scale * u, scale * v])


_STEP = 1e-6  # radians: half the difference by which derivatives are taken


def direction_deviation_deg(
    second_from_first: Floats, pixels_a: Floats, pixels_b: Floats, variances: Floats, matrix: Floats
) -> float:
    """Return the standard deviation, degrees, of the direction of translation that two views fix worst.

    `second_from_first` (4, 4) with unit translation explains the matches `pixels_a`, `pixels_b` (N, 2), whose errors
    have `variances` (N,) along each axis, px^2; `matrix` (3, 3) is the camera's. The result comes from the inverse of
    the normal equations of the Sampson distances by rotation (three parameters) and direction (two). It is infinite if
    the direction has no effect, because the camera only turned. Source: Hartley and Zisserman, 2nd edition, sections
    5.2, 11.4.3.
    """
    across = np.linalg.svd(second_from_first[None, :3, 3])[2][1:]
    slopes = []
    for k in range(5):
        distances = []
        for step in (_STEP, -_STEP):
            moved = second_from_first.copy()
            if k < 3:
                moved[:3, :3] = se3_exp(np.eye(6)[3 + k] * step)[:3, :3] @ moved[:3, :3]
            else:
                moved[:3, 3] += step * across[k - 3]
            distances.append(sampson_distances(moved, pixels_a, pixels_b, matrix) / np.sqrt(variances))
        slopes.append((distances[0] - distances[1]) / (2.0 * _STEP))
    by_rotation, by_direction = np.array(slopes[:3]).T, np.array(slopes[3:]).T
    compensated = by_rotation @ np.linalg.lstsq(by_rotation, by_direction, rcond=None)[0]
    remaining = by_direction - compensated  # the part that no rotation can explain
    information = float(np.linalg.svd(remaining, compute_uv=False)[-1])
    return float(np.degrees(1.0 / information)) if information > 1e-9 else np.inf


def sampson_distances(second_from_first: Floats, pixels_a: Floats, pixels_b: Floats, matrix: Floats) -> Floats:
    """Return the signed Sampson distances (N,), pixels, of matches to their epipolar geometry (section 11.4.3)."""
    fundamental, _ = fundamental_between(np.eye(4), second_from_first, matrix)
    homogeneous_a, homogeneous_b = (np.column_stack([p, np.ones(len(p))]) for p in (pixels_a, pixels_b))
    lines_b, lines_a = homogeneous_a @ fundamental.T, homogeneous_b @ fundamental
    squares = (lines_a[:, :2] ** 2).sum(axis=1) + (lines_b[:, :2] ** 2).sum(axis=1)
    return np.asarray((homogeneous_b * lines_b).sum(axis=1) / np.sqrt(np.maximum(squares, 1e-300)))
