from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import least_squares
from solver_scenes import INTRINSICS, moved, project

from codecbench.slam.geometry.transforms import se3_exp, se3_log
from codecbench.slam.optimization.pose_optimization import _linearize, optimize_pose

pytestmark = pytest.mark.thorough


def motion(vx: float, vy: float, vz: float, wx: float, wy: float, wz: float) -> np.ndarray:
    """The rigid motion of a twist, without compiling anything while tests are collected."""
    return expm(np.array([[0.0, -wz, wy, vx], [wz, 0.0, -wx, vy], [-wy, wx, 0.0, vz], [0.0] * 4]))


TRUTH = motion(0.1, 0.2, -0.1, 0.05, 0.3, -0.1)
START = motion(0.05, -0.05, 0.06, 0.02, 0.02, -0.02) @ TRUTH


def view(rng: np.random.Generator, count: int, noise_px: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points in the world, their pixels and inverse variances."""
    points = moved(np.linalg.inv(TRUTH), rng.uniform([-2.0, -1.5, 3.0], [2.0, 1.5, 9.0], (count, 3)))
    sigma = 1.2 ** rng.integers(0, 8, count)
    noise = rng.normal(0.0, 1.0, (count, 2)) * sigma[:, None] * noise_px
    return points, project(moved(TRUTH, points)) + noise, 1.0 / sigma**2


def chi2(pose: np.ndarray, points: np.ndarray, pixels: np.ndarray, weights: np.ndarray) -> np.ndarray:
    return weights * ((project(moved(pose, points)) - pixels) ** 2).sum(axis=1)


@pytest.mark.parametrize("count", [6, 50, 300])
def test_exact_without_noise(count: int, rng: np.random.Generator) -> None:
    points, pixels, weights = view(rng, count)
    pose, inliers = optimize_pose(START, points, pixels, weights, INTRINSICS)
    np.testing.assert_allclose(pose, TRUTH, atol=1e-9)
    assert inliers.all()


def test_outliers_are_named_and_leave_no_trace(rng: np.random.Generator) -> None:
    points, pixels, weights = view(rng, 200)
    wrong = np.arange(200) < 80
    pixels[wrong] += rng.choice([-1.0, 1.0], (80, 2)) * rng.uniform(30.0, 200.0, (80, 2))
    pose, inliers = optimize_pose(START, points, pixels, weights, INTRINSICS)
    np.testing.assert_array_equal(inliers, ~wrong)
    np.testing.assert_allclose(pose, TRUTH, atol=1e-9)


def best_cost(points: np.ndarray, pixels: np.ndarray, weights: np.ndarray) -> float:
    """The least sum of chi-squares that any pose near the truth leaves, by scipy."""

    def residuals(tangent: np.ndarray) -> np.ndarray:
        error = project(moved(se3_exp(tangent) @ TRUTH, points)) - pixels
        return (error * np.sqrt(weights)[:, None]).ravel()

    return 2.0 * float(least_squares(residuals, np.zeros(6), xtol=1e-15, ftol=1e-15, gtol=1e-15).cost)


def test_the_same_minimum_as_scipy_on_the_inliers(rng: np.random.Generator) -> None:
    points, pixels, weights = view(rng, 150, noise_px=0.8)
    pose, inliers = optimize_pose(START, points, pixels, weights, INTRINSICS)
    chosen = points[inliers], pixels[inliers], weights[inliers]
    assert chi2(pose, *chosen).sum() == pytest.approx(best_cost(*chosen), rel=1e-6)
    assert np.abs(se3_log(pose @ np.linalg.inv(TRUTH))).max() < 0.01
    assert inliers.mean() > 0.9
    np.testing.assert_array_equal(inliers, chi2(pose, points, pixels, weights) <= 5.991)


def test_what_is_farther_off_than_the_rest_has_no_say_and_stays_matched(rng: np.random.Generator) -> None:
    points, pixels, weights = view(rng, 150, noise_px=0.2)
    good = np.arange(150) >= 8
    pixels[~good, 0] += 2.0 / np.sqrt(weights[~good])  # all to one side: together they would turn the camera
    pose, inliers = optimize_pose(START, points, pixels, weights, INTRINSICS)
    chosen = points[good], pixels[good], weights[good]
    assert chi2(pose, *chosen).sum() == pytest.approx(best_cost(*chosen), rel=1e-6)
    assert inliers.all()


def test_points_behind_the_camera_are_outliers(rng: np.random.Generator) -> None:
    points, pixels, weights = view(rng, 60)
    behind = moved(np.linalg.inv(TRUTH), np.array([[0.0, 0.0, -4.0], [0.1, 0.0, 0.0]]))
    pose, inliers = optimize_pose(
        START, np.r_[points, behind], np.r_[pixels, [[320.0, 240.0]] * 2], np.r_[weights, 1.0, 1.0], INTRINSICS
    )
    np.testing.assert_allclose(pose, TRUTH, atol=1e-9)
    assert inliers[:60].all()
    assert not inliers[60:].any()


@pytest.mark.parametrize("count", [0, 1, 2, 3])
def test_too_few_points_leave_a_finite_pose(count: int, rng: np.random.Generator) -> None:
    points, pixels, weights = view(rng, count)
    pose, inliers = optimize_pose(START, points, pixels, weights, INTRINSICS)
    assert np.isfinite(pose).all()
    assert inliers.shape == (count,)
    if count < 3:
        np.testing.assert_allclose(pose, START, atol=1e-12)
        assert not inliers.any()


def test_nothing_that_fits_keeps_no_inlier(rng: np.random.Generator) -> None:
    points, _, weights = view(rng, 40)
    pose, inliers = optimize_pose(START, points, rng.uniform(-5000, 5000, (40, 2)), weights, INTRINSICS)
    assert np.isfinite(pose).all()
    assert inliers.sum() < 10


def test_the_same_bits_every_time(rng: np.random.Generator) -> None:
    points, pixels, weights = view(rng, 300, noise_px=1.0)
    poses = {optimize_pose(START, points, pixels, weights, INTRINSICS)[0].tobytes() for _ in range(3)}
    assert len(poses) == 1


def test_arrays_that_do_not_fit_are_refused(rng: np.random.Generator) -> None:
    points, pixels, weights = view(rng, 10)
    with pytest.raises(ValueError, match=r"pixels \(9, 2\)"):
        optimize_pose(START, points, pixels[:9], weights, INTRINSICS)
    with pytest.raises(ValueError, match=r"pose \(3, 4\)"):
        optimize_pose(START[:3], points, pixels, weights, INTRINSICS)


def huber(squares: np.ndarray) -> np.ndarray:
    """Huber's cost of squared errors: quadratic up to the 95 % bound of two degrees of freedom, linear beyond."""
    return np.where(squares <= 5.991, squares, 2.0 * np.sqrt(5.991 * squares) - 5.991)


def test_the_normal_equations_are_those_of_the_cost(rng: np.random.Generator) -> None:
    """Against differences of Huber's cost; a point behind the camera and an inactive one lie between the others."""
    points, pixels, weights = view(rng, 30, noise_px=1.5)
    near = se3_exp(np.array([0.004, -0.003, 0.005, 0.001, 0.002, -0.001])) @ TRUTH
    points[5] = moved(np.linalg.inv(near), np.array([[0.2, 0.1, -3.0]]))
    active = np.arange(30) != 11
    seen = active & (np.arange(30) != 5)
    hessian, gradient = np.empty((6, 6)), np.empty(6)
    cost, depth = _linearize(near, points, pixels, weights, INTRINSICS, active, True, hessian, gradient)
    squares = chi2(near, points[seen], pixels[seen], weights[seen])
    assert 5 < (squares > 5.991).sum() < 28, "both branches of the cost"
    assert cost == pytest.approx(1e6 + huber(squares).sum())
    assert depth == pytest.approx(moved(near, points[seen])[:, 2].mean())

    def after(step: np.ndarray) -> np.ndarray:
        return se3_exp(step) @ near

    steps = 1e-6 * np.eye(6)
    slopes = [
        huber(chi2(after(step), points[seen], pixels[seen], weights[seen])).sum()
        - huber(chi2(after(-step), points[seen], pixels[seen], weights[seen])).sum()
        for step in steps
    ]
    np.testing.assert_allclose(gradient, -0.5 * np.array(slopes) / 2e-6, rtol=1e-5, atol=1e-3)
    jacobian = np.stack(
        [project(moved(after(step), points[seen])) - project(moved(after(-step), points[seen])) for step in steps]
    )
    robust = weights[seen] * np.minimum(1.0, np.sqrt(5.991 / squares))
    expected = np.einsum("anc,n,bnc->ab", jacobian / 2e-6, robust, jacobian / 2e-6)
    np.testing.assert_allclose(np.tril(hessian), np.tril(expected), rtol=1e-5, atol=1e-2)
