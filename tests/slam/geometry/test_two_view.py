from __future__ import annotations

import cv2
import numpy as np
import pytest
from rendered_scenes import CAMERA, two_views
from scipy.spatial.transform import Rotation

from codecbench.slam.geometry import two_view as geometry

pytestmark = pytest.mark.thorough


def normalized_fit(fit, pixels_a, pixels_b, homography):  # type: ignore[no-untyped-def]
    a, normalizer_a = geometry.normalize_pixels(pixels_a)
    b, normalizer_b = geometry.normalize_pixels(pixels_b)
    model = fit(a, b)
    return (np.linalg.inv(normalizer_b) if homography else normalizer_b.T) @ model @ normalizer_a


def test_normalized_pixels_have_their_centroid_at_zero(rng: np.random.Generator) -> None:
    pixels = rng.uniform(0.0, 300.0, (50, 2))
    normalized, normalizer = geometry.normalize_pixels(pixels)
    assert np.abs(normalized.mean(axis=0)).max() < 1e-12
    assert np.linalg.norm(normalized, axis=1).mean() == pytest.approx(np.sqrt(2.0))
    assert np.allclose(
        np.column_stack([pixels, np.ones(50)]) @ normalizer.T, np.column_stack([normalized, np.ones(50)])
    )


def test_fundamental_matrix_is_exact_without_noise(rng: np.random.Generator) -> None:
    views = two_views(rng)
    found = normalized_fit(geometry.fit_fundamental, views.pixels_a[:20], views.pixels_b[:20], False)
    expected, _ = geometry.fundamental_between(np.eye(4), views.b_from_a, CAMERA.matrix)
    found, expected = found / np.linalg.norm(found), expected / np.linalg.norm(expected)
    assert min(np.abs(found - expected).max(), np.abs(found + expected).max()) < 1e-8
    oracle, _ = cv2.findFundamentalMat(views.pixels_a, views.pixels_b, cv2.FM_8POINT)
    oracle /= np.linalg.norm(oracle)
    assert min(np.abs(found - oracle).max(), np.abs(found + oracle).max()) < 1e-6


def test_homography_is_exact_on_a_plane(rng: np.random.Generator) -> None:
    views = two_views(rng, planar=True)
    found = normalized_fit(geometry.fit_homography, views.pixels_a[:10], views.pixels_b[:10], True)
    mapped = cv2.perspectiveTransform(views.pixels_a[:, None], found)[:, 0]
    assert np.abs(mapped - views.pixels_b).max() < 1e-7


def test_the_fewest_matches_give_the_models_of_many(rng: np.random.Generator) -> None:
    flat, deep = two_views(rng, planar=True), two_views(rng)
    homography = normalized_fit(geometry.fit_homography, flat.pixels_a[:4], flat.pixels_b[:4], True)
    mapped = cv2.perspectiveTransform(flat.pixels_a[:, None], homography)[:, 0]
    assert np.abs(mapped - flat.pixels_b).max() < 1e-6
    inliers = np.zeros(300, np.bool_)
    fundamental = normalized_fit(geometry.fit_fundamental, deep.pixels_a[:8], deep.pixels_b[:8], False)
    geometry.score_fundamental(fundamental, deep.pixels_a, deep.pixels_b, np.full(300, 1e-12), inliers)
    assert inliers.all()


def test_matches_that_repeat_give_no_model(rng: np.random.Generator) -> None:
    views = two_views(rng)
    again = np.zeros(8, np.int64)
    assert (geometry.fit_homography(views.pixels_a[again[:4]], views.pixels_b[again[:4]]) == 0.0).all()
    assert (geometry.fit_fundamental(views.pixels_a[again], views.pixels_b[again]) == 0.0).all()


def test_the_rotation_between_directions_is_that_of_scipy(rng: np.random.Generator) -> None:
    true = Rotation.from_rotvec([0.3, -1.2, 2.0])
    rays = rng.normal(size=(40, 3))
    assert np.abs(geometry.fit_rotation(rays, true.apply(rays)) - true.as_matrix()).max() < 1e-12
    noisy = true.apply(rays) + rng.normal(0.0, 0.05, (40, 3))
    oracle, _ = Rotation.align_vectors(noisy, rays)
    assert np.abs(geometry.fit_rotation(rays, noisy) - oracle.as_matrix()).max() < 1e-9
    assert np.linalg.det(geometry.fit_rotation(rays[:2], true.apply(rays[:2]))) == pytest.approx(1.0)


