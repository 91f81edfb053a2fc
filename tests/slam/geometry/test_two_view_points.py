from __future__ import annotations

import cv2
import numpy as np
import pytest
from rendered_scenes import CAMERA, two_views

from codecbench.slam.geometry.two_view_points import TwoViewPoints, triangulate

pytestmark = pytest.mark.thorough


def test_triangulation_is_exact_without_noise(rng: np.random.Generator) -> None:
    views = two_views(rng)
    result = TwoViewPoints(np.eye(4), views.b_from_a, views.pixels_a, views.pixels_b, CAMERA.intrinsics)
    assert np.abs(result.points - views.points).max() < 1e-8
    assert result.errors_a.max() < 1e-14
    assert np.allclose(result.depths_a, views.points[:, 2])


def test_triangulation_agrees_with_opencv_under_noise(rng: np.random.Generator) -> None:
    views = two_views(rng, noise_px=0.5)
    found = triangulate(np.eye(4), views.b_from_a, views.pixels_a, views.pixels_b, CAMERA.intrinsics)
    normalized = [(p - CAMERA.intrinsics[2:]) / CAMERA.intrinsics[:2] for p in (views.pixels_a, views.pixels_b)]
    expected = cv2.triangulatePoints(np.eye(4)[:3], views.b_from_a[:3], normalized[0].T, normalized[1].T)
    assert np.abs(found - (expected[:3] / expected[3]).T).max() < 1e-6


def test_points_at_infinity_are_marked() -> None:
    pixels = np.array([[160.0, 120.0], [50.0, 60.0]])
    moved = np.eye(4)
    moved[0, 3] = -1.0
    result = TwoViewPoints(np.eye(4), moved, pixels, pixels, CAMERA.intrinsics)
    assert (result.cosines > 1.0 - 1e-9).all()
