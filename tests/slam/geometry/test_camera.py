from __future__ import annotations

import cv2
import numpy as np
import pytest

from codecbench.slam.geometry.camera import Camera

pytestmark = pytest.mark.thorough

FR1 = Camera(640, 480, 517.3, 516.5, 318.6, 255.3, (0.2624, -0.9531, -0.0054, 0.0026, 1.1633))


def test_undistortion_inverts_distortion(rng: np.random.Generator) -> None:
    pixels = rng.uniform([0.0, 0.0], [639.0, 479.0], (500, 2))
    assert np.abs(FR1.distort(FR1.undistort(pixels)) - pixels).max() < 1e-8


def test_distortion_agrees_with_opencv(rng: np.random.Generator) -> None:
    pixels = rng.uniform([50.0, 50.0], [590.0, 430.0], (200, 2))
    rays = np.column_stack([(pixels - FR1.intrinsics[2:]) / FR1.intrinsics[:2], np.ones(200)])
    expected, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), FR1.matrix, np.array(FR1.distortion))
    assert np.abs(FR1.distort(pixels) - expected[:, 0]).max() < 1e-9


def test_without_distortion_pixels_stay(rng: np.random.Generator) -> None:
    camera = Camera(640, 480, 500.0, 500.0, 320.0, 240.0)
    pixels = rng.uniform(0.0, 400.0, (10, 2))
    assert np.array_equal(camera.undistort(pixels), pixels)
    assert camera.bounds.tolist() == [0.0, 0.0, 639.0, 479.0]


def test_bounds_hold_every_undistorted_border_pixel() -> None:
    border = np.array([[x, y] for x in (0.0, 319.0, 639.0) for y in (0.0, 240.0, 479.0)])
    undistorted = FR1.undistort(border)
    assert (undistorted >= FR1.bounds[:2] - 1e-6).all()
    assert (undistorted <= FR1.bounds[2:] + 1e-6).all()


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ((0, 480, 500.0, 500.0, 1.0, 1.0), "size"),
        ((640, 480, float("nan"), 500.0, 1.0, 1.0), "finite"),
        ((640, 480, 500.0, 500.0, float("inf"), 1.0), "finite"),
        ((640, 480, -1.0, 500.0, 1.0, 1.0), "focal"),
        ((640, 480, 500.0, 500.0, 1.0, 1.0, (0.0,) * 9), "distortion"),
        ((640, 480, 500.0, 500.0, 1.0, 1.0, (float("nan"),)), "finite"),
    ],
)
def test_impossible_cameras_are_refused(arguments: tuple[float, ...], word: str) -> None:
    with pytest.raises(ValueError, match=word):
        Camera(*arguments)  # type: ignore[arg-type]
