"""Rigid motions and similarities: exponential, logarithm, composition, and alignment of point sets.

Conventions of the whole package: matrices act on columns, `a_from_c = a_from_b @ b_from_c`. A rigid motion is a (4, 4)
matrix [[R, t], [0, 1]], a similarity a (4, 4) matrix [[s R, t], [0, 1]] with s > 0. Tangent vectors hold the
translational part first: (v, w) in se(3), (v, w, sigma) in sim(3), where s = exp(sigma).

Every function here is compiled by numba and may be called from other compiled code.
"""

from __future__ import annotations

import math

import numpy as np

from codecbench.core.kernels.compiled import compiled
from codecbench.slam.geometry.rotations import SMALL_ANGLE_RAD, Array, skew, so3_exp, so3_log


@compiled
def _power_integral(exponent: float, power: int) -> float:
    """Integral of tau^power exp(exponent tau) over 0..1, by its Taylor series."""
    term, total = 1.0, 1.0 / (power + 1)
    for n in range(1, 100):
        term *= exponent / n
        total += term / (n + power + 1)
        if abs(term) < 1e-18:
            break
    return total


@compiled
def sim3_translation_factor(rotation_vector: Array, log_scale: float) -> Array:
    """Return W (3, 3) with t = W v: the integral of exp(tau (sigma I + [w]x)) over 0..1 (Strasdat 2012, appendix)."""
    theta = math.sqrt(rotation_vector[0] ** 2 + rotation_vector[1] ** 2 + rotation_vector[2] ** 2)
    a = _power_integral(log_scale, 0) if abs(log_scale) < 1e-2 else math.expm1(log_scale) / log_scale
    if theta < SMALL_ANGLE_RAD:  # sin and cos expanded in theta, integrated term by term
        b, c, power = 0.0, 0.0, 1.0
        for k in range(6):
            b += power / math.gamma(2.0 * k + 2.0) * _power_integral(log_scale, 2 * k + 1)
            c += power / math.gamma(2.0 * k + 3.0) * _power_integral(log_scale, 2 * k + 2)
            power *= -theta * theta
    else:
        scale, square = math.exp(log_scale), log_scale * log_scale + theta * theta
        sine, cosine = math.sin(theta), math.cos(theta)
        b = (scale * (log_scale * sine - theta * cosine) + theta) / (theta * square)
        c = (a - (scale * (log_scale * cosine + theta * sine) - log_scale) / square) / (theta * theta)
    cross = skew(rotation_vector)
    return a * np.eye(3) + b * cross + c * (cross @ cross)


@compiled
def sim3_exp(tangent: Array) -> Array:
    """Return the (4, 4) similarity of a (7,) tangent vector (v, w, sigma)."""
    out = np.eye(4)
    scale, rotation = math.exp(tangent[6]), so3_exp(tangent[3:6])
    factor = sim3_translation_factor(tangent[3:6], tangent[6])
    for i in range(3):
        for j in range(3):
            out[i, j] = scale * rotation[i, j]
            out[i, 3] += factor[i, j] * tangent[j]
    return out


@compiled
def sim3_log(similarity: Array) -> Array:
    """Return the (7,) tangent vector (v, w, sigma) of a (4, 4) similarity."""
    out = np.empty(7)
    scale = sim3_scale(similarity)
    rotation_vector = so3_log(similarity[:3, :3] / scale)
    out[6] = math.log(scale)
    translation = _solve_3x3(sim3_translation_factor(rotation_vector, out[6]), similarity[:3, 3])
    for k in range(3):
        out[k], out[k + 3] = translation[k], rotation_vector[k]
    return out


@compiled
def _solve_3x3(matrix: Array, right_side: Array) -> Array:
    """Return x of A x = b for a well-conditioned A (3, 3): cross products of its rows over its determinant."""
    out, determinant = np.zeros(3), 0.0
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        for c in range(3):
            d, e = (c + 1) % 3, (c + 2) % 3
            cofactor = matrix[j, d] * matrix[k, e] - matrix[j, e] * matrix[k, d]
            out[c] += cofactor * right_side[i]
            if i == 0:
                determinant += matrix[0, c] * cofactor
    for c in range(3):
        out[c] /= determinant
    return out


@compiled
def sim3_scale(similarity: Array) -> float:
    """Return the scale of a (4, 4) similarity: the length of its first column."""
    return math.sqrt(similarity[0, 0] ** 2 + similarity[1, 0] ** 2 + similarity[2, 0] ** 2)


