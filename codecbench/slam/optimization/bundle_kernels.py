"""Compiled kernels of bundle adjustment: reprojection, its derivatives, the normal equations, and the iteration.

The left update of a pose is x' = exp(w) x + v for points x in the camera's frame; its parameters are (v, w). Nothing
here checks an index: `bundle_adjustment.adjust` has done so.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from codecbench.core.kernels.compiled import compiled
from codecbench.slam.features.sorting import stable_order
from codecbench.slam.geometry.linear_systems import copy_numbers, factorize_envelope, solve_envelope
from codecbench.slam.optimization.bundle_schur import MIN_DAMPING, Workspace, eliminate, move_cameras, move_points

MAX_CHI2 = 1e8  # cost of a larger error, or of a point behind the camera; both have no gradient
_START_DAMPING = 1e-4
_MAX_DAMPING = 1e8


class Observations(NamedTuple):
    """Observations sorted by point: those of point p are `starts[p]` to `starts[p + 1]`."""

    cameras: Any
    """Camera of each observation (M,)."""
    starts: Any
    """First observation of each point (P + 1,)."""
    pixels: Any
    """Undistorted (M, 2)."""
    weights: Any
    """1 / sigma (M,)."""
    active: Any
    """Which observations are in use (M,), bool."""
    intrinsics: Any
    """fx, fy, cx, cy (4,)."""


@compiled
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


@compiled(error_model="numpy")
def reprojection(pose, point, u, v, weight, intrinsics):  # type: ignore[no-untyped-def]
    """Return x / z, y / z and 1 / z in the camera's frame, the error in pixels, and the chi-square up to MAX_CHI2."""
    z = pose[2, 0] * point[0] + pose[2, 1] * point[1] + pose[2, 2] * point[2] + pose[2, 3]
    if z <= 0.0:
        return 0.0, 0.0, 0.0, 0.0, 0.0, MAX_CHI2
    inverse = 1.0 / z
    x = inverse * (pose[0, 0] * point[0] + pose[0, 1] * point[1] + pose[0, 2] * point[2] + pose[0, 3])
    y = inverse * (pose[1, 0] * point[0] + pose[1, 1] * point[1] + pose[1, 2] * point[2] + pose[1, 3])
    e0, e1 = intrinsics[0] * x + intrinsics[2] - u, intrinsics[1] * y + intrinsics[3] - v
    return x, y, inverse, e0, e1, min(weight * weight * (e0 * e0 + e1 * e1), MAX_CHI2)


@compiled
def jacobians(pose, x, y, inverse, intrinsics):  # type: ignore[no-untyped-def]
    """Return the entries of the pixel's derivatives: first by the point, then by the left update (v, w) of the pose.

    By the point p00 p01 p02 / p10 p11 p12; by the pose a0 0 a2 a3 a4 a5 / 0 b1 b2 b3 b4 b5, at the point
    (x, y, 1) / inverse of the camera's frame. Scalars rather than arrays, and products of them written out below: the
    compiler keeps them in registers, five times as fast.
    """
    fx, fy = intrinsics[0], intrinsics[1]
    a0, b1 = fx * inverse, fy * inverse
    a2, b2 = -a0 * x, -b1 * y
    p00, p10 = a0 * pose[0, 0] + a2 * pose[2, 0], b1 * pose[1, 0] + b2 * pose[2, 0]
    p01, p11 = a0 * pose[0, 1] + a2 * pose[2, 1], b1 * pose[1, 1] + b2 * pose[2, 1]
    p02, p12 = a0 * pose[0, 2] + a2 * pose[2, 2], b1 * pose[1, 2] + b2 * pose[2, 2]
    a3, a4, a5 = -fx * x * y, fx * (1.0 + x * x), -fx * y
    b3, b4, b5 = -fy * (1.0 + y * y), fy * x * y, fy * x
    return p00, p01, p02, p10, p11, p12, a0, a2, a3, a4, a5, b1, b2, b3, b4, b5


@compiled
def _count_active(active, start, end):  # type: ignore[no-untyped-def]
    count = 0
    for m in range(start, end):
        if active[m]:
            count += 1
    return count


