"""The fisheye against OpenCV's, against the closed form of the ideal one, and where it ends."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest

from codecbench.slam import Options
from codecbench.slam.features.extractor import FeatureExtractor
from codecbench.slam.geometry.camera import Camera
from codecbench.slam.thresholds import FISHEYE_ANGLE_DEG

TUM_VI = Camera(512, 512, 190.98, 190.97, 254.93, 256.9, (0.00348, 0.000715, -0.00205, 0.000203), "equidistant")
"""A lens of 195 degrees."""
IDEAL = Camera(512, 512, 190.0, 195.0, 255.0, 257.0, (0.0, 0.0, 0.0, 0.0), "equidistant")


def rays(rng: np.random.Generator, count: int, widest_deg: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unit rays (N, 3) with their angles from the axis and about it."""
    theta, phi = rng.uniform(0.0, np.radians(widest_deg), count), rng.uniform(-np.pi, np.pi, count)
    return np.column_stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)]), theta, phi


def test_the_ideal_lens_is_the_closed_form(rng: np.random.Generator) -> None:
    """A ray at theta falls theta focal lengths from the middle; its pinhole pixel lies tan(theta) from there."""
    _, theta, phi = rays(rng, 300, 74.9)
    direction = np.column_stack([np.cos(phi), np.sin(phi)])
    taken = IDEAL.intrinsics[2:] + IDEAL.intrinsics[:2] * theta[:, None] * direction
    pinhole = IDEAL.intrinsics[2:] + IDEAL.intrinsics[:2] * np.tan(theta)[:, None] * direction
    np.testing.assert_allclose(IDEAL.undistort(taken), pinhole, atol=1e-6)
    np.testing.assert_allclose(IDEAL.distort(pinhole), taken, atol=1e-9)


def test_distortion_is_opencvs(rng: np.random.Generator) -> None:
    points, _, _ = rays(rng, 300, 74.0)
    expected, _ = cv2.fisheye.projectPoints(
        points[:, None], np.zeros(3), np.zeros(3), TUM_VI.matrix, np.array(TUM_VI.distortion[:4])
    )
    np.testing.assert_allclose(TUM_VI.distort(TUM_VI.project(points)), expected[:, 0], atol=1e-9)


def test_undistortion_is_opencvs(rng: np.random.Generator) -> None:
    pixels = rng.uniform(100.0, 400.0, (300, 2))
    expected = cv2.fisheye.undistortPoints(
        pixels[:, None], TUM_VI.matrix, np.array(TUM_VI.distortion[:4]), P=TUM_VI.matrix
    )
    np.testing.assert_allclose(TUM_VI.undistort(pixels), expected[:, 0], atol=1e-5)
    np.testing.assert_allclose(TUM_VI.distort(TUM_VI.undistort(pixels)), pixels, atol=1e-6)


def test_the_middle_stays() -> None:
    middle = TUM_VI.intrinsics[None, 2:]
    np.testing.assert_array_equal(TUM_VI.undistort(middle), middle)
    np.testing.assert_array_equal(TUM_VI.distort(middle), middle)


def test_pixels_too_far_from_the_axis_are_none() -> None:
    limit = math.radians(FISHEYE_ANGLE_DEG)
    radii = 190.0 * np.array([limit - 1e-3, limit + 1e-3, 1.6, 3.0])
    found = IDEAL.undistort(np.column_stack([255.0 + radii, np.full(4, 257.0)]))
    assert np.isfinite(found).all(axis=1).tolist() == [True, False, False, False]


def test_a_lens_that_folds_back_has_no_ray_for_pixels_beyond_its_edge() -> None:
    """theta - 0.3 theta^3 is at most 0.7027, at 60.4 degrees."""
    folding = Camera(512, 512, 200.0, 200.0, 256.0, 256.0, (-0.3, 0.0, 0.0, 0.0), "equidistant")
    found = folding.undistort(np.array([[256.0 + 200.0 * 0.70, 256.0], [256.0 + 200.0 * 0.71, 256.0]]))
    assert np.isfinite(found).all(axis=1).tolist() == [True, False]
    assert np.arctan((found[0, 0] - 256.0) / 200.0) < math.radians(60.4)


def test_bounds_hold_what_is_seen() -> None:
    reach = math.tan(math.radians(FISHEYE_ANGLE_DEG))
    assert (TUM_VI.bounds[:2] >= TUM_VI.intrinsics[2:] - 191.0 * reach).all()
    assert (TUM_VI.bounds[2:] <= TUM_VI.intrinsics[2:] + 191.0 * reach).all()
    assert (TUM_VI.bounds[2:] - TUM_VI.bounds[:2] > 900.0).all()


@pytest.mark.thorough
def test_features_outside_the_view_are_left_out(rng: np.random.Generator) -> None:
    picture = np.kron(rng.integers(0, 256, (64, 64), dtype=np.uint8), np.ones((8, 8), np.uint8))
    features = FeatureExtractor(TUM_VI, Options(features=1000)).extract(picture)
    pinhole = FeatureExtractor(Camera(512, 512, 190.0, 190.0, 255.0, 257.0), Options(features=1000)).extract(picture)
    assert 300 < len(features.pixels) < len(pinhole.pixels)
    assert np.isfinite(features.pixels).all()
    again = TUM_VI.distort(features.pixels)
    nearest = np.abs(again[:, None] - pinhole.pixels[None]).max(axis=2).min(axis=1)
    assert nearest.max() < 1e-6
    assert len(features.descriptors) == len(features.angles) == len(features.octaves) == len(features.pixels)
