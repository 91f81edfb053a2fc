"""Rotations: exponential, logarithm, quaternions. Every function is compiled and may be called from compiled code.

Conventions as in transforms: matrices act on columns.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from codecbench.core.kernels.compiled import compiled

Array = NDArray[np.float64]

SMALL_ANGLE_RAD = 0.3  # below it, closed forms lose digits to cancellation and short series are used


@compiled
def skew(vector: Array) -> Array:
    """Return the (3, 3) matrix [v]x with [v]x u = v x u."""
    out = np.zeros((3, 3))
    out[0, 1], out[0, 2], out[1, 2] = -vector[2], vector[1], -vector[0]
    out[1, 0], out[2, 0], out[2, 1] = vector[2], -vector[1], vector[0]
    return out


@compiled
def so3_exp(rotation_vector: Array) -> Array:
    """Return the (3, 3) rotation about a (3,) vector by its length in radians (Rodrigues' formula)."""
    out = np.empty((3, 3))
    so3_exp_into(rotation_vector[0], rotation_vector[1], rotation_vector[2], out)
    return out


@compiled
def so3_exp_into(x: float, y: float, z: float, out: Array) -> None:
    """Write `so3_exp((x, y, z))` into `out` (3, 3), without allocating."""
    theta2 = x * x + y * y + z * z
    if theta2 < 1e-8:
        a = 1.0 - theta2 / 6.0
        b = 0.5 - theta2 / 24.0
    else:
        theta = math.sqrt(theta2)
        a = math.sin(theta) / theta
        half = math.sin(0.5 * theta)
        b = 2.0 * half * half / theta2
    out[0, 0], out[1, 1], out[2, 2] = 1.0 - b * (y * y + z * z), 1.0 - b * (x * x + z * z), 1.0 - b * (x * x + y * y)
    out[0, 1], out[1, 0] = b * x * y - a * z, b * x * y + a * z
    out[0, 2], out[2, 0] = b * x * z + a * y, b * x * z - a * y
    out[1, 2], out[2, 1] = b * y * z - a * x, b * y * z + a * x


@compiled
def so3_log(rotation: Array) -> Array:
    """Return the (3,) rotation vector of a (3, 3) rotation, of length 0..pi; exact to rounding up to pi itself."""
    quaternion = quaternion_from_rotation(rotation)
    x, y, z, w = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    length = math.sqrt(x * x + y * y + z * z)
    factor = 2.0 if length < 1e-12 else 2.0 * math.atan2(length, w) / length
    return np.array([factor * x, factor * y, factor * z])


@compiled
def quaternion_from_rotation(rotation: Array) -> Array:
    """Return the unit quaternion (x, y, z, w), w >= 0, of a (3, 3) rotation (Shepperd 1978: largest pivot)."""
    r00, r11, r22 = rotation[0, 0], rotation[1, 1], rotation[2, 2]
    out = np.empty(4)
    trace = r00 + r11 + r22
    if trace >= r00 and trace >= r11 and trace >= r22:
        out[0] = rotation[2, 1] - rotation[1, 2]
        out[1] = rotation[0, 2] - rotation[2, 0]
        out[2] = rotation[1, 0] - rotation[0, 1]
        out[3] = 1.0 + trace
    else:
        i = 0
        if r11 > r00:
            i = 1
        if r22 > r00 and r22 > r11:
            i = 2
        j, k = (i + 1) % 3, (i + 2) % 3
        out[i] = 1.0 + rotation[i, i] - rotation[j, j] - rotation[k, k]
        out[j] = rotation[i, j] + rotation[j, i]
        out[k] = rotation[i, k] + rotation[k, i]
        out[3] = rotation[k, j] - rotation[j, k]
    length = math.sqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2] + out[3] * out[3])
    sign = -1.0 if out[3] < 0.0 else 1.0
    for i in range(4):
        out[i] *= sign / length
    return out


@compiled
def rotation_from_quaternion(quaternion: Array) -> Array:
    """Return the (3, 3) rotation of a quaternion (x, y, z, w) of any non-zero length."""
    x, y, z, w = quaternion[0], quaternion[1], quaternion[2], quaternion[3]
    scale = 2.0 / (x * x + y * y + z * z + w * w)
    out = np.empty((3, 3))
    out[0, 0], out[0, 1], out[0, 2] = 1.0 - scale * (y * y + z * z), scale * (x * y - z * w), scale * (x * z + y * w)
    out[1, 0], out[1, 1], out[1, 2] = scale * (x * y + z * w), 1.0 - scale * (x * x + z * z), scale * (y * z - x * w)
    out[2, 0], out[2, 1], out[2, 2] = scale * (x * z - y * w), scale * (y * z + x * w), 1.0 - scale * (x * x + y * y)
    return out


@compiled
def orthonormalize(rotation: Array) -> Array:
    """Return the rotation nearest to a (3, 3) matrix that rounding has taken slightly out of SO(3)."""
    return rotation_from_quaternion(quaternion_from_rotation(rotation))
