"""Similarity between two keyframes that see the same points: RANSAC on three pairs, then refinement."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from codecbench.core.kernels.compiled import compiled
from codecbench.slam.geometry.linear_systems import copy_numbers, solve_symmetric
from codecbench.slam.geometry.rotations import Array
from codecbench.slam.geometry.transforms import align_points, sim3_compose, sim3_exp, sim3_from_parts, sim3_inverse
from codecbench.slam.thresholds import CHI2_99_2DOF

_CONFIDENCE = 0.99  # probability that RANSAC has drawn a sample without outliers when it stops
_ROUNDS = 3  # of the refinement; outliers are removed after each
_ITERATIONS_A_ROUND = 10
_MIN_PAIRS = 3


class Pairs(NamedTuple):
    """Points that two keyframes a and b share."""

    points_a: Any
    """Positions in the frame of camera a (N, 3)."""
    points_b: Any
    """Positions in the frame of camera b (N, 3)."""
    pixels_a: Any
    """Undistorted pixels in a (N, 2)."""
    pixels_b: Any
    """Undistorted pixels in b (N, 2)."""
    weights_a: Any
    """Inverse variances of `pixels_a` (N,), 1/px^2."""
    weights_b: Any
    """Inverse variances of `pixels_b` (N,), 1/px^2."""
    intrinsics: Any
    """fx, fy, cx, cy (4,)."""


def estimate_similarity(
    points_a: Array,
    points_b: Array,
    pixels_a: Array,
    pixels_b: Array,
    inverse_sigma2_a: Array,
    inverse_sigma2_b: Array,
    intrinsics: Array,
    rng: np.random.Generator,
    *,
    min_inliers: int = 20,
    iterations: int = 300,
) -> tuple[Array, NDArray[np.bool_]] | None:
    """Return the similarity `a_from_b` (4, 4) that most pairs support and its inliers (N,), or None without support.

    `points_a`, `points_b` (N, 3): the same points in the maps of two keyframes, each in its own camera's frame;
    `pixels_a`, `pixels_b` (N, 2) undistorted; `inverse_sigma2_*` (N,) in 1/px^2; `intrinsics` (4,): fx, fy, cx, cy. An
    inlier is in front of both cameras, with a chi-square of at most 9.21 in both images. Draws at most `iterations`
    samples of three pairs and stops at 99 % confidence; the best one is fitted again to all its inliers.
    Raises ValueError for arrays that do not fit together.
    Sources: Horn, JOSA A 4(4), 1987, and Umeyama, PAMI 13(4), 1991 (closed form); ORB-SLAM, T-RO 2015, section VII-B.
    """
    pairs = _validate_pairs(points_a, points_b, pixels_a, pixels_b, inverse_sigma2_a, inverse_sigma2_b, intrinsics)
    pair_count = len(pairs.points_a)
    if pair_count < max(min_inliers, _MIN_PAIRS):
        return None
    samples = rng.integers(0, [pair_count, pair_count - 1, pair_count - 2], size=(iterations, 3))
    inliers = np.zeros(pair_count, dtype=np.bool_)
    a_from_b = np.eye(4)
    count = _ransac(pairs, samples, a_from_b, inliers)
    return (a_from_b, inliers) if count >= max(min_inliers, _MIN_PAIRS) else None


def optimize_similarity(
    a_from_b: Array,
    points_a: Array,
    points_b: Array,
    pixels_a: Array,
    pixels_b: Array,
    inverse_sigma2_a: Array,
    inverse_sigma2_b: Array,
    intrinsics: Array,
) -> tuple[Array, NDArray[np.bool_]]:
    """Return the similarity `a_from_b` (4, 4) that minimizes the reprojection errors in both images, and its inliers.

    The arguments are those of `estimate_similarity`; points stay where they are in their own camera's frame. Rounds of
    Levenberg-Marquardt on seven parameters with Huber's kernel; after each, pairs with a chi-square above 9.21 in
    either image leave (and may come back). With fewer than three inliers left, the last good similarity is returned.
    Raises ValueError for arrays that do not fit together. Source: ORB-SLAM, T-RO 2015, appendix.
    """
    pairs = _validate_pairs(points_a, points_b, pixels_a, pixels_b, inverse_sigma2_a, inverse_sigma2_b, intrinsics)
    similarity = np.array(a_from_b, dtype=np.float64)
    if similarity.shape != (4, 4) or not np.linalg.det(similarity[:3, :3]) > 0.0:
        raise ValueError("optimize_similarity: a_from_b is not a (4, 4) similarity with a positive determinant")
    inliers = np.zeros(len(pairs.points_a), dtype=np.bool_)
    _refine(pairs, similarity, inliers)
    return similarity, inliers


def _validate_pairs(*arrays: Array) -> Pairs:
    """Return points, pixels, inverse variances of a and b and the intrinsics as contiguous floats."""
    out = tuple(np.ascontiguousarray(array, dtype=np.float64) for array in arrays)
    n = len(out[0])
    shapes = [(n, 3), (n, 3), (n, 2), (n, 2), (n,), (n,), (4,)]
    names = ["points_a", "points_b", "pixels_a", "pixels_b", "inverse_sigma2_a", "inverse_sigma2_b", "intrinsics"]
    for name, array, shape in zip(names, out, shapes, strict=True):
        if array.shape != shape:
            raise ValueError(f"similarity: {name} has shape {array.shape}; expected {shape}")
    return Pairs(*out)


@compiled
def _transform_point(matrix, point):  # type: ignore[no-untyped-def]
    x = matrix[0, 0] * point[0] + matrix[0, 1] * point[1] + matrix[0, 2] * point[2] + matrix[0, 3]
    y = matrix[1, 0] * point[0] + matrix[1, 1] * point[1] + matrix[1, 2] * point[2] + matrix[1, 3]
    z = matrix[2, 0] * point[0] + matrix[2, 1] * point[1] + matrix[2, 2] * point[2] + matrix[2, 3]
    return x, y, z


@compiled
def _chi2(transform, point, pixel, weight, intrinsics):  # type: ignore[no-untyped-def]
    """Return the chi-square of a point brought into a camera; infinite behind it."""
    x, y, z = _transform_point(transform, point)
    if z <= 0.0:
        return np.inf
    e0 = intrinsics[0] * x / z + intrinsics[2] - pixel[0]
    e1 = intrinsics[1] * y / z + intrinsics[3] - pixel[1]
    return weight * (e0 * e0 + e1 * e1)


@compiled
def _classify(a_from_b, pairs, inliers):  # type: ignore[no-untyped-def]
    """Mark the pairs that fit in both images; return their number."""
    b_from_a, count, intrinsics = sim3_inverse(a_from_b), 0, pairs.intrinsics
    for i in range(pairs.points_a.shape[0]):
        in_a = _chi2(a_from_b, pairs.points_b[i], pairs.pixels_a[i], pairs.weights_a[i], intrinsics)
        in_b = _chi2(b_from_a, pairs.points_a[i], pairs.pixels_b[i], pairs.weights_b[i], intrinsics)
        inliers[i] = max(in_a, in_b) <= CHI2_99_2DOF
        count += inliers[i]
    return count


@compiled
def _ransac(pairs, samples, best, inliers):  # type: ignore[no-untyped-def]
    """Fill `best` and `inliers` from samples of three; return the number of inliers."""
    total, best_count, needed = pairs.points_a.shape[0], 0, float(samples.shape[0])
    trial_inliers, triple_a, triple_b = np.empty_like(inliers), np.empty((3, 3)), np.empty((3, 3))
    for k in range(samples.shape[0]):
        if k >= needed:
            break
        first, second, third = samples[k, 0], samples[k, 1], samples[k, 2]
        if second >= first:  # the second index counts the pairs without the first, the third without both
            second += 1
        for earlier in (min(first, second), max(first, second)):
            if third >= earlier:
                third += 1
        for row, index in enumerate((first, second, third)):
            for k in range(3):
                triple_a[row, k], triple_b[row, k] = pairs.points_a[index, k], pairs.points_b[index, k]
        scale, rotation, translation = align_points(triple_a, triple_b, True)
        if not (scale > 1e-9 and scale < 1e9):
            continue
        trial = sim3_from_parts(scale, rotation, translation)
        count = _classify(trial, pairs, trial_inliers)
        if count > best_count:
            best_count = count
            copy_numbers(trial, best)
            copy_numbers(trial_inliers, inliers)
            good = min((count / total) ** 3, 1.0 - 1e-12)
            needed = math.log(1.0 - _CONFIDENCE) / math.log(1.0 - good) if good > 1e-12 else needed
    if best_count < _MIN_PAIRS:
        return best_count
    scale, rotation, translation = align_points(pairs.points_a[inliers], pairs.points_b[inliers], True)
    trial = sim3_from_parts(scale, rotation, translation)
    count = _classify(trial, pairs, trial_inliers)
    if count >= best_count:
        best_count = count
        copy_numbers(trial, best)
        copy_numbers(trial_inliers, inliers)
    return best_count


@compiled
def _refine(pairs, similarity, inliers):  # type: ignore[no-untyped-def]
    active, trial = np.ones_like(inliers), similarity.copy()
    for _ in range(_ROUNDS):
        _minimize(pairs, active, trial)
        count = _classify(trial, pairs, active)
        if count < _MIN_PAIRS:
            return
        copy_numbers(trial, similarity)
        unchanged = np.array_equal(active, inliers)
        copy_numbers(active, inliers)
        if unchanged:
            return


@compiled
def _minimize(pairs, active, similarity):  # type: ignore[no-untyped-def]
    hessian, gradient = np.empty((7, 7)), np.empty(7)
    damping, cost = 1e-4, np.inf
    trial, step_size = similarity.copy(), np.inf
    for iteration in range(_ITERATIONS_A_ROUND + 1):
        trial_hessian, trial_gradient = np.zeros((7, 7)), np.zeros(7)
        trial_cost = _linearize(
            pairs, active, trial,
            trial_hessian, trial_gradient,
        )  # fmt: skip
        if trial_cost < cost or iteration == 0:
            gain = cost - trial_cost
            copy_numbers(trial, similarity)
            hessian, gradient, cost = trial_hessian, trial_gradient, trial_cost
            damping = max(damping * 0.1, 1e-9)
            if gain <= 1e-7 * cost or step_size < 1e-9:
                return
        else:
            damping *= 10.0
        step, solved = solve_symmetric(hessian, gradient, damping)
        if not solved:
            damping *= 100.0
            step[:] = 0.0
        step_size = np.abs(step[3:]).max()
        trial = sim3_compose(sim3_exp(step), similarity)


@compiled
def _linearize(  # type: ignore[no-untyped-def]
    pairs, active, similarity, hessian, gradient
):
    """Add the normal equations of both images; return the robust cost."""
    inverse, cost, intrinsics = sim3_inverse(similarity), 0.0, pairs.intrinsics
    motion, identity = np.empty((3, 7)), np.eye(3)
    for i in range(pairs.points_a.shape[0]):
        if not active[i]:
            continue
        in_a = _transform_point(similarity, pairs.points_b[i])
        _point_motion(in_a, identity, 1.0, motion)
        cost += _add_residual(in_a, motion, pairs.pixels_a[i], pairs.weights_a[i], intrinsics, hessian, gradient)
        in_b = _transform_point(inverse, pairs.points_a[i])
        _point_motion(pairs.points_a[i], inverse[:3, :3], -1.0, motion)
        cost += _add_residual(in_b, motion, pairs.pixels_b[i], pairs.weights_b[i], intrinsics, hessian, gradient)
    return cost


@compiled
def _point_motion(point, rotation, sign, out):  # type: ignore[no-untyped-def]
    """Write the derivative (3, 7) of sign * M exp(x) point by x, at x = 0; M is `rotation`, scaled."""
    x, y, z = point[0], point[1], point[2]
    for r in range(3):
        m0, m1, m2 = sign * rotation[r, 0], sign * rotation[r, 1], sign * rotation[r, 2]
        out[r, 0], out[r, 1], out[r, 2] = m0, m1, m2
        out[r, 3], out[r, 4], out[r, 5] = m2 * y - m1 * z, m0 * z - m2 * x, m1 * x - m0 * y
        out[r, 6] = m0 * x + m1 * y + m2 * z


@compiled
def _add_residual(point, motion, pixel, weight, intrinsics, hessian, gradient):  # type: ignore[no-untyped-def]
    """Add one image's residual to the normal equations; return its robust cost."""
    z = point[2]
    if z <= 0.0:
        return 1e6
    u, v = point[0] / z, point[1] / z
    e0 = pixel[0] - intrinsics[0] * u - intrinsics[2]
    e1 = pixel[1] - intrinsics[1] * v - intrinsics[3]
    chi2 = weight * (e0 * e0 + e1 * e1)
    cost = chi2
    if chi2 > CHI2_99_2DOF:
        cost = 2.0 * math.sqrt(CHI2_99_2DOF * chi2) - CHI2_99_2DOF
        weight *= math.sqrt(CHI2_99_2DOF / chi2)
    row0 = (motion[0] - u * motion[2]) * (intrinsics[0] / z)
    row1 = (motion[1] - v * motion[2]) * (intrinsics[1] / z)
    for a in range(7):
        gradient[a] += weight * (row0[a] * e0 + row1[a] * e1)
        for b in range(a + 1):
            hessian[a, b] += weight * (row0[a] * row0[b] + row1[a] * row1[b])
    return cost
