"""How well two views fix the direction in which the camera moved."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from codecbench.slam.geometry.transforms import se3_exp
from codecbench.slam.geometry.two_view import fundamental_between

Floats = NDArray[np.float64]
_STEP = 1e-6  # radians: half the difference by which derivatives are taken


def direction_deviation_deg(
    second_from_first: Floats, pixels_a: Floats, pixels_b: Floats, variances: Floats, matrix: Floats
) -> float:
    """Standard deviation, degrees, of the direction of translation where two views fix it worst.

    `second_from_first` (4, 4) with unit translation explains the matches `pixels_a`, `pixels_b` (N, 2), whose errors
    have `variances` (N,) along each axis, px^2; `matrix` (3, 3) is the camera's. It is read off the inverse of the
    normal equations of the Sampson distances by rotation (three parameters) and direction (two). Infinite where the
    direction has no effect: the camera only turned. Source: Hartley and Zisserman, 2nd edition, sections 5.2, 11.4.3.
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
    remaining = by_direction - compensated  # what no rotation can mimic
    information = float(np.linalg.svd(remaining, compute_uv=False)[-1])
    return float(np.degrees(1.0 / information)) if information > 1e-9 else np.inf


def sampson_distances(second_from_first: Floats, pixels_a: Floats, pixels_b: Floats, matrix: Floats) -> Floats:
    """Signed distances (N,), pixels, by which matches miss their epipolar geometry, to first order (section 11.4.3)."""
    fundamental, _ = fundamental_between(np.eye(4), second_from_first, matrix)
    homogeneous_a, homogeneous_b = (np.column_stack([p, np.ones(len(p))]) for p in (pixels_a, pixels_b))
    lines_b, lines_a = homogeneous_a @ fundamental.T, homogeneous_b @ fundamental
    squares = (lines_a[:, :2] ** 2).sum(axis=1) + (lines_b[:, :2] ** 2).sum(axis=1)
    return np.asarray((homogeneous_b * lines_b).sum(axis=1) / np.sqrt(np.maximum(squares, 1e-300)))
