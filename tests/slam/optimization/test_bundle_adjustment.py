from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.optimize import approx_fprime, least_squares
from scipy.sparse import lil_matrix
from solver_scenes import INTRINSICS, Scene, corridor, disturbed, project

from codecbench.slam.geometry.rotations import so3_exp
from codecbench.slam.geometry.transforms import align_points, se3_exp
from codecbench.slam.optimization.bundle_adjustment import HUBER_95, adjust
from codecbench.slam.optimization.bundle_kernels import jacobians

pytestmark = pytest.mark.thorough


def robust_residuals(scene: Scene, parameters: np.ndarray, huber: float) -> np.ndarray:
    """Residuals whose squares sum to Huber's function of the chi-squares: an independent statement of the cost."""
    free = np.flatnonzero(~scene.fixed)
    poses = scene.camera_from_world.copy()
    for k, update in zip(free, parameters[: 6 * len(free)].reshape(-1, 6), strict=True):
        poses[k] = se3_exp(update) @ poses[k]
    points = parameters[6 * len(free) :].reshape(-1, 3)
    c, p = scene.camera_indices, scene.point_indices
    errors = project(np.einsum("mij,mj->mi", poses[c, :3, :3], points[p]) + poses[c, :3, 3]) - scene.pixels
    errors *= np.sqrt(scene.inverse_sigma2)[:, None]
    chi2 = np.maximum((errors**2).sum(axis=1), 1e-300)
    rho = np.where(chi2 <= huber**2, chi2, 2.0 * huber * np.sqrt(chi2) - huber**2)
    return (errors * np.sqrt(rho / chi2)[:, None]).ravel()


def sparsity(scene: Scene) -> Any:
    free = np.flatnonzero(~scene.fixed)
    slot = np.full(len(scene.fixed), -1)
    slot[free] = np.arange(len(free))
    out = lil_matrix((2 * len(scene.pixels), 6 * len(free) + 3 * len(scene.points_world)), dtype=int)
    for m, (c, p) in enumerate(zip(scene.camera_indices, scene.point_indices, strict=True)):
        if slot[c] >= 0:
            out[2 * m : 2 * m + 2, 6 * slot[c] : 6 * slot[c] + 6] = 1
        out[2 * m : 2 * m + 2, 6 * len(free) + 3 * p : 6 * len(free) + 3 * p + 3] = 1
    return out


def test_jacobians_against_finite_differences(rng: np.random.Generator) -> None:
    pose = se3_exp(rng.normal(0.0, 0.3, 6))
    point = np.array([0.3, -0.4, 4.0])
    in_camera = pose[:3, :3] @ point + pose[:3, 3]

    def pixel_of_point(x: np.ndarray) -> np.ndarray:
        return project((pose[:3, :3] @ x + pose[:3, 3])[None])[0]

    def pixel_of_update(x: np.ndarray) -> np.ndarray:
        return project((so3_exp(x[3:]) @ in_camera + x[:3])[None])[0]

    p00, p01, p02, p10, p11, p12, a0, a2, a3, a4, a5, b1, b2, b3, b4, b5 = jacobians(
        pose, in_camera[0] / in_camera[2], in_camera[1] / in_camera[2], 1.0 / in_camera[2], INTRINSICS
    )
    by_point = [[p00, p01, p02], [p10, p11, p12]]
    by_camera = [[a0, 0.0, a2, a3, a4, a5], [0.0, b1, b2, b3, b4, b5]]
    np.testing.assert_allclose(by_point, approx_fprime(point, pixel_of_point, 1e-6), rtol=1e-5, atol=1e-3)
    np.testing.assert_allclose(by_camera, approx_fprime(np.zeros(6), pixel_of_update, 1e-6), rtol=1e-5, atol=1e-3)


@pytest.mark.parametrize("huber", [HUBER_95, 1e6])
def test_the_same_minimum_as_scipy(huber: float, rng: np.random.Generator) -> None:
    scene = disturbed(corridor(rng, 8, 60, 300, noise_px=1.0), rng)
    wrong = rng.random(len(scene.pixels)) < 0.03
    scene.pixels[wrong] += rng.normal(0.0, 20.0, (int(wrong.sum()), 2))
    start = np.concatenate([np.zeros(36), scene.points_world.ravel()])
    best = least_squares(
        lambda x: robust_residuals(scene, x, huber), start, jac_sparsity=sparsity(scene), x_scale="jac",
        xtol=1e-14, ftol=1e-14, gtol=1e-14, max_nfev=300,
    )  # fmt: skip
    ours = adjust(*scene.arguments(), iterations=(200,), huber=huber, tolerance=1e-13)
    assert ours.cost_before == pytest.approx(0.5 * (robust_residuals(scene, start, huber) ** 2).sum(), rel=1e-12)
    assert ours.cost_after == pytest.approx(best.cost, rel=1e-6)


