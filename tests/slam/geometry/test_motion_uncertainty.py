from __future__ import annotations

import numpy as np
import pytest
from rendered_scenes import CAMERA, Floats, two_views
from scipy.optimize import least_squares

from codecbench.slam.geometry.transforms import se3_exp
from codecbench.slam.geometry.two_view import direction_deviation_deg, sampson_distances

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
    variances = np.full(150, sigma_px**2)
    predicted = direction_deviation_deg(true, views.pixels_a, views.pixels_b, variances, CAMERA.matrix)
    assert predicted == pytest.approx(spread, rel=0.2)


def test_a_turn_alone_has_no_direction(rng: np.random.Generator) -> None:
    views = two_views(rng)
    turned = CAMERA.project(views.points @ views.b_from_a[:3, :3].T)
    deviation = direction_deviation_deg(unit(views.b_from_a), views.pixels_a, turned, np.ones(300), CAMERA.matrix)
    assert deviation > 1e3
