"""The motion that two views agree on best, and how well they fix its direction.

Pixels are undistorted; `matrix` (3, 3) is the camera's. A motion (4, 4) has a unit translation and so five degrees of
freedom: three of rotation, two of direction.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from codecbench.core.kernels.compiled import compiled
from codecbench.slam.geometry.rotations import skew
from codecbench.slam.geometry.transforms import se3_exp

Floats = NDArray[np.float64]
_ROUNDS = 10


def refine_motion(second_from_first: Floats, pixels_a: Floats, pixels_b: Floats, matrix: Floats) -> Floats:
    """The motion (4, 4) near `second_from_first` that the matches `pixels_a`, `pixels_b` (N, 2) agree on best.

    Gauss-Newton steps on the Sampson distances under Cauchy's loss of scale 1 px, which wrong matches hardly pull at,
    as long as they lower it. Source: Hartley and Zisserman, 2nd edition, sections 11.4.3 and A6.8.
    """
    motion, reached = second_from_first, np.inf
    moved = motion
    for _ in range(_ROUNDS):
        across = _across(moved)
        cost, information, gradient = _normal_equations(_derivatives(moved, across, matrix), pixels_a, pixels_b, True)
        if cost >= reached:
            break
        motion, settled, reached = moved, cost > (1.0 - 1e-4) * reached, cost
        if settled:
            break
        step = np.linalg.lstsq(information, -gradient, rcond=1e-12)[0]
        moved = motion.copy()
        moved[:3, :3] = se3_exp(np.concatenate([np.zeros(3), step[:3]]))[:3, :3] @ motion[:3, :3]
        moved[:3, 3] += step[3:] @ across
        moved[:3, 3] /= np.linalg.norm(moved[:3, 3])
    return motion


def direction_deviation_deg(second_from_first: Floats, pixels_a: Floats, pixels_b: Floats, matrix: Floats) -> float:
    """Standard deviation, degrees, of the direction of translation where two views fix it worst.

    `second_from_first` (4, 4) with unit translation explains the matches `pixels_a`, `pixels_b` (N, 2), whose errors
    are taken to be of 1 px. It is read off the inverse of the normal equations of the Sampson distances by rotation
    (three parameters) and direction (two). Infinite where the direction has no effect: the camera only turned.
    Source: Hartley and Zisserman, 2nd edition, sections 5.2 and 11.4.3.
    """
    derivatives = _derivatives(second_from_first, _across(second_from_first), matrix)
    _, information, _ = _normal_equations(derivatives, pixels_a, pixels_b, False)
    mimicked = information[3:, :3] @ np.linalg.lstsq(information[:3, :3], information[:3, 3:], rcond=None)[0]
    remaining = float(np.linalg.eigvalsh(information[3:, 3:] - mimicked)[0])  # what no rotation can mimic
    return float(np.degrees(1.0 / math.sqrt(remaining))) if remaining > 1e-18 else np.inf


def sampson_distances(second_from_first: Floats, pixels_a: Floats, pixels_b: Floats, matrix: Floats) -> Floats:
    """Signed distances (N,), pixels, by which matches miss their epipolar geometry, to first order (section 11.4.3)."""
    fundamental = _derivatives(second_from_first, np.zeros((2, 3)), matrix)[0]
    homogeneous_a, homogeneous_b = (np.column_stack([p, np.ones(len(p))]) for p in (pixels_a, pixels_b))
    lines_b, lines_a = homogeneous_a @ fundamental.T, homogeneous_b @ fundamental
    squares = (lines_a[:, :2] ** 2).sum(axis=1) + (lines_b[:, :2] ** 2).sum(axis=1)
    return np.asarray((homogeneous_b * lines_b).sum(axis=1) / np.sqrt(np.maximum(squares, 1e-300)))


def _across(motion: Floats) -> Floats:
    """Two directions (2, 3) at right angles to that of the translation."""
    return np.asarray(np.linalg.svd(motion[None, :3, 3])[2][1:])


def _derivatives(motion: Floats, across: Floats, matrix: Floats) -> Floats:
    """The fundamental matrix of a motion and its derivatives (6, 3, 3) by rotation and by direction."""
    rotation, translation, to_rays = motion[:3, :3], skew(motion[:3, 3].copy()), np.linalg.inv(matrix)
    essentials = [translation @ rotation]
    essentials += [translation @ skew(axis) @ rotation for axis in np.eye(3)]
    essentials += [skew(direction) @ rotation for direction in across]
    return np.asarray(to_rays.T @ np.array(essentials) @ to_rays)


@compiled
def _normal_equations(derivatives: Any, pixels_a: Any, pixels_b: Any, robust: bool) -> Any:
    """Cauchy's loss of the Sampson distances, and their normal equations (5, 5) and (5,), weighted where `robust`.

    `derivatives` (6, 3, 3) are the fundamental matrix and its derivatives by the five parameters.
    """
    cost, information, gradient, slope = 0.0, np.zeros((5, 5)), np.zeros(5), np.empty(5)
    fundamental = derivatives[0]
    for i in range(len(pixels_a)):
        x, y, u, v = pixels_a[i, 0], pixels_a[i, 1], pixels_b[i, 0], pixels_b[i, 1]
        bx, by, miss, ax, ay = _lines(fundamental, x, y, u, v)
        norm = math.sqrt(max(bx * bx + by * by + ax * ax + ay * ay, 1e-300))
        distance = miss / norm
        for k in range(5):
            dbx, dby, dmiss, dax, day = _lines(derivatives[k + 1], x, y, u, v)
            dnorm = (bx * dbx + by * dby + ax * dax + ay * day) / norm
            slope[k] = (dmiss - distance * dnorm) / norm
        cost += math.log1p(distance * distance)
        weight = 1.0 / (1.0 + distance * distance) if robust else 1.0
        for k in range(5):
            gradient[k] += weight * slope[k] * distance
            for m in range(5):
                information[k, m] += weight * slope[k] * slope[m]
    return cost, information, gradient


@compiled
def _lines(fundamental: Any, x: float, y: float, u: float, v: float) -> Any:
    """Normal of the epipolar line in b, how far pixel b (u, v) misses it times its length, and the normal in a."""
    bx = fundamental[0, 0] * x + fundamental[0, 1] * y + fundamental[0, 2]
    by = fundamental[1, 0] * x + fundamental[1, 1] * y + fundamental[1, 2]
    bz = fundamental[2, 0] * x + fundamental[2, 1] * y + fundamental[2, 2]
    ax = fundamental[0, 0] * u + fundamental[1, 0] * v + fundamental[2, 0]
    ay = fundamental[0, 1] * u + fundamental[1, 1] * v + fundamental[2, 1]
    return bx, by, u * bx + v * by + bz, ax, ay
