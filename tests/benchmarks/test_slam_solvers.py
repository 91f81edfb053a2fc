"""Time of the SLAM's solvers, for a local map, a loop and a town. Run with `pytest tests/benchmarks`."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from solver_scenes import INTRINSICS, corridor, disturbed, moved, project

from codecbench.slam.geometry.similarity import estimate_similarity, optimize_similarity
from codecbench.slam.geometry.transforms import se3_exp, sim3_exp
from codecbench.slam.optimization import pose_graph
from codecbench.slam.optimization.bundle_adjustment import adjust
from codecbench.slam.optimization.pose_optimization import optimize_pose
from codecbench.slam.places.recognition import KeyframeDatabase
from codecbench.slam.places.vocabulary import Vocabulary

SIZES = {"local": (20, 2_000, 8_000), "loop": (150, 15_000, 90_000), "town": (500, 40_000, 250_000)}


@pytest.mark.parametrize("size", SIZES)
def test_bundle_adjustment(benchmark: Any, size: str, rng: np.random.Generator) -> None:
    scene = disturbed(corridor(rng, *SIZES[size], noise_px=0.7), rng, 0.01, 0.003, 0.03)
    found = benchmark.pedantic(adjust, scene.arguments(), rounds=5, warmup_rounds=1)
    benchmark.extra_info["observations"] = len(scene.pixels)
    benchmark.extra_info["iterations"] = found.iterations
    assert found.cost_after < 0.1 * found.cost_before


def test_pose_optimization(benchmark: Any, rng: np.random.Generator) -> None:
    points = rng.uniform([-2.0, -1.5, 3.0], [2.0, 1.5, 9.0], (300, 3))
    pixels = project(points) + rng.normal(0.0, 0.7, (300, 2))
    pixels[:60] += 50.0
    start = se3_exp(np.array([0.05, -0.05, 0.06, 0.02, 0.02, -0.02]))
    pose, inliers = benchmark(optimize_pose, start, points, pixels, np.ones(300), INTRINSICS)
    assert np.abs(pose - np.eye(4)).max() < 0.02
    assert inliers[60:].mean() > 0.9


@pytest.mark.parametrize("count", [150, 1000])
def test_pose_graph(benchmark: Any, count: int, rng: np.random.Generator) -> None:
    truth = [se3_exp(np.array([0.3 * np.cos(k / 9), 0.1, 0.3, 0.0, 2 * np.pi / count, 0.0])) for k in range(count)]
    nodes = [np.eye(4)]
    for step in truth:
        nodes.append(step @ nodes[-1])
    edges = np.array([(i, i + d) for d in (1, 2, 3, 4, 5) for i in range(count + 1 - d)] + [(0, count)])
    measured = np.array([nodes[j] @ np.linalg.inv(nodes[i]) for i, j in edges])
    measured[:-1] = [sim3_exp(rng.normal(0.0, 0.005, 7)) @ m for m in measured[:-1]]
    start = np.array([sim3_exp(rng.normal(0.0, 0.05, 7)) @ node for node in nodes])
    start[0] = nodes[0]
    fixed = np.arange(count + 1) == 0
    found = benchmark.pedantic(pose_graph.optimize, (start, edges, measured, fixed), rounds=5, warmup_rounds=1)
    benchmark.extra_info["iterations"] = found.iterations
    assert found.cost_after < 0.1 * found.cost_before


def test_similarity(benchmark: Any, rng: np.random.Generator) -> None:
    truth = sim3_exp(np.array([0.3, -0.1, 0.2, 0.1, 0.05, -0.3, 0.4]))
    points_b = rng.uniform([-2.0, -1.5, 4.0], [2.0, 1.5, 9.0], (150, 3))
    points_a = moved(truth, points_b)
    inputs = [points_a, points_b, project(points_a), project(points_b), np.ones(150), np.ones(150), INTRINSICS]
    inputs[0] = np.r_[rng.permutation(points_a[:75]), points_a[75:]]

    def estimate() -> np.ndarray:
        found = estimate_similarity(*inputs, np.random.default_rng(1))
        assert found is not None
        return optimize_similarity(found[0], *inputs)[0]

    np.testing.assert_allclose(benchmark(estimate), truth, atol=1e-6)


def test_words_of_1000_descriptors(benchmark: Any, rng: np.random.Generator) -> None:
    vocabulary = Vocabulary.load_default()
    rows = rng.integers(0, len(vocabulary.descriptors), 1000)
    bits = vocabulary.descriptors[rows].view(np.uint64)
    words = benchmark(vocabulary.words, bits)
    assert len(words.words) == 1000


def test_loop_candidates_among_500_keyframes(benchmark: Any, rng: np.random.Generator) -> None:
    vocabulary = Vocabulary.load_default()
    database = KeyframeDatabase(len(vocabulary))
    bags = [vocabulary.bow(rng.integers(0, len(vocabulary), 1000)) for _ in range(500)]
    for keyframe, bag in enumerate(bags):
        database.add(keyframe, bag)
    found = benchmark(database.loop_candidates, bags[77], lambda _: (), [], 0.0)
    assert found == [77]
