from __future__ import annotations

import numpy as np

from codecbench.slam.features.extractor import pixel_variances
from codecbench.slam.geometry.camera import Camera
from codecbench.slam.thresholds import CAMERA_SIGMA_DEG, KEYPOINT_SIGMA_PX


def test_the_part_of_the_level_grows_with_it_and_that_of_the_camera_with_the_focal_length() -> None:
    scales = np.array([1.0, 2.0, 4.0])
    small, large = (Camera(*size, focal, focal, 1.0, 1.0) for size, focal in (((320, 240), 260.0), ((640, 480), 520.0)))
    variances = pixel_variances(small, scales)
    camera_px = np.deg2rad(CAMERA_SIGMA_DEG) * 260.0
    np.testing.assert_allclose(variances, camera_px**2 + (KEYPOINT_SIGMA_PX * scales) ** 2, rtol=1e-6)
    np.testing.assert_allclose(pixel_variances(large, scales) - variances, 3.0 * camera_px**2, rtol=1e-6)
