from __future__ import annotations

import numpy as np

from codecbench.slam.features.uncertainty import pixel_variance
from codecbench.slam.thresholds import CAMERA_SIGMA_PX, KEYPOINT_SIGMA_PX


def test_the_part_of_the_level_grows_with_it_and_that_of_the_camera_stays() -> None:
    scales = np.array([1.0, 2.0, 4.0])
    variances = pixel_variance(scales)
    np.testing.assert_allclose(variances, CAMERA_SIGMA_PX**2 + (KEYPOINT_SIGMA_PX * scales) ** 2)
    np.testing.assert_allclose(np.diff(variances) / KEYPOINT_SIGMA_PX**2, [3.0, 12.0])
    assert pixel_variance(2.0) == variances[1]