@pytest.mark.parametrize(("cameras", "points", "observations"), [(3, 30, 90), (20, 300, 1500), (60, 500, 3000)])
def test_exact_without_noise(cameras: int, points: int, observations: int, rng: np.random.Generator) -> None:
    truth = corridor(rng, cameras, points, observations)
    found = adjust(*disturbed(truth, rng).arguments(), iterations=(50,), huber=None, tolerance=1e-12)
    assert found.cost_after < 1e-12 * found.cost_before
    np.testing.assert_allclose(found.camera_from_world, truth.camera_from_world, atol=1e-6)
    assert found.inliers.all()


def test_bounded_error_with_noise_and_outliers(rng: np.random.Generator) -> None:
    truth = corridor(rng, 12, 600, 3600, noise_px=0.5)
    scene = disturbed(truth, rng, translation=0.01, angle_rad=0.003, points=0.05)
    wrong = rng.random(len(scene.pixels)) < 0.05
    scene.pixels[wrong] += rng.choice([-1.0, 1.0], (int(wrong.sum()), 2)) * 40.0
    found = adjust(*scene.arguments())
    assert np.abs(found.camera_from_world - truth.camera_from_world).max() < 0.02
    assert not found.inliers[wrong].any()
    assert found.inliers[~wrong].mean() > 0.97
    assert found.cost_after < found.cost_before


def test_fixed_cameras_stay_to_the_bit_and_free_ones_are_rotations(rng: np.random.Generator) -> None:
    scene = disturbed(corridor(rng, 6, 80, 300, noise_px=1.0), rng)
    found = adjust(*scene.arguments())
    np.testing.assert_array_equal(found.camera_from_world[:2], scene.camera_from_world[:2])
    for pose in found.camera_from_world:
        np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)


def test_inputs_are_left_alone_and_the_result_repeats_to_the_bit(rng: np.random.Generator) -> None:
    scene = disturbed(corridor(rng, 60, 800, 4000, noise_px=1.0), rng)
    before = [np.array(array) for array in scene.arguments()]
    results = [adjust(*scene.arguments()) for _ in range(3)]
    for array, copy in zip(scene.arguments(), before, strict=True):
        np.testing.assert_array_equal(array, copy)
    assert len({r.camera_from_world.tobytes() + r.points_world.tobytes() for r in results}) == 1


def test_the_order_of_the_observations_does_not_matter(rng: np.random.Generator) -> None:
    scene = disturbed(corridor(rng, 10, 100, 500, noise_px=1.0), rng)
    order = rng.permutation(len(scene.pixels))
    shuffled = scene.with_(
        camera_indices=scene.camera_indices[order], point_indices=scene.point_indices[order],
        pixels=scene.pixels[order], inverse_sigma2=scene.inverse_sigma2[order],
    )  # fmt: skip
    one, other = adjust(*scene.arguments()), adjust(*shuffled.arguments())
    np.testing.assert_allclose(one.points_world, other.points_world, atol=1e-9)
    np.testing.assert_array_equal(one.inliers[order], other.inliers)


def test_without_fixed_cameras_the_scene_is_found_up_to_a_similarity(rng: np.random.Generator) -> None:
    truth = corridor(rng, 8, 150, 800)
    free = disturbed(truth, rng).with_(fixed=np.zeros(8, dtype=np.bool_))
    found = adjust(*free.arguments(), iterations=(60,), tolerance=1e-12)
    scale, rotation, translation = align_points(truth.points_world, found.points_world, True)
    aligned = scale * found.points_world @ rotation.T + translation
    np.testing.assert_allclose(aligned, truth.points_world, atol=1e-5)
    assert 0.5 < scale < 2.0


def test_a_point_behind_its_cameras_is_an_outlier_and_harms_nobody(rng: np.random.Generator) -> None:
    truth = corridor(rng, 6, 80, 400)
    scene = disturbed(truth, rng, points=0.02)
    scene.points_world[7, 2] = -5.0
    found = adjust(*scene.arguments(), iterations=(10, 20))
    assert np.isfinite(found.points_world).all()
    assert not found.inliers[scene.point_indices == 7].any()
    np.testing.assert_allclose(found.camera_from_world, truth.camera_from_world, atol=1e-3)