@compiled
def classify(poses, points, seen, limit, inliers):  # type: ignore[no-untyped-def]
    """Mark the observations in front of their camera with a chi-square of at most `limit`."""
    for p in range(points.shape[0]):
        for m in range(seen.starts[p], seen.starts[p + 1]):
            pose, u, v = poses[seen.cameras[m]], seen.pixels[m, 0], seen.pixels[m, 1]
            inliers[m] = reprojection(pose, points[p], u, v, seen.weights[m], seen.intrinsics)[5] <= limit


@compiled
def robust_cost(poses, points, seen, huber):  # type: ignore[no-untyped-def]
    """Return half the sum of Huber's function of the active chi-squares, of points seen at least twice."""
    huber2, total = huber * huber, 0.0
    cameras, starts, pixels, weights, active, intrinsics = seen
    for p in range(points.shape[0]):
        if _count_active(active, starts[p], starts[p + 1]) < 2:
            continue
        point = points[p]
        for m in range(starts[p], starts[p + 1]):
            if active[m]:
                chi2 = reprojection(poses[cameras[m]], point, pixels[m, 0], pixels[m, 1], weights[m], intrinsics)[5]
                total += chi2 if chi2 <= huber2 else 2.0 * huber * math.sqrt(chi2) - huber2
    return 0.5 * total


@compiled
def minimize(poses, points, seen, layout, huber, limit, tolerance):  # type: ignore[no-untyped-def]
    """Levenberg-Marquardt in place on poses (K, 3, 4) and points (P, 3); return the number of steps tried."""
    slots, first, offsets = layout
    point_count, camera_count = points.shape[0], first.shape[0]
    work = Workspace(
        np.empty((point_count, 9)), np.empty((camera_count, 27)), np.empty((seen.cameras.shape[0], 3, 6)),
        np.empty((point_count, 6)), np.empty(offsets[camera_count]), np.empty(6 * camera_count),
    )  # fmt: skip
    trial_poses, trial_points = poses.copy(), points.copy()
    damping, growth, linear = _START_DAMPING, 4.0, False
    cost = robust_cost(poses, points, seen, huber)
    for step in range(limit):
        if not linear:
            linearize(poses, points, seen, slots, huber, work)
        eliminate(seen, layout, damping, work)
        trial_cost, linear = np.inf, True
        if factorize_envelope(work.system, first, offsets, 6):
            solve_envelope(work.system, first, offsets, 6, work.right_side)
            move_cameras(poses, slots, work.right_side, trial_poses)
            move_points(points, seen, slots, work, trial_points)
            trial_cost = robust_cost(trial_poses, trial_points, seen, huber)
        if trial_cost < cost:
            copy_numbers(trial_poses, poses)
            copy_numbers(trial_points, points)
            gain, cost, linear = cost - trial_cost, trial_cost, False
            damping, growth = max(damping / 10.0, MIN_DAMPING), 4.0
            if gain <= tolerance * (cost + gain):
                return step + 1
        else:
            damping, growth = damping * growth, growth * 2.0
            if damping > _MAX_DAMPING or trial_cost <= cost * (1.0 + 1e-13):
                return step + 1
    return limit


