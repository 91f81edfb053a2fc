"""Compiled kernels of bundle adjustment: normal equations, Schur complement and back substitution.

The left update of a pose is x' = exp(w) x + v for points x in the camera's frame; its parameters are (v, w). Nothing
here checks an index: `bundle_adjustment.adjust` has done so.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from codecbench.slam.linear_systems import factorize_envelope, solve_envelope
from codecbench.slam.transforms import so3_exp_into

_MAX_ERROR_SIGMA = 1e4  # an error beyond it, or a point behind the camera, costs a constant and pulls at nothing
_START_DAMPING = 1e-4
_MIN_DAMPING = 1e-9
_MAX_DAMPING = 1e8


class Observations(NamedTuple):
    """What the cameras saw, sorted by point: those of point p are `starts[p]` to `starts[p + 1]`.

    `cameras` (M,), `starts` (P + 1,), `pixels` (M, 2), `weights` (M,) 1 / sigma, `active` (M,) bool; `intrinsics` (4,).
    """

    cameras: Any
    starts: Any
    pixels: Any
    weights: Any
    active: Any
    intrinsics: Any


class Layout(NamedTuple):
    """Where a camera's parameters stand: `slots` (K,), -1 if fixed; envelope of the system: `first`, `offsets`."""

    slots: Any
    first: Any
    offsets: Any


class Workspace(NamedTuple):
    """Arrays that one step fills: the reduced system and what the back substitution needs.

    `system` flat envelope, `right_side` (6 n,), `diagonal` (6 n,) of the cameras' own block; of each point the damped
    `inverses` (P, 6) of its block and `gradients` (P, 3); of each observation `crosses` (M, 3, 6), point by camera.
    """

    system: Any
    right_side: Any
    diagonal: Any
    inverses: Any
    gradients: Any
    crosses: Any


@njit(cache=True)
def stable_order(keys, key_count):  # type: ignore[no-untyped-def]
    """Return the stable order (M,) that sorts integer keys in 0..key_count - 1, by counting."""
    starts = np.zeros(key_count + 1, dtype=np.int64)
    for i in range(keys.shape[0]):
        starts[keys[i] + 1] += 1
    for k in range(key_count):
        starts[k + 1] += starts[k]
    out = np.empty(keys.shape[0], dtype=np.int64)
    for i in range(keys.shape[0]):
        out[starts[keys[i]]] = i
        starts[keys[i]] += 1
    return out


@njit(cache=True)
def camera_adjacency(slots, points, point_count, slot_count):  # type: ignore[no-untyped-def]
    """Return which free cameras (slot_count, slot_count) see a common point; `slots` (M,) is -1 where fixed."""
    out = np.zeros((slot_count, slot_count), dtype=np.bool_)
    order = stable_order(points, point_count)
    start = 0
    for end in range(1, order.shape[0] + 1):
        if end < order.shape[0] and points[order[end]] == points[order[start]]:
            continue
        for a in range(start, end):
            for b in range(start, end):
                if slots[order[a]] >= 0 and slots[order[b]] >= 0:
                    out[slots[order[a]], slots[order[b]]] = True
        start = end
    return out


@njit(cache=True)
def project(pose, point, intrinsics):  # type: ignore[no-untyped-def]
    """Return the pixel (u, v) of a point and its position x, y, z in the camera's frame."""
    x = pose[0, 0] * point[0] + pose[0, 1] * point[1] + pose[0, 2] * point[2] + pose[0, 3]
    y = pose[1, 0] * point[0] + pose[1, 1] * point[1] + pose[1, 2] * point[2] + pose[1, 3]
    z = pose[2, 0] * point[0] + pose[2, 1] * point[1] + pose[2, 2] * point[2] + pose[2, 3]
    if z <= 0.0:
        return 0.0, 0.0, x, y, z
    return intrinsics[0] * x / z + intrinsics[2], intrinsics[1] * y / z + intrinsics[3], x, y, z


@njit(cache=True)
def point_jacobian(pose, x, y, z, intrinsics, out):  # type: ignore[no-untyped-def]
    """Write the derivative (2, 3) of the pixel by the point's world coordinates."""
    a0, a2, b1, b2 = _pixel_derivative(x, y, z, intrinsics)
    for k in range(3):
        out[0, k] = a0 * pose[0, k] + a2 * pose[2, k]
        out[1, k] = b1 * pose[1, k] + b2 * pose[2, k]