def test_points_seen_less_than_twice_stay_and_have_no_say(rng: np.random.Generator) -> None:
    truth = corridor(rng, 6, 80, 400)
    scene = disturbed(truth, rng)
    extra = scene.with_(
        points_world=np.r_[scene.points_world, [[1.0, 2.0, 3.0], [0.5, 0.0, 5.0]]],
        camera_indices=np.r_[scene.camera_indices, 3], point_indices=np.r_[scene.point_indices, 81],
        pixels=np.r_[scene.pixels, [[5.0, 5.0]]], inverse_sigma2=np.r_[scene.inverse_sigma2, 1.0],
    )  # fmt: skip
    found, without = adjust(*extra.arguments()), adjust(*scene.arguments())
    np.testing.assert_array_equal(found.points_world[80:], extra.points_world[80:])
    np.testing.assert_array_equal(found.camera_from_world, without.camera_from_world)


def test_a_camera_that_sees_nothing_stays(rng: np.random.Generator) -> None:
    scene = disturbed(corridor(rng, 6, 80, 400), rng)
    more = scene.with_(
        camera_from_world=np.r_[scene.camera_from_world, np.eye(4)[None]], fixed=np.r_[scene.fixed, False]
    )
    np.testing.assert_array_equal(adjust(*more.arguments()).camera_from_world[6], np.eye(4))


def test_points_at_infinity_and_twin_cameras_stay_finite(rng: np.random.Generator) -> None:
    scene = corridor(rng, 4, 40, 160, noise_px=0.5)
    poses = scene.camera_from_world.copy()
    poses[3] = poses[2]  # no parallax between them
    points = scene.points_world.copy()
    points[:5] *= 1e7
    found = adjust(*scene.with_(camera_from_world=poses, points_world=points).arguments(), iterations=(20, 20))
    assert np.isfinite(found.points_world).all()
    assert np.isfinite(found.camera_from_world).all()
    assert found.cost_after <= found.cost_before


@pytest.mark.parametrize("fixed", [True, False])
def test_nothing_to_do(fixed: bool) -> None:
    none = np.zeros(0, dtype=np.int64)
    found = adjust(
        np.eye(4)[None], np.zeros((0, 3)), none, none, np.zeros((0, 2)), np.zeros(0), INTRINSICS, np.array([fixed])
    )
    np.testing.assert_array_equal(found.camera_from_world, np.eye(4)[None])
    assert found.cost_before == found.cost_after == 0.0


def test_all_cameras_fixed_still_moves_the_points(rng: np.random.Generator) -> None:
    truth = corridor(rng, 5, 50, 250)
    scene = disturbed(truth.with_(fixed=np.ones(5, dtype=np.bool_)), rng)
    found = adjust(*scene.arguments(), iterations=(50,), tolerance=1e-12)
    np.testing.assert_allclose(found.points_world, truth.points_world, atol=1e-4)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"camera_indices": np.full(400, 99)}, "camera_indices span 99..99; allowed 0..5"),
        ({"point_indices": np.full(400, -1)}, r"point_indices .* -1\.\.-1; .* 0\.\.79"),
        ({"pixels": np.full((400, 2), np.nan)}, "pixels .*not finite"),
        ({"inverse_sigma2": np.full(400, -1.0)}, "negative"),
        ({"intrinsics": np.ones(3)}, r"intrinsics has shape \(3,\); expected \(4,\)"),
        ({"fixed": np.ones(3, dtype=np.bool_)}, "fixed has shape"),
        ({"points_world": np.full((80, 3), np.inf)}, "points_world .*not finite"),
        ({"camera_from_world": np.zeros((6, 3, 4))}, "camera_from_world has shape"),
    ],
)
def test_ill_inputs_are_refused_by_name(change: dict[str, Any], message: str, rng: np.random.Generator) -> None:
    scene = corridor(rng, 6, 80, 400)
    cut = {name: getattr(scene, name)[:400] for name in ("camera_indices", "point_indices", "pixels", "inverse_sigma2")}
    cut = {name: np.resize(array, (400, *array.shape[1:])) for name, array in cut.items()}
    with pytest.raises(ValueError, match=message):
        adjust(*scene.with_(**{**cut, **change}).arguments())


def test_a_kernel_of_no_width_is_refused(rng: np.random.Generator) -> None:
    with pytest.raises(ValueError, match="huber is 0"):
        adjust(*corridor(rng, 3, 20, 60).arguments(), huber=0)