@compiled
def sim3_from_parts(scale: float, rotation: Array, translation: Array) -> Array:
    """Return the (4, 4) similarity x -> scale rotation x + translation."""
    out = np.eye(4)
    for i in range(3):
        for j in range(3):
            out[i, j] = scale * rotation[i, j]
        out[i, 3] = translation[i]
    return out


@compiled
def sim3_to_parts(similarity: Array) -> tuple[float, Array, Array]:
    """Return scale, rotation (3, 3) and translation (3,) of a (4, 4) similarity."""
    scale = sim3_scale(similarity)
    return scale, similarity[:3, :3] / scale, similarity[:3, 3].copy()


@compiled
def sim3_compose(a_from_b: Array, b_from_c: Array) -> Array:
    """Return `a_from_c` (4, 4), written out: twice as fast as a general product of small matrices."""
    out = np.zeros((4, 4))
    for i in range(3):
        for j in range(4):
            for k in range(3):
                out[i, j] += a_from_b[i, k] * b_from_c[k, j]
        out[i, 3] += a_from_b[i, 3]
    out[3, 3] = 1.0
    return out


@compiled
def sim3_inverse(similarity: Array) -> Array:
    """Return the inverse of a (4, 4) similarity (or rigid motion)."""
    square = similarity[0, 0] ** 2 + similarity[1, 0] ** 2 + similarity[2, 0] ** 2
    out = np.zeros((4, 4))
    for i in range(3):
        for j in range(3):
            out[i, j] = similarity[j, i] / square
    for i in range(3):
        for j in range(3):
            out[i, 3] -= out[i, j] * similarity[j, 3]
    out[3, 3] = 1.0
    return out


@compiled
def sim3_adjoint(similarity: Array) -> Array:
    """Return Ad (7, 7) with S exp(x) = exp(Ad x) S."""
    scale, rotation, translation = sim3_to_parts(similarity)
    out = np.zeros((7, 7))
    moment = skew(translation) @ rotation
    for i in range(3):
        for j in range(3):
            out[i, j], out[i, j + 3], out[i + 3, j + 3] = scale * rotation[i, j], moment[i, j], rotation[i, j]
        out[i, 6] = -translation[i]
    out[6, 6] = 1.0
    return out


@compiled
def se3_exp(tangent: Array) -> Array:
    """Return the (4, 4) rigid motion of a (6,) tangent vector (v, w)."""
    extended = np.zeros(7)
    for k in range(6):
        extended[k] = tangent[k]
    return sim3_exp(extended)


@compiled
def se3_log(motion: Array) -> Array:
    """Return the (6,) tangent vector (v, w) of a (4, 4) rigid motion."""
    return sim3_log(motion)[:6]


@compiled
def se3_inverse(motion: Array) -> Array:
    """Return the inverse of a (4, 4) rigid motion, by transposition."""
    out = np.zeros((4, 4))
    for i in range(3):
        for j in range(3):
            out[i, j] = motion[j, i]
            out[i, 3] -= motion[j, i] * motion[j, 3]
    out[3, 3] = 1.0
    return out


@compiled
def align_points(points_a: Array, points_b: Array, with_scale: bool) -> tuple[float, Array, Array]:
    """Return (scale, rotation (3, 3), translation (3,)) of the similarity `a_from_b` nearest to pairs of points.

    `points_a`, `points_b` (N, 3), N >= 3, not on one line: the same points in two frames. It minimizes
    sum |a - (s R b + t)|^2; without scale, s is 1. Source: Umeyama, PAMI 13(4), 1991, equations 38-42,
    doi:10.1109/34.88573.
    """
    count = points_a.shape[0]
    mean_a, mean_b = np.zeros(3), np.zeros(3)
    for i in range(count):
        for k in range(3):
            mean_a[k] += points_a[i, k] / count
            mean_b[k] += points_b[i, k] / count
    covariance, variance_b = np.zeros((3, 3)), 0.0
    for i in range(count):
        for j in range(3):
            centerd_b = points_b[i, j] - mean_b[j]
            variance_b += centerd_b * centerd_b
            for k in range(3):
                covariance[k, j] += (points_a[i, k] - mean_a[k]) * centerd_b
    u, singular, vt = np.linalg.svd(covariance)
    if np.linalg.det(u) * np.linalg.det(vt) < 0.0:  # the nearest orthogonal matrix is a reflection
        for k in range(3):
            u[k, 2] *= -1.0
        singular[2] *= -1.0
    rotation = u @ vt
    scale = singular.sum() / variance_b if with_scale and variance_b > 0.0 else 1.0
    return scale, rotation, mean_a - scale * (rotation @ mean_b)