@njit(cache=True)
def camera_jacobian(x, y, z, intrinsics, out):  # type: ignore[no-untyped-def]
    """Write the derivative (2, 6) of the pixel by the left update (v, w) of the pose."""
    a0, a2, b1, b2 = _pixel_derivative(x, y, z, intrinsics)
    out[0, 0], out[0, 1], out[0, 2], out[0, 3], out[0, 4], out[0, 5] = a0, 0.0, a2, a2 * y, a0 * z - a2 * x, -a0 * y
    out[1, 0], out[1, 1], out[1, 2], out[1, 3], out[1, 4], out[1, 5] = 0.0, b1, b2, b2 * y - b1 * z, -b2 * x, b1 * x


@njit(cache=True)
def _pixel_derivative(x, y, z, intrinsics):  # type: ignore[no-untyped-def]
    """Return du/dx, du/dz, dv/dy, dv/dz of the pinhole projection."""
    inverse = 1.0 / z
    a0, b1 = intrinsics[0] * inverse, intrinsics[1] * inverse
    return a0, -a0 * x * inverse, b1, -b1 * y * inverse


@njit(cache=True)
def _count_active(active, start, end):  # type: ignore[no-untyped-def]
    count = 0
    for m in range(start, end):
        if active[m]:
            count += 1
    return count


@njit(cache=True)
def classify(poses, points, seen, limit, inliers):  # type: ignore[no-untyped-def]
    """Mark the observations in front of their camera with a chi-square of at most `limit`."""
    for p in range(points.shape[0]):
        for m in range(seen.starts[p], seen.starts[p + 1]):
            u, v, _, _, z = project(poses[seen.cameras[m]], points[p], seen.intrinsics)
            e0, e1 = (u - seen.pixels[m, 0]) * seen.weights[m], (v - seen.pixels[m, 1]) * seen.weights[m]
            inliers[m] = z > 0.0 and e0 * e0 + e1 * e1 <= limit


@njit(cache=True)
def robust_cost(poses, points, seen, huber):  # type: ignore[no-untyped-def]
    """Return half the sum of Huber's function of the active chi-squares, of points seen at least twice."""
    huber2, limit2 = huber * huber, _MAX_ERROR_SIGMA * _MAX_ERROR_SIGMA
    total = 0.0
    for p in range(points.shape[0]):
        if _count_active(seen.active, seen.starts[p], seen.starts[p + 1]) < 2:
            continue
        for m in range(seen.starts[p], seen.starts[p + 1]):
            if not seen.active[m]:
                continue
            u, v, _, _, z = project(poses[seen.cameras[m]], points[p], seen.intrinsics)
            e0, e1 = (u - seen.pixels[m, 0]) * seen.weights[m], (v - seen.pixels[m, 1]) * seen.weights[m]
            chi2 = min(e0 * e0 + e1 * e1, limit2) if z > 0.0 else limit2
            total += chi2 if chi2 <= huber2 else 2.0 * huber * math.sqrt(chi2) - huber2
    return 0.5 * total


@njit(cache=True)
def minimize(poses, points, seen, layout, huber, limit, tolerance):  # type: ignore[no-untyped-def]
    """Levenberg-Marquardt in place on poses (K, 3, 4) and points (P, 3); return the number of steps tried."""
    count = layout.first.shape[0]
    work = Workspace(
        np.empty(layout.offsets[count]), np.empty(6 * count), np.empty(6 * count), np.empty((points.shape[0], 6)),
        np.empty((points.shape[0], 3)), np.empty((seen.cameras.shape[0], 3, 6)),
    )  # fmt: skip
    trial_poses, trial_points = poses.copy(), points.copy()
    damping, growth = _START_DAMPING, 4.0
    cost = robust_cost(poses, points, seen, huber)
    for step in range(limit):
        _reduce(poses, points, seen, layout, huber, damping, work)
        trial_cost = np.inf
        if factorize_envelope(work.system, layout.first, layout.offsets, 6):
            solve_envelope(work.system, layout.first, layout.offsets, 6, work.right_side)
            _move_cameras(poses, layout.slots, work.right_side, trial_poses)
            _move_points(points, seen, layout.slots, work, trial_points)
            trial_cost = robust_cost(trial_poses, trial_points, seen, huber)
        if trial_cost < cost:
            poses[:], points[:] = trial_poses, trial_points
            gain, cost = cost - trial_cost, trial_cost
            damping, growth = max(damping / 10.0, _MIN_DAMPING), 4.0
            if gain <= tolerance * (cost + gain):
                return step + 1
        else:
            damping, growth = damping * growth, growth * 2.0
            if damping > _MAX_DAMPING or trial_cost <= cost * (1.0 + 1e-13):
                return step + 1
    return limit


