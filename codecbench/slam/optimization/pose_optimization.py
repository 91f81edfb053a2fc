"""Pose of a camera from fixed points: motion-only bundle adjustment with outlier rejection."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from codecbench.core.kernels.compiled import compiled
from codecbench.slam.geometry.linear_systems import copy_numbers, solve_symmetric
from codecbench.slam.geometry.rotations import Array, orthonormalize, so3_exp_into
from codecbench.slam.thresholds import CHI2_95_2DOF, POSE_GATE_MEDIANS

_ROUNDS = 4
_ROBUST_ROUNDS = 2  # then the outliers are out, and Huber's kernel would only slow the convergence
_ITERATIONS_A_ROUND = 10
_CONVERGED_STEP = 1e-7  # radians, and translation in units of the scene's median depth
_MIN_POINTS = 3


def optimize_pose(
    camera_from_world: Array,
    points_world: Array,
    pixels: Array,
    inverse_sigma2: Array,
    intrinsics: Array,
) -> tuple[Array, NDArray[np.bool_]]:
    """Return the pose that minimizes the reprojection error of fixed points, and which points are inliers.

    `camera_from_world` (4, 4) starts the search; `points_world` (N, 3); `pixels` (N, 2) undistorted; `inverse_sigma2`
    (N,) in 1/px^2; `intrinsics` (4,): fx, fy, cx, cy in pixels. Returns `camera_from_world` (4, 4) and `inliers` (N,):
    in front of the camera with a chi-square of at most 5.991.

    There are four rounds of Levenberg-Marquardt, with Huber's kernel in the first two. Each uses the points whose error
    in the last one was at most POSE_GATE_MEDIANS times the median, but one deviation at least and the gate of inliers
    at most; a point may come back. If fewer than three points remain, the pose of the last good round is returned with
    its inliers. Raises ValueError for arrays that do not fit together. Source: ORB-SLAM, T-RO 31(5), 2015, section V;
    each round starts from the last one's pose, not from the first, and the gate by the median is own.
    """
    pose = np.array(camera_from_world, dtype=np.float64)
    points_world = np.ascontiguousarray(points_world, dtype=np.float64)
    pixels = np.ascontiguousarray(pixels, dtype=np.float64)
    weights = np.ascontiguousarray(inverse_sigma2, dtype=np.float64)
    intrinsics = np.ascontiguousarray(intrinsics, dtype=np.float64)
    count = len(points_world)
    if points_world.shape != (count, 3) or pixels.shape != (count, 2) or weights.shape != (count,):
        raise ValueError(
            f"optimize_pose: points_world {points_world.shape}, pixels {pixels.shape} and inverse_sigma2 "
            f"{weights.shape} must be (N, 3), (N, 2) and (N,)"
        )
    if pose.shape != (4, 4) or intrinsics.shape != (4,):
        raise ValueError(f"optimize_pose: pose {pose.shape} and intrinsics {intrinsics.shape} must be (4, 4) and (4,)")
    inliers = np.zeros(count, dtype=np.bool_)
    optimize_in_place(pose, points_world, pixels, weights, intrinsics, inliers)
    pose[:3, :3] = orthonormalize(pose[:3, :3])
    return pose, inliers


@compiled
def optimize_in_place(pose, points, pixels, weights, intrinsics, inliers):  # type: ignore[no-untyped-def]
    """Optimize as optimize_pose does, for compiled code: moves `pose`, marks `inliers`; rotation up to rounding."""
    active = np.ones(len(points), dtype=np.bool_)
    chi2 = np.empty(len(points))
    for round_index in range(_ROUNDS):
        if np.count_nonzero(active) < _MIN_POINTS:
            break
        trial = pose.copy()
        _minimize(trial, points, pixels, weights, intrinsics, active, round_index < _ROBUST_ROUNDS)
        _measure(trial, points, pixels, weights, intrinsics, chi2)
        trial_active = chi2 <= _chi2_gate(chi2)
        unchanged = round_index >= _ROBUST_ROUNDS and np.array_equal(trial_active, active)
        active = trial_active
        if np.count_nonzero(active) < _MIN_POINTS and round_index > 0:
            break
        copy_numbers(trial, pose)
        copy_numbers(chi2 <= CHI2_95_2DOF, inliers)
        if unchanged:
            break


@compiled
def _chi2_gate(chi2):  # type: ignore[no-untyped-def]
    """Return the chi-square up to which a point counts: by the median of all, one deviation at least."""
    return min(CHI2_95_2DOF, max(POSE_GATE_MEDIANS**2 * np.median(chi2), 1.0))


@compiled
def _minimize(pose, points, pixels, weights, intrinsics, active, robust):  # type: ignore[no-untyped-def]
    """Levenberg-Marquardt on the six parameters of one pose, in place."""
    hessian, gradient = np.empty((6, 6)), np.empty(6)
    trial_hessian, trial_gradient = np.empty((6, 6)), np.empty(6)
    trial, rotation = np.empty((4, 4)), np.empty((3, 3))
    damping = 1e-4
    cost, depth = _linearize(pose, points, pixels, weights, intrinsics, active, robust, hessian, gradient)
    for _ in range(_ITERATIONS_A_ROUND):
        step, solved = solve_symmetric(hessian, gradient, damping)
        if not solved:
            damping *= 10.0
            continue
        so3_exp_into(step[3], step[4], step[5], rotation)
        _move(pose, rotation, step, trial)
        trial_cost, trial_depth = _linearize(
            trial, points, pixels, weights, intrinsics, active, robust, trial_hessian, trial_gradient
        )
        if trial_cost < cost:
            copy_numbers(trial, pose)
            gain = cost - trial_cost
            cost, depth = trial_cost, trial_depth
            hessian, trial_hessian = trial_hessian, hessian
            gradient, trial_gradient = trial_gradient, gradient
            damping = max(damping * 0.1, 1e-9)
            if gain < 1e-6 * cost:
                break
        else:
            damping *= 10.0
        size = abs(step[3]) + abs(step[4]) + abs(step[5])
        size += (abs(step[0]) + abs(step[1]) + abs(step[2])) / max(depth, 1e-12)
        if size < _CONVERGED_STEP:
            break


@compiled
def _move(pose, rotation, step, out):  # type: ignore[no-untyped-def]
    """Write the left update of a pose: x' = exp(w) x + v for points x in the camera's frame."""
    for i in range(3):
        for j in range(4):
            out[i, j] = rotation[i, 0] * pose[0, j] + rotation[i, 1] * pose[1, j] + rotation[i, 2] * pose[2, j]
        out[i, 3] += step[i]
    out[3, 0], out[3, 1], out[3, 2], out[3, 3] = 0.0, 0.0, 0.0, 1.0


@compiled
def _linearize(pose, points, pixels, weights, intrinsics, active, robust, hessian, gradient):  # type: ignore[no-untyped-def]
    """Fill the normal equations H step = gradient; return the cost and the mean depth.

    An active point behind the camera has no gradient and a constant cost, high enough that no step hides a point there.
    """
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    threshold = math.sqrt(CHI2_95_2DOF)
    cost, depths, in_front = 0.0, 0.0, 0
    g0 = g1 = g2 = g3 = g4 = g5 = h00 = h11 = h20 = h21 = h22 = h30 = h31 = h32 = h33 = 0.0
    h40 = h41 = h42 = h43 = h44 = h50 = h51 = h52 = h53 = h54 = h55 = 0.0
    r00, r01, r02, t0 = pose[0, 0], pose[0, 1], pose[0, 2], pose[0, 3]
    r10, r11, r12, t1 = pose[1, 0], pose[1, 1], pose[1, 2], pose[1, 3]
    r20, r21, r22, t2 = pose[2, 0], pose[2, 1], pose[2, 2], pose[2, 3]
    for i in range(points.shape[0]):
        if not active[i]:
            continue
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        z = r20 * px + r21 * py + r22 * pz + t2
        if z <= 0.0:
            cost += 1e6
            continue
        inverse_z = 1.0 / z
        x = (r00 * px + r01 * py + r02 * pz + t0) * inverse_z
        y = (r10 * px + r11 * py + r12 * pz + t1) * inverse_z
        e0, e1 = pixels[i, 0] - (fx * x + cx), pixels[i, 1] - (fy * y + cy)
        weight = weights[i]
        chi2 = weight * (e0 * e0 + e1 * e1)
        if robust and chi2 > CHI2_95_2DOF:
            error = math.sqrt(chi2)
            cost += 2.0 * threshold * error - CHI2_95_2DOF
            weight *= threshold / error
        else:
            cost += chi2
        depths += z
        in_front += 1
        a0, a2, a3, a4, a5 = fx * inverse_z, -fx * x * inverse_z, -fx * x * y, fx * (1.0 + x * x), -fx * y
        b1, b2, b3, b4, b5 = fy * inverse_z, -fy * y * inverse_z, -fy * (1.0 + y * y), fy * x * y, fy * x
        c0, c2, c3, c4, c5 = weight * a0, weight * a2, weight * a3, weight * a4, weight * a5
        d1, d2, d3, d4, d5 = weight * b1, weight * b2, weight * b3, weight * b4, weight * b5
        g0, g1, g2 = g0 + c0 * e0, g1 + d1 * e1, g2 + (c2 * e0 + d2 * e1)
        g3, g4, g5 = g3 + (c3 * e0 + d3 * e1), g4 + (c4 * e0 + d4 * e1), g5 + (c5 * e0 + d5 * e1)
        h00, h11 = h00 + c0 * a0, h11 + d1 * b1
        h20, h21, h22 = h20 + c2 * a0, h21 + d2 * b1, h22 + (c2 * a2 + d2 * b2)
        h30, h31, h32, h33 = h30 + c3 * a0, h31 + d3 * b1, h32 + (c3 * a2 + d3 * b2), h33 + (c3 * a3 + d3 * b3)
        h40, h41, h42 = h40 + c4 * a0, h41 + d4 * b1, h42 + (c4 * a2 + d4 * b2)
        h43, h44 = h43 + (c4 * a3 + d4 * b3), h44 + (c4 * a4 + d4 * b4)
        h50, h51, h52 = h50 + c5 * a0, h51 + d5 * b1, h52 + (c5 * a2 + d5 * b2)
        h53, h54, h55 = h53 + (c5 * a3 + d5 * b3), h54 + (c5 * a4 + d5 * b4), h55 + (c5 * a5 + d5 * b5)
    gradient[0], gradient[1], gradient[2], gradient[3], gradient[4], gradient[5] = g0, g1, g2, g3, g4, g5
    hessian[0, 0], hessian[1, 0], hessian[1, 1] = h00, 0.0, h11
    hessian[2, 0], hessian[2, 1], hessian[2, 2] = h20, h21, h22
    hessian[3, 0], hessian[3, 1], hessian[3, 2], hessian[3, 3] = h30, h31, h32, h33
    hessian[4, 0], hessian[4, 1], hessian[4, 2], hessian[4, 3], hessian[4, 4] = h40, h41, h42, h43, h44
    hessian[5, 0], hessian[5, 1], hessian[5, 2], hessian[5, 3], hessian[5, 4], hessian[5, 5] = (
        h50,
        h51,
        h52,
        h53,
        h54,
        h55,
    )
    return cost, depths / max(in_front, 1)


@compiled
def _measure(pose, points, pixels, weights, intrinsics, chi2):  # type: ignore[no-untyped-def]
    """Fill in the chi-square of each point, infinite behind the camera."""
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    for i in range(points.shape[0]):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        z = pose[2, 0] * px + pose[2, 1] * py + pose[2, 2] * pz + pose[2, 3]
        chi2[i] = np.inf
        if z > 0.0:
            x = (pose[0, 0] * px + pose[0, 1] * py + pose[0, 2] * pz + pose[0, 3]) / z
            y = (pose[1, 0] * px + pose[1, 1] * py + pose[1, 2] * pz + pose[1, 3]) / z
            e0, e1 = pixels[i, 0] - (fx * x + cx), pixels[i, 1] - (fy * y + cy)
            chi2[i] = weights[i] * (e0 * e0 + e1 * e1)
