"""The pose graph in Sim(3): keyframe similarities that best fit relative measurements, with scale drift."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import zeta

from codecbench.core.kernels.compiled import compiled
from codecbench.slam.geometry.linear_systems import (
    Indices,
    copy_numbers,
    envelope_offsets,
    envelope_order,
    factorize_envelope,
    first_neighbors,
    solve_envelope,
)
from codecbench.slam.geometry.rotations import Array, skew
from codecbench.slam.geometry.transforms import sim3_adjoint, sim3_compose, sim3_exp, sim3_inverse, sim3_log

_START_DAMPING = 1e-8  # the graph is nearly linear in these parameters, so the first step is almost Gauss-Newton's
_MIN_DAMPING = 1e-12
_MAX_DAMPING = 1e8

# B_2k / (2k)! for k = 1..24, B the Bernoulli numbers: the even part of x / (exp(x) - 1).
_BERNOULLI = np.array([(-1) ** (k + 1) * 2.0 * zeta(2 * k) / (2.0 * math.pi) ** (2 * k) for k in range(1, 25)])


@dataclass(frozen=True)
class PoseGraphSolution:
    """Result of a pose graph optimization."""

    similarities: Array
    """Optimized (N, 4, 4)."""
    cost_before: float
    """Half the weighted squared error."""
    cost_after: float
    """The same after the optimization."""
    iterations: int
    """Steps tried."""


def optimize(
    similarities: Array,
    edges: Indices,
    measurements: Array,
    fixed: NDArray[np.bool_],
    *,
    weights: Array | None = None,
    iterations: int = 20,
    tolerance: float = 1e-6,
) -> PoseGraphSolution:
    """Return the similarities that agree best with relative measurements.

    `similarities` (N, 4, 4): camera_from_world of each node; `edges` (E, 2): nodes i, j; `measurements` (E, 4, 4):
    `j_from_i` of each edge; `fixed` (N,) marks nodes that stay. `weights`, (E,) or (E, 7), multiply the squared
    error, in the order translation, rotation, log scale; 1 if left out. The error of an edge is the (7,) logarithm
    of j_from_i S_i S_j^-1. Ends when a step lowers the cost by less than `tolerance` of it. Without a fixed node the
    whole graph stays near where it was. Raises ValueError for arrays that do not fit together, nodes out of range,
    edges from a node to itself, values that are not finite and negative weights.
    Source: Strasdat, Montiel, Davison, "Scale drift-aware large scale monocular SLAM", RSS 2010, equation 9.
    """
    nodes = np.array(similarities, dtype=np.float64)
    edges, fixed = np.ascontiguousarray(edges, dtype=np.int64), np.asarray(fixed, dtype=np.bool_)
    measurements = np.ascontiguousarray(measurements, dtype=np.float64)
    edge_weights = np.ones(len(edges)) if weights is None else np.asarray(weights, dtype=np.float64)
    edge_weights = np.array(
        np.broadcast_to(edge_weights[:, None] if edge_weights.ndim == 1 else edge_weights, (len(edge_weights), 7))
    )
    _check(nodes, edges, measurements, edge_weights, fixed)
    slots, first = _layout(edges, fixed)
    offsets = envelope_offsets(first, 7)
    before, after, steps = _minimize(
        nodes, edges, measurements, edge_weights, slots, first, offsets, int(iterations), float(tolerance)
    )
    return PoseGraphSolution(nodes, float(before), float(after), int(steps))


def _check(nodes: Array, edges: Indices, measurements: Array, weights: Array, fixed: NDArray[np.bool_]) -> None:
    expected = {
        "similarities": (nodes, (len(nodes), 4, 4)),
        "edges": (edges, (len(edges), 2)),
        "measurements": (measurements, (len(edges), 4, 4)),
        "weights": (weights, (len(edges), 7)),
        "fixed": (fixed, (len(nodes),)),
    }
    for name, (array, shape) in expected.items():
        if array.shape != shape:
            raise ValueError(f"pose_graph.optimize: {name} has shape {array.shape}; expected {shape}")
        if not np.isfinite(array).all():
            raise ValueError(f"pose_graph.optimize: {name} has a value that is not finite")
    if len(edges) and (edges.min() < 0 or edges.max() >= len(nodes)):
        raise ValueError(
            f"pose_graph.optimize: edges span nodes {edges.min()}..{edges.max()}; allowed 0..{len(nodes) - 1}"
        )
    if (edges[:, 0] == edges[:, 1]).any():
        raise ValueError("pose_graph.optimize: an edge joins a node to itself")
    if (weights < 0.0).any():
        raise ValueError("pose_graph.optimize: weights have a negative value")
    for name, array in (("similarities", nodes), ("measurements", measurements)):
        if len(array) and not (np.linalg.det(array[:, :3, :3]) > 0.0).all():
            raise ValueError(f"pose_graph.optimize: {name} has a matrix that is no similarity: determinant <= 0")


def _layout(edges: Indices, fixed: NDArray[np.bool_]) -> tuple[Indices, Indices]:
    """Return the position of each node in the linear system, -1 if fixed, and the system's envelope."""
    slots = np.full(len(fixed), -1, dtype=np.int64)
    free = np.flatnonzero(~fixed)
    slots[free] = np.arange(len(free))
    adjacency = np.zeros((len(free), len(free)), dtype=np.bool_)
    ends = slots[edges]
    ends = ends[(ends >= 0).all(axis=1)]
    adjacency[ends[:, 0], ends[:, 1]] = adjacency[ends[:, 1], ends[:, 0]] = True
    order = envelope_order(adjacency)
    slots[free[order]] = np.arange(len(free))
    return slots, first_neighbors(adjacency[np.ix_(order, order)])