@njit(cache=True)
def _reduce(poses, points, seen, layout, huber, damping, work):  # type: ignore[no-untyped-def]
    """Fill the reduced camera system S = U - W V^-1 W^T and its right side; keep V^-1, W and the points' gradients."""
    work.system[:] = 0.0
    work.right_side[:] = 0.0
    work.diagonal[:] = 0.0
    work.inverses[:] = 0.0
    normal, product, by_camera, by_point = np.empty(9), np.empty((6, 3)), np.empty((2, 6)), np.empty((2, 3))
    for p in range(points.shape[0]):
        start, end = seen.starts[p], seen.starts[p + 1]
        if _count_active(seen.active, start, end) < 2:
            continue
        normal[:] = 0.0
        for m in range(start, end):
            if seen.active[m]:
                pose, slot = poses[seen.cameras[m]], layout.slots[seen.cameras[m]]
                _add_observation(m, pose, points[p], slot, seen, layout, huber, normal, by_camera, by_point, work)
        work.gradients[p, 0], work.gradients[p, 1], work.gradients[p, 2] = normal[6], normal[7], normal[8]
        if _invert_damped(normal, max(damping, _MIN_DAMPING), work.inverses[p]):
            _eliminate_point(p, seen, layout, product, work)
    for i in range(layout.first.shape[0]):
        stride = 6 * (i - layout.first[i] + 1)
        for a in range(6):
            own = work.diagonal[6 * i + a]
            work.system[layout.offsets[i] + a * stride + stride - 6 + a] += damping * own if own > 0.0 else 1.0


@njit(cache=True, fastmath={"contract"})
def _add_observation(m, pose, point, slot, seen, layout, huber, normal, by_camera, by_point, work):  # type: ignore[no-untyped-def]
    """Add one observation to its point's block (`normal`: V's upper triangle, gradient) and its camera's block U."""
    u, v, x, y, z = project(pose, point, seen.intrinsics)
    cross = work.crosses[m]
    cross[:, :] = 0.0
    weight = seen.weights[m] * seen.weights[m]
    e0, e1 = u - seen.pixels[m, 0], v - seen.pixels[m, 1]
    chi2 = weight * (e0 * e0 + e1 * e1)
    if z <= 0.0 or chi2 >= _MAX_ERROR_SIGMA * _MAX_ERROR_SIGMA:
        return
    if chi2 > huber * huber:
        weight *= huber / math.sqrt(chi2)
    point_jacobian(pose, x, y, z, seen.intrinsics, by_point)
    k = 0
    for a in range(3):
        w0, w1 = weight * by_point[0, a], weight * by_point[1, a]
        normal[6 + a] -= w0 * e0 + w1 * e1
        for b in range(a, 3):
            normal[k] += w0 * by_point[0, b] + w1 * by_point[1, b]
            k += 1
    if slot < 0:
        return
    camera_jacobian(x, y, z, seen.intrinsics, by_camera)
    stride = 6 * (slot - layout.first[slot] + 1)
    block = layout.offsets[slot] + stride - 6
    for a in range(6):
        w0, w1 = weight * by_camera[0, a], weight * by_camera[1, a]
        work.right_side[6 * slot + a] -= w0 * e0 + w1 * e1
        work.diagonal[6 * slot + a] += w0 * by_camera[0, a] + w1 * by_camera[1, a]
        for b in range(a + 1):
            work.system[block + a * stride + b] += w0 * by_camera[0, b] + w1 * by_camera[1, b]
        for b in range(3):
            cross[b, a] = w0 * by_point[0, b] + w1 * by_point[1, b]


