"""Rational lenses against OpenCV's projection, and where they end."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from codecbench.slam.geometry.camera import Camera

DEPTH_CAMERAS = [
    Camera(1280, 720, 605.3, 605.1, 637.5, 366.0, (0.4997, -2.6156, 0.00045, -0.0002, 1.4843, 0.3794, -2.44, 1.4131)),
    Camera(1920, 1080, 1390.0, 1391.0, 962.0, 541.0, (1.5, -0.2, 0.0002, -0.0001, 0.1, 1.55, 0.05, 0.02)),
    Camera(1024, 1024, 504.5, 504.6, 517.0, 508.0, (3.07, 2.11, 8e-5, 1e-5, 0.11, 3.4, 3.16, 0.57)),
]
"""Numbers of the size that depth cameras publish."""


@pytest.mark.parametrize("camera", DEPTH_CAMERAS, ids=lambda camera: str(camera.width))
def test_undistortion_finds_the_rays_that_opencv_projects(camera: Camera, rng: np.random.Generator) -> None:
    rays = np.column_stack([rng.uniform(-0.8, 0.8, (400, 2)), np.ones(400)])
    taken = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), camera.matrix, np.array(camera.distortion))[0][:, 0]
    np.testing.assert_allclose(camera.distort(camera.project(rays)), taken, atol=1e-9)
    np.testing.assert_allclose(camera.undistort(taken), camera.project(rays), atol=1e-5)


@pytest.mark.parametrize("camera", DEPTH_CAMERAS, ids=lambda camera: str(camera.width))
def test_most_of_the_picture_has_rays_and_they_come_back(camera: Camera, rng: np.random.Generator) -> None:
    pixels = rng.uniform([0, 0], [camera.width - 1, camera.height - 1], (500, 2))
    straight = camera.undistort(pixels)
    seen = np.isfinite(straight).all(axis=1)
    assert seen.mean() > 0.95
    np.testing.assert_allclose(camera.distort(straight[seen]), pixels[seen], atol=1e-6)
    assert np.isfinite(camera.bounds).all()


def test_a_denominator_of_1_is_the_brown_lens() -> None:
    brown = (0.1, -0.2, 0.001, -0.002, 0.05)
    camera = Camera(640, 480, 500.0, 505.0, 322.0, 238.0, (*brown, 0.0, 0.0, 0.0))
    assert camera.distortion == brown
    assert not camera.has_blind_pixels


def test_pixels_beyond_the_fold_have_no_ray() -> None:
    """r / (1 + r^2) is at most one half, at r = 1."""
    folding = Camera(640, 480, 400.0, 400.0, 320.0, 240.0, (0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0))
    found = folding.undistort(np.array([[320.0 + 400.0 * 0.4, 240.0], [320.0 + 400.0 * 0.51, 240.0]]))
    np.testing.assert_allclose(found[0], [320.0 + 400.0 * 0.5, 240.0], atol=1e-6)
    assert np.isnan(found[1]).all()