def test_scores_tell_a_plane_from_depth(rng: np.random.Generator) -> None:
    for planar in (True, False):
        views = two_views(rng, planar=planar, noise_px=0.3)
        inliers = np.zeros(300, np.bool_)
        h = normalized_fit(geometry.fit_homography, views.pixels_a, views.pixels_b, True)
        f = normalized_fit(geometry.fit_fundamental, views.pixels_a, views.pixels_b, False)
        score_h = geometry.score_homography(h, views.pixels_a, views.pixels_b, np.ones(300), inliers)
        score_f = geometry.score_fundamental(f, views.pixels_a, views.pixels_b, np.ones(300), inliers)
        assert (score_h / (score_h + score_f) > 0.45) == planar


def test_what_is_known_better_is_held_to_more(rng: np.random.Generator) -> None:
    views = two_views(rng, planar=True)
    h = normalized_fit(geometry.fit_homography, views.pixels_a, views.pixels_b, True)
    f, _ = geometry.fundamental_between(np.eye(4), views.b_from_a, CAMERA.matrix)
    missed = views.pixels_b + rng.normal(0.0, 1.0, (300, 2))
    variances = np.where(np.arange(300) < 150, 1.0, 0.04)
    for score, model in ((geometry.score_homography, h), (geometry.score_fundamental, f)):
        inliers = np.zeros(300, np.bool_)
        score(model, views.pixels_a, missed, variances, inliers)
        assert inliers[:150].mean() > 0.8
        assert inliers[150:].mean() < 0.4


def test_decompositions_hold_the_true_motion(rng: np.random.Generator) -> None:
    deep, flat = two_views(rng), two_views(rng, planar=True)
    fundamental, _ = geometry.fundamental_between(np.eye(4), deep.b_from_a, CAMERA.matrix)
    homography = normalized_fit(geometry.fit_homography, flat.pixels_a, flat.pixels_b, True)
    for motions, views in (
        (geometry.decompose_fundamental(fundamental, CAMERA.matrix), deep),
        (geometry.decompose_homography(homography, CAMERA.matrix), flat),
    ):
        true = views.b_from_a.copy()
        true[:3, 3] /= np.linalg.norm(true[:3, 3])
        assert min(np.abs(motion - true).max() for motion in motions) < 1e-6


def test_epipole_is_the_other_camera_seen(rng: np.random.Generator) -> None:
    b_from_a = two_views(rng).b_from_a.copy()
    b_from_a[:3, 3] = [0.1, 0.05, 1.0]
    fundamental, epipole = geometry.fundamental_between(np.eye(4), b_from_a, CAMERA.matrix)
    assert np.allclose(epipole, CAMERA.project(b_from_a[None, :3, 3])[0])
    assert np.abs(np.array([*epipole, 1.0]) @ fundamental).max() < 1e-12


def test_a_homography_means_two_motions_each_beside_its_opposite(rng: np.random.Generator) -> None:
    views = two_views(rng, planar=True)
    homography = geometry.fit_homography(views.pixels_a, views.pixels_b)
    motions = geometry.decompose_homography(homography, CAMERA.matrix)
    assert len(motions) == 4
    for motion, opposite in (motions[:2], motions[2:]):
        assert np.abs(motion[:3, 3] + opposite[:3, 3]).max() < 1e-9
        assert np.abs(motion[:3, :3] - opposite[:3, :3]).max() < 1e-9
    assert np.abs(motions[0][:3, 3] - motions[2][:3, 3]).max() > 0.1


def test_many_equations_give_what_a_singular_value_decomposition_gives(rng: np.random.Generator) -> None:
    views = two_views(rng, noise_px=0.5)
    normalized_a, _ = geometry.normalize_pixels(views.pixels_a)
    normalized_b, _ = geometry.normalize_pixels(views.pixels_b)
    a, b = (np.column_stack([p, np.ones(len(p))]) for p in (normalized_a, normalized_b))
    expected = np.linalg.svd(np.einsum("ni,nj->nij", b, a).reshape(-1, 9))[2][8].reshape(3, 3)
    u, s, vt = np.linalg.svd(expected)
    expected = (u * [s[0], s[1], 0.0]) @ vt
    found = geometry.fit_fundamental(normalized_a, normalized_b)
    assert min(np.abs(found - expected).max(), np.abs(found + expected).max()) < 1e-10