@njit(cache=True)
def _invert_damped(normal, damping, out):  # type: ignore[no-untyped-def]
    """Write the inverse (xx, xy, xz, yy, yz, zz) of a point's damped block; return False where it has none."""
    xy, xz, yz = normal[1], normal[2], normal[4]
    xx, yy, zz = normal[0] * (1.0 + damping), normal[3] * (1.0 + damping), normal[5] * (1.0 + damping)
    c0, c1, c2 = yy * zz - yz * yz, xz * yz - xy * zz, xy * yz - xz * yy
    determinant = xx * c0 + xy * c1 + xz * c2
    if not determinant > 1e-16 * xx * yy * zz:
        return False
    out[0], out[1], out[2] = c0 / determinant, c1 / determinant, c2 / determinant
    out[3] = (xx * zz - xz * xz) / determinant
    out[4] = (xy * xz - xx * yz) / determinant
    out[5] = (xx * yy - xy * xy) / determinant
    return True


@njit(cache=True, fastmath={"contract"})
def _eliminate_point(p, seen, layout, product, work):  # type: ignore[no-untyped-def]
    """Subtract W V^-1 W^T of one point from the system, block by block, and W V^-1 g from the right side."""
    inverse, system, crosses = work.inverses[p], work.system, work.crosses
    i0, i1, i2, i3, i4, i5 = inverse[0], inverse[1], inverse[2], inverse[3], inverse[4], inverse[5]
    g0, g1, g2 = work.gradients[p, 0], work.gradients[p, 1], work.gradients[p, 2]
    start, end = seen.starts[p], seen.starts[p + 1]
    for m in range(start, end):
        slot = layout.slots[seen.cameras[m]]
        if slot < 0 or not seen.active[m]:
            continue
        left, stride = layout.first[slot], 6 * (slot - layout.first[slot] + 1)
        for a in range(6):
            w0, w1, w2 = crosses[m, 0, a], crosses[m, 1, a], crosses[m, 2, a]
            y0 = product[a, 0] = w0 * i0 + w1 * i1 + w2 * i2
            y1 = product[a, 1] = w0 * i1 + w1 * i3 + w2 * i4
            y2 = product[a, 2] = w0 * i2 + w1 * i4 + w2 * i5
            work.right_side[6 * slot + a] -= y0 * g0 + y1 * g1 + y2 * g2
        for n in range(start, m + 1):
            other = layout.slots[seen.cameras[n]]
            if other < 0 or not seen.active[n]:
                continue
            block = layout.offsets[slot] + 6 * (other - left)
            for a in range(6):
                y0, y1, y2 = product[a, 0], product[a, 1], product[a, 2]
                row = block + a * stride
                for b in range(6):
                    system[row + b] -= y0 * crosses[n, 0, b] + y1 * crosses[n, 1, b] + y2 * crosses[n, 2, b]


@njit(cache=True)
def _move_cameras(poses, slots, step, out):  # type: ignore[no-untyped-def]
    rotation = np.empty((3, 3))
    for k in range(poses.shape[0]):
        if slots[k] < 0:
            continue
        own = step[6 * slots[k] : 6 * slots[k] + 6]
        so3_exp_into(own[3], own[4], own[5], rotation)
        for i in range(3):
            for j in range(4):
                out[k, i, j] = (
                    rotation[i, 0] * poses[k, 0, j] + rotation[i, 1] * poses[k, 1, j] + rotation[i, 2] * poses[k, 2, j]
                )
            out[k, i, 3] += own[i]


@njit(cache=True)
def _move_points(points, seen, slots, work, out):  # type: ignore[no-untyped-def]
    """Back substitution: each point's step is V^-1 (g - W^T step of the cameras)."""
    for p in range(points.shape[0]):
        inverse = work.inverses[p]
        out[p] = points[p]
        if inverse[0] == 0.0:
            continue
        g0, g1, g2 = work.gradients[p, 0], work.gradients[p, 1], work.gradients[p, 2]
        for m in range(seen.starts[p], seen.starts[p + 1]):
            slot = slots[seen.cameras[m]]
            if slot >= 0 and seen.active[m]:
                for a in range(6):
                    value = work.right_side[6 * slot + a]
                    g0 -= work.crosses[m, 0, a] * value
                    g1 -= work.crosses[m, 1, a] * value
                    g2 -= work.crosses[m, 2, a] * value
        out[p, 0] += inverse[0] * g0 + inverse[1] * g1 + inverse[2] * g2
        out[p, 1] += inverse[1] * g0 + inverse[3] * g1 + inverse[4] * g2
        out[p, 2] += inverse[2] * g0 + inverse[4] * g1 + inverse[5] * g2
