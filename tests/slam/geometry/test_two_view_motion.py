from __future__ import annotations

import numpy as np
import pytest
from rendered_scenes import CAMERA, Floats, two_views
from scipy.optimize import least_squares

from codecbench.slam.geometry.transforms import se3_exp
from codecbench.slam.geometry.two_view_motion import direction_deviation_deg, refine_motion, sampson_distances

pytestmark = pytest.mark.thorough


def unit(motion: Floats) -> Floats:
    scaled = motion.copy()
    scaled[:3, 3] /= np.linalg.norm(scaled[:3, 3])
    return scaled


def test_distances_are_zero_on_the_epipolar_lines_and_in_pixels_off_them(rng: np.random.Generator) -> None:
    views = two_views(rng)
    exact = sampson_distances(views.b_from_a, views.pixels_a, views.pixels_b, CAMERA.matrix)
    assert np.abs(exact).max() < 1e-9
    sideways = np.eye(4)
    sideways[0, 3] = 1.0  # lines run along x: an error of y is shared by the two images
    moved = views.pixels_a + np.array([7.0, 0.2])
    distances = sampson_distances(sideways, views.pixels_a, moved, CAMERA.matrix)
    assert np.abs(distances) == pytest.approx(0.2 / np.sqrt(2.0))


@pytest.mark.parametrize("baseline", [0.4, 0.15])
def test_the_deviation_is_that_of_repeated_estimates(rng: np.random.Generator, baseline: float) -> None:
    views = two_views(rng, count=150, baseline=baseline)
    true = unit(views.b_from_a)
    across = np.linalg.svd(true[None, :3, 3])[2][1:]
    sigma_px = 0.1

    def motion(parameters: Floats) -> Floats:
        moved = true.copy()
        moved[:3, :3] = se3_exp(np.r_[0.0, 0.0, 0.0, parameters[:3]])[:3, :3] @ true[:3, :3]
        moved[:3, 3] += parameters[3:] @ across
        return unit(moved)

    estimates = []
    for _ in range(150):
        a, b = (p + rng.normal(0.0, sigma_px, p.shape) for p in (views.pixels_a, views.pixels_b))
        found = least_squares(lambda x, a=a, b=b: sampson_distances(motion(x), a, b, CAMERA.matrix), np.zeros(5))
        estimates.append(found.x[3:])
    spread = np.degrees(np.sqrt(np.linalg.eigvalsh(np.cov(np.array(estimates).T))[-1]))
    predicted = sigma_px * direction_deviation_deg(true, views.pixels_a, views.pixels_b, CAMERA.matrix)
    assert predicted == pytest.approx(spread, rel=0.2)


def test_a_turn_alone_has_no_direction(rng: np.random.Generator) -> None:
    views = two_views(rng)
    turned = CAMERA.project(views.points @ views.b_from_a[:3, :3].T)
    assert direction_deviation_deg(unit(views.b_from_a), views.pixels_a, turned, CAMERA.matrix) > 1e3


@pytest.mark.parametrize("sigma_px", [0.0, 0.3])
def test_refining_reaches_what_the_right_matches_agree_on(rng: np.random.Generator, sigma_px: float) -> None:
    """From a direction 20 degrees away; a quarter of the matches are wrong, and a general solver goes without them."""
    views = two_views(rng, noise_px=sigma_px)
    true = unit(views.b_from_a)
    pixels_b = views.pixels_b.copy()
    pixels_b[:75] += rng.uniform(10.0, 60.0, (75, 2)) * rng.choice([-1.0, 1.0], (75, 2))

    def moved(twist: Floats) -> Floats:
        return unit(se3_exp(twist) @ true)

    def misses(twist: Floats) -> Floats:
        return sampson_distances(moved(twist), views.pixels_a[75:], views.pixels_b[75:], CAMERA.matrix)

    start, best = moved(np.array([0.0, 0.3, 0.2, 0.01, -0.02, 0.01])), moved(least_squares(misses, np.zeros(6)).x)
    assert between_deg(start, best) > 15.0
    refined = refine_motion(start, views.pixels_a, pixels_b, CAMERA.matrix)
    assert np.linalg.norm(refined[:3, 3]) == pytest.approx(1.0)
    assert between_deg(refined, best) < 1.0


def between_deg(motion: Floats, other: Floats) -> float:
    return float(np.degrees(np.arccos(min(motion[:3, 3] @ other[:3, 3], 1.0))))


def test_refining_never_makes_it_worse(rng: np.random.Generator) -> None:
    views = two_views(rng, noise_px=0.5)
    for _ in range(20):
        start = unit(se3_exp(rng.normal(0.0, 0.5, 6)) @ views.b_from_a)
        refined = refine_motion(start, views.pixels_a, views.pixels_b, CAMERA.matrix)
        before, after = (
            np.log1p(sampson_distances(motion, views.pixels_a, views.pixels_b, CAMERA.matrix) ** 2).sum()
            for motion in (start, refined)
        )
        assert after <= before