@compiled
def edge_error(j_from_i, node_i, node_j):  # type: ignore[no-untyped-def]
    """Return the error (7,) of one edge: the logarithm of j_from_i S_i S_j^-1."""
    return sim3_log(sim3_compose(sim3_compose(j_from_i, node_i), sim3_inverse(node_j)))


@compiled
def edge_jacobians(j_from_i, error):  # type: ignore[no-untyped-def]
    """Return the derivatives (7, 7) of an edge's error by the left updates exp(x) S of its two nodes.

    With J the left Jacobian of Sim(3) at the error e: by node i, J^-1(e) Ad(j_from_i); by node j, -J^-1(-e). J^-1 is
    summed as the power series of ad / (exp(ad) - 1), which converges while the rotation of the error is below 2 pi.
    """
    algebra = np.zeros((7, 7))
    turn, shift = skew(error[3:6]), skew(error[:3])
    for a in range(3):
        for b in range(3):
            algebra[a, b] = algebra[a + 3, b + 3] = turn[a, b]
            algebra[a, b + 3] = shift[a, b]
        algebra[a, a] += error[6]
        algebra[a, 6] = -error[a]
    square = algebra @ algebra
    power, even = np.eye(7), np.eye(7)
    for k in range(_BERNOULLI.shape[0]):
        power = power @ square
        term = _BERNOULLI[k] * power
        even += term
        if np.abs(term).max() < 1e-17:
            break
    return (even - 0.5 * algebra) @ sim3_adjoint(j_from_i), -(even + 0.5 * algebra)


@compiled
def _cost(nodes, edges, measurements, weights):  # type: ignore[no-untyped-def]
    total = 0.0
    for e in range(edges.shape[0]):
        error = edge_error(measurements[e], nodes[edges[e, 0]], nodes[edges[e, 1]])
        for k in range(7):
            total += weights[e, k] * error[k] * error[k]
    return 0.5 * total


@compiled
def _minimize(nodes, edges, measurements, weights, slots, first, offsets, limit, tolerance):  # type: ignore[no-untyped-def]
    """Levenberg-Marquardt in place on `nodes`; return the cost before, the cost after and the steps tried."""
    count = first.shape[0]
    system, gradient = np.empty(offsets[count]), np.empty(7 * count)
    damped = np.empty_like(system)
    before = cost = _cost(nodes, edges, measurements, weights)
    damping, growth, linear, steps = _START_DAMPING, 10.0, False, 0
    while steps < limit and count > 0:
        steps += 1
        if not linear:
            _linearize(nodes, edges, measurements, weights, slots, first, offsets, system, gradient)
            linear = True
        copy_numbers(system, damped)
        _damp(damped, first, offsets, damping)
        trial, trial_cost = nodes, np.inf
        if factorize_envelope(damped, first, offsets, 7):
            step = gradient.copy()
            solve_envelope(damped, first, offsets, 7, step)
            trial = _update_nodes(nodes, slots, step)
            trial_cost = _cost(trial, edges, measurements, weights)
        if trial_cost < cost:
            gain, cost, linear = cost - trial_cost, trial_cost, False
            copy_numbers(trial, nodes)
            damping, growth = max(damping / 10.0, _MIN_DAMPING), 10.0
            if gain <= tolerance * (cost + gain):
                break
        else:
            damping *= growth
            if damping > _MAX_DAMPING or trial_cost <= cost * (1.0 + 1e-13):
                break
    return before, cost, steps


@compiled
def _damp(system, first, offsets, damping):  # type: ignore[no-untyped-def]
    """Add the damping to the diagonal of the system."""
    for i in range(first.shape[0]):
        stride = 7 * (i - first[i] + 1)
        for a in range(7):
            entry = offsets[i] + a * stride + stride - 7 + a
            system[entry] += damping * system[entry] if system[entry] > 0.0 else 1.0


@compiled
def _update_nodes(nodes, slots, step):  # type: ignore[no-untyped-def]
    """Return the nodes after the left updates of `step`."""
    out = nodes.copy()
    for k in range(nodes.shape[0]):
        if slots[k] >= 0:
            copy_numbers(sim3_compose(sim3_exp(step[7 * slots[k] : 7 * slots[k] + 7]), nodes[k]), out[k])
    return out


@compiled
def _linearize(nodes, edges, measurements, weights, slots, first, offsets, system, gradient):  # type: ignore[no-untyped-def]
    """Fill the normal equations: the lower blocks of the system under its envelope, and minus the gradient."""
    system[:] = 0.0
    gradient[:] = 0.0
    for e in range(edges.shape[0]):
        error = edge_error(measurements[e], nodes[edges[e, 0]], nodes[edges[e, 1]])
        jacobians = edge_jacobians(measurements[e], error)
        for a in range(2):
            row = slots[edges[e, a]]
            if row < 0:
                continue
            weighted = jacobians[a].T * weights[e]
            gradient[7 * row : 7 * row + 7] -= weighted @ error
            for b in range(2):
                column = slots[edges[e, b]]
                if 0 <= column <= row:
                    _add_block(weighted @ jacobians[b], row, column, first, offsets, system)


@compiled
def _add_block(block, row, column, first, offsets, system):  # type: ignore[no-untyped-def]
    stride = 7 * (row - first[row] + 1)
    start = offsets[row] + 7 * (column - first[row])
    for a in range(7):
        for b in range(7):
            system[start + a * stride + b] += block[a, b]
