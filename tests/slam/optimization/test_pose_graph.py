from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.optimize import approx_fprime, least_squares

from codecbench.slam.geometry.rotations import so3_exp
from codecbench.slam.geometry.transforms import sim3_compose, sim3_exp, sim3_inverse, sim3_log, sim3_scale
from codecbench.slam.optimization import pose_graph

pytestmark = pytest.mark.thorough

NOISE = np.array([0.02] * 3 + [0.003] * 3 + [0.005])


def ring(count: int) -> np.ndarray:
    """True camera_from_world (N, 4, 4) of a drive round a circle of 20 that ends where it began."""
    out = []
    for angle in np.linspace(0.0, 2.0 * np.pi, count):
        rotation = so3_exp(np.array([0.0, -angle, 0.0]))
        centre = 20.0 * np.array([np.sin(angle), 0.02 * np.sin(3.0 * angle), np.cos(angle)])
        motion = np.eye(4)
        motion[:3, :3], motion[:3, 3] = rotation, -rotation @ centre
        out.append(motion)
    return np.array(out)


def relative(nodes: np.ndarray, edges: np.ndarray) -> np.ndarray:
    return np.array([sim3_compose(nodes[j], sim3_inverse(nodes[i])) for i, j in edges])


def drifting(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Truth, odometry chained with drift, edges to the next five and across the loop, and their measurements."""
    truth = ring(count)
    near = [(i, i + step) for step in range(1, 6) for i in range(count - step)]
    loop = [(k, count - 1 - k) for k in range(3)]
    measured = relative(truth, np.array(near + loop))
    measured[: len(near)] = [sim3_exp(rng.normal(0.0, NOISE)) @ m for m in measured[: len(near)]]
    nodes = [truth[0]]
    for i in range(count - 1):
        nodes.append(measured[i] @ nodes[-1])
    return truth, np.array(nodes), np.array(near + loop), measured


def centres(nodes: np.ndarray) -> np.ndarray:
    return np.array([sim3_inverse(node)[:3, 3] for node in nodes])


def first_fixed(count: int) -> np.ndarray:
    return np.arange(count) == 0


@pytest.mark.parametrize("size", [0.0, 1e-6, 0.1, 1.0, 2.5])
def test_jacobians_against_finite_differences(size: float, rng: np.random.Generator) -> None:
    direction = rng.normal(size=7)
    node_i, j_from_i = sim3_exp(rng.normal(0.0, 0.5, 7)), sim3_exp(rng.normal(0.0, 0.5, 7))
    error = size * direction / np.linalg.norm(direction)
    node_j = sim3_inverse(sim3_exp(error)) @ j_from_i @ node_i
    by_i, by_j = pose_graph.edge_jacobians(j_from_i, pose_graph.edge_error(j_from_i, node_i, node_j))
    numeric_i = approx_fprime(
        np.zeros(7), lambda x: pose_graph.edge_error(j_from_i, sim3_exp(x) @ node_i, node_j), 1e-7
    )
    numeric_j = approx_fprime(
        np.zeros(7), lambda x: pose_graph.edge_error(j_from_i, node_i, sim3_exp(x) @ node_j), 1e-7
    )
    np.testing.assert_allclose(by_i, numeric_i, atol=3e-6)
    np.testing.assert_allclose(by_j, numeric_j, atol=3e-6)


@pytest.mark.parametrize("weighted", [False, True])
def test_the_same_minimum_as_scipy(weighted: bool, rng: np.random.Generator) -> None:
    _, nodes, edges, measured = drifting(rng, 12)
    weights = rng.uniform(0.2, 5.0, (len(edges), 7)) if weighted else np.ones((len(edges), 7))

    def residuals(x: np.ndarray) -> np.ndarray:
        moved = [nodes[0], *(sim3_exp(d) @ n for d, n in zip(x.reshape(-1, 7), nodes[1:], strict=True))]
        errors = [sim3_log(m @ moved[i] @ np.linalg.inv(moved[j])) for (i, j), m in zip(edges, measured, strict=True)]
        return (np.array(errors) * np.sqrt(weights)).ravel()

    best = least_squares(residuals, np.zeros(77), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    ours = pose_graph.optimize(
        nodes, edges, measured, first_fixed(12), weights=weights if weighted else None, iterations=50, tolerance=1e-12
    )
    assert ours.cost_before == pytest.approx(0.5 * (residuals(np.zeros(77)) ** 2).sum(), rel=1e-9)
    assert ours.cost_after == pytest.approx(best.cost, rel=1e-6)


def test_exact_measurements_bring_back_the_loop(rng: np.random.Generator) -> None:
    truth = ring(100)
    edges = np.array([(i, i + 1) for i in range(99)] + [(99, 0), (10, 90)])
    nodes = np.array([sim3_exp(rng.normal(0.0, 0.05, 7)) @ node for node in truth])
    nodes[0] = truth[0]
    found = pose_graph.optimize(nodes, edges, relative(truth, edges), first_fixed(100), tolerance=1e-14)
    np.testing.assert_allclose(found.similarities, truth, atol=1e-8)
    assert found.cost_after < 1e-18


def test_scale_drift_is_spread_round_the_loop() -> None:
    """A chain whose scale grows by a known factor at each step, and an edge that says: back at the start."""
    truth = ring(61)
    edges = np.array([(i, i + 1) for i in range(60)] + [(60, 0)])
    measured = relative(truth, edges)
    measured[:60] = [sim3_exp(np.array([0, 0, 0, 0, 0, 0, 0.01])) @ m for m in measured[:60]]
    nodes = [truth[0]]
    for i in range(60):
        nodes.append(measured[i] @ nodes[-1])
    found = pose_graph.optimize(np.array(nodes), edges, measured, first_fixed(61), iterations=50, tolerance=1e-12)
    assert sim3_scale(nodes[-1]) == pytest.approx(np.exp(0.6))
    scales = np.array([sim3_scale(node) for node in found.similarities])
    assert np.abs(np.log(scales)).max() < 0.02
    assert np.abs(centres(found.similarities) - centres(truth)).max() < 0.6
    assert np.abs(centres(np.array(nodes)) - centres(truth)).max() > 5.0


@pytest.mark.parametrize("count", [150, 400])
def test_a_noisy_loop_comes_much_nearer_to_the_truth(count: int, rng: np.random.Generator) -> None:
    truth, nodes, edges, measured = drifting(rng, count)
    found = pose_graph.optimize(nodes, edges, measured, first_fixed(count))
    before = np.linalg.norm(centres(nodes) - centres(truth), axis=1).mean()
    after = np.linalg.norm(centres(found.similarities) - centres(truth), axis=1).mean()
    assert after < 0.5 * before
    assert found.cost_after < 0.1 * found.cost_before


def test_fixed_nodes_stay_and_the_result_repeats_to_the_bit(rng: np.random.Generator) -> None:
    _, nodes, edges, measured = drifting(rng, 80)
    fixed = np.isin(np.arange(80), [0, 40, 41])
    copy = nodes.copy()
    results = [pose_graph.optimize(nodes, edges, measured, fixed).similarities for _ in range(3)]
    np.testing.assert_array_equal(nodes, copy)
    np.testing.assert_array_equal(results[0][fixed], nodes[fixed])
    assert len({result.tobytes() for result in results}) == 1


def test_free_gauge_and_lonely_nodes(rng: np.random.Generator) -> None:
    truth = ring(20)
    edges = np.array([(i, i + 1) for i in range(18)])  # node 19 has no edge
    nodes = np.array([sim3_exp(rng.normal(0.0, 0.05, 7)) @ node for node in truth])
    found = pose_graph.optimize(nodes, edges, relative(truth, edges), np.zeros(20, dtype=bool), iterations=50)
    assert found.cost_after < 1e-12
    np.testing.assert_array_equal(found.similarities[19], nodes[19])


@pytest.mark.parametrize("fixed", [True, False])
def test_nothing_to_do(fixed: bool) -> None:
    found = pose_graph.optimize(
        np.eye(4)[None], np.zeros((0, 2), dtype=np.int64), np.zeros((0, 4, 4)), np.array([fixed])
    )
    np.testing.assert_array_equal(found.similarities, np.eye(4)[None])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"edges": np.array([[0, 5]])}, r"edges .* 0\.\.5; .* 0\.\.2"),
        ({"edges": np.array([[1, 1]])}, "to itself"),
        ({"measurements": np.zeros((1, 4, 4))}, "measurements .* no similarity"),
        ({"measurements": np.full((1, 4, 4), np.nan)}, "not finite"),
        ({"measurements": np.zeros((2, 4, 4))}, "measurements has shape"),
        ({"fixed": np.zeros(2, dtype=bool)}, "fixed has shape"),
        ({"weights": np.array([-1.0])}, "negative"),
    ],
)
def test_ill_inputs_are_refused_by_name(change: dict[str, Any], message: str) -> None:
    inputs: dict[str, Any] = {
        "similarities": ring(3), "edges": np.array([[0, 1]]), "measurements": np.eye(4)[None], "fixed": first_fixed(3)
    }  # fmt: skip
    with pytest.raises(ValueError, match=message):
        pose_graph.optimize(**{**inputs, **change})
