from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares
from solver_scenes import INTRINSICS, moved, project, similarity_from_tangent

from codecbench.slam.geometry.similarity import estimate_similarity, optimize_similarity
from codecbench.slam.geometry.transforms import sim3_exp, sim3_log

pytestmark = pytest.mark.thorough

TRUTH = similarity_from_tangent((0.3, -0.1, 0.2, 0.1, 0.05, -0.3, 0.4))


def pairs(rng: np.random.Generator, count: int, noise_px: float = 0.0, map_noise: float = 0.0) -> list[Any]:
    """Points that both keyframes have, each in its own frame, with pixels and inverse variances."""
    points_b = rng.uniform([-2.0, -1.5, 4.0], [2.0, 1.5, 9.0], (count, 3))
    points_a = moved(TRUTH, points_b)
    pixels = [project(points) + rng.normal(0.0, 1.0, (count, 2)) * noise_px for points in (points_a, points_b)]
    points_a, points_b = (points * (1.0 + rng.normal(0.0, map_noise, (count, 1))) for points in (points_a, points_b))
    weights = [1.0 / 1.2 ** (2 * rng.integers(0, 3, count)) for _ in range(2)]
    return [points_a, points_b, *pixels, *weights, INTRINSICS]


def difference(similarity: np.ndarray) -> float:
    return float(np.abs(sim3_log(similarity @ np.linalg.inv(TRUTH))).max())


def test_exact_without_noise(rng: np.random.Generator) -> None:
    inputs = pairs(rng, 50)
    estimate = estimate_similarity(*inputs, np.random.default_rng(3))
    assert estimate is not None
    assert difference(estimate[0]) < 1e-10
    assert estimate[1].all()
    start = sim3_exp(np.array([0.1, 0.1, -0.1, 0.03, -0.03, 0.02, 0.1])) @ TRUTH
    refined, inliers = optimize_similarity(start, *inputs)
    assert difference(refined) < 1e-8
    assert inliers.all()


@pytest.mark.parametrize("wrong", [0.3, 0.6])
def test_wrong_pairs_are_named(wrong: float, rng: np.random.Generator) -> None:
    inputs = pairs(rng, 100, noise_px=0.5, map_noise=0.003)
    count = int(100 * wrong)
    inputs[0][:count] = rng.uniform([-2.0, -1.5, 4.0], [2.0, 1.5, 9.0], (count, 3))
    estimate = estimate_similarity(*inputs, np.random.default_rng(3))
    assert estimate is not None
    similarity, inliers = optimize_similarity(estimate[0], *inputs)
    assert not inliers[:count].any()
    assert inliers[count:].mean() > 0.9
    assert difference(similarity) < 0.02


def test_refinement_reaches_the_minimum_of_scipy(rng: np.random.Generator) -> None:
    inputs = pairs(rng, 80, noise_px=0.5, map_noise=0.002)
    points_a, points_b, pixels_a, pixels_b, weights_a, weights_b, _ = inputs
    similarity, inliers = optimize_similarity(TRUTH, *inputs)

    def residuals(x: np.ndarray) -> np.ndarray:
        a_from_b = sim3_exp(x) @ TRUTH
        in_a = (project(moved(a_from_b, points_b)) - pixels_a) * np.sqrt(weights_a)[:, None]
        in_b = (project(moved(np.linalg.inv(a_from_b), points_a)) - pixels_b) * np.sqrt(weights_b)[:, None]
        errors = np.stack([in_a, in_b])[:, inliers]
        chi2 = (errors**2).sum(axis=2, keepdims=True)
        rho = np.where(chi2 <= 9.21, chi2, 2.0 * np.sqrt(9.21 * chi2) - 9.21)
        return (errors * np.sqrt(rho / chi2)).ravel()

    best = least_squares(residuals, np.zeros(7), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    ours = 0.5 * (residuals(sim3_log(similarity @ np.linalg.inv(TRUTH))) ** 2).sum()
    assert ours == pytest.approx(best.cost, rel=1e-6)


def test_pairs_without_a_common_similarity_give_none(rng: np.random.Generator) -> None:
    inputs = pairs(rng, 60)
    inputs[0] = rng.permutation(inputs[0])
    inputs[2] = project(inputs[0])
    assert estimate_similarity(*inputs, np.random.default_rng(3)) is None
    few = [array[:10] for array in inputs[:6]]
    assert estimate_similarity(*few, INTRINSICS, np.random.default_rng(3)) is None


def test_points_on_one_spot_or_behind_give_none(rng: np.random.Generator) -> None:
    inputs = pairs(rng, 40)
    inputs[0] = np.ones((40, 3))
    assert estimate_similarity(*inputs, np.random.default_rng(3)) is None
    behind = pairs(rng, 40)
    behind[0], behind[1] = -behind[0], -behind[1]
    assert estimate_similarity(*behind, np.random.default_rng(3)) is None


def test_the_same_seed_gives_the_same_bits(rng: np.random.Generator) -> None:
    inputs = pairs(rng, 60, noise_px=1.0, map_noise=0.01)
    found = [estimate_similarity(*inputs, np.random.default_rng(9), min_inliers=10) for _ in range(3)]
    assert all(estimate is not None for estimate in found)
    assert len({estimate[0].tobytes() for estimate in found if estimate}) == 1


def test_ill_inputs_are_refused(rng: np.random.Generator) -> None:
    inputs = pairs(rng, 30)
    with pytest.raises(ValueError, match="pixels_b has shape"):
        estimate_similarity(*inputs[:3], inputs[3][:5], *inputs[4:], np.random.default_rng(0))
    with pytest.raises(ValueError, match="a_from_b"):
        optimize_similarity(np.zeros((4, 4)), *inputs)