@compiled(error_model="numpy")
def linearize(poses, points, seen, slots, huber, work):  # type: ignore[no-untyped-def]
    """Fill the points' blocks V, the cameras' blocks U, both with gradients, and the cross terms W."""
    cameras, starts, pixels, weights, active, intrinsics = seen
    normals, blocks, crosses = work.normals, work.blocks, work.crosses
    normals[:] = 0.0
    blocks[:] = 0.0
    for p in range(points.shape[0]):
        if _count_active(active, starts[p], starts[p + 1]) < 2:
            continue
        point, normal = points[p], normals[p]
        xx = xy = xz = yy = yz = zz = gx = gy = gz = 0.0
        for m in range(starts[p], starts[p + 1]):
            if not active[m]:
                continue
            pose, cross, weight = poses[cameras[m]], crosses[m], weights[m]
            x, y, inverse, e0, e1, chi2 = reprojection(pose, point, pixels[m, 0], pixels[m, 1], weight, intrinsics)
            if chi2 >= MAX_CHI2:
                for a in range(6):
                    cross[0, a] = cross[1, a] = cross[2, a] = 0.0
                continue
            w = weight * weight if chi2 <= huber * huber else weight * weight * huber / math.sqrt(chi2)
            p00, p01, p02, p10, p11, p12, a0, a2, a3, a4, a5, b1, b2, b3, b4, b5 = jacobians(
                pose, x, y, inverse, intrinsics
            )
            q00, q01, q02, q10, q11, q12 = w * p00, w * p01, w * p02, w * p10, w * p11, w * p12
            xx, xy, xz = xx + q00 * p00 + q10 * p10, xy + q00 * p01 + q10 * p11, xz + q00 * p02 + q10 * p12
            yy, yz, zz = yy + q01 * p01 + q11 * p11, yz + q01 * p02 + q11 * p12, zz + q02 * p02 + q12 * p12
            gx, gy, gz = gx - q00 * e0 - q10 * e1, gy - q01 * e0 - q11 * e1, gz - q02 * e0 - q12 * e1
            slot = slots[cameras[m]]
            if slot >= 0:
                _add_camera(blocks[slot], a0, a2, a3, a4, a5, b1, b2, b3, b4, b5, w, e0, e1)
                cross[0, 0], cross[0, 1], cross[0, 2] = q00 * a0, q10 * b1, q00 * a2 + q10 * b2
                cross[1, 0], cross[1, 1], cross[1, 2] = q01 * a0, q11 * b1, q01 * a2 + q11 * b2
                cross[2, 0], cross[2, 1], cross[2, 2] = q02 * a0, q12 * b1, q02 * a2 + q12 * b2
                cross[0, 3], cross[0, 4], cross[0, 5] = q00 * a3 + q10 * b3, q00 * a4 + q10 * b4, q00 * a5 + q10 * b5
                cross[1, 3], cross[1, 4], cross[1, 5] = q01 * a3 + q11 * b3, q01 * a4 + q11 * b4, q01 * a5 + q11 * b5
                cross[2, 3], cross[2, 4], cross[2, 5] = q02 * a3 + q12 * b3, q02 * a4 + q12 * b4, q02 * a5 + q12 * b5
        normal[0], normal[1], normal[2], normal[3], normal[4], normal[5] = xx, xy, xz, yy, yz, zz
        normal[6], normal[7], normal[8] = gx, gy, gz


@compiled
def _add_camera(block, a0, a2, a3, a4, a5, b1, b2, b3, b4, b5, w, e0, e1):  # type: ignore[no-untyped-def]
    """Add one observation to U (lower triangle, row by row) and to minus the gradient."""
    c0, c2, c3, c4, c5 = w * a0, w * a2, w * a3, w * a4, w * a5
    d1, d2, d3, d4, d5 = w * b1, w * b2, w * b3, w * b4, w * b5
    block[0] += c0 * a0
    block[2] += d1 * b1
    block[3] += c2 * a0
    block[4] += d2 * b1
    block[5] += c2 * a2 + d2 * b2
    block[6] += c3 * a0
    block[7] += d3 * b1
    block[8] += c3 * a2 + d3 * b2
    block[9] += c3 * a3 + d3 * b3
    block[10] += c4 * a0
    block[11] += d4 * b1
    block[12] += c4 * a2 + d4 * b2
    block[13] += c4 * a3 + d4 * b3
    block[14] += c4 * a4 + d4 * b4
    block[15] += c5 * a0
    block[16] += d5 * b1
    block[17] += c5 * a2 + d5 * b2
    block[18] += c5 * a3 + d5 * b3
    block[19] += c5 * a4 + d5 * b4
    block[20] += c5 * a5 + d5 * b5
    block[21] -= c0 * e0
    block[22] -= d1 * e1
    block[23] -= c2 * e0 + d2 * e1
    block[24] -= c3 * e0 + d3 * e1
    block[25] -= c4 * e0 + d4 * e1
    block[26] -= c5 * e0 + d5 * e1
