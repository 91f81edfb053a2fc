"""How well the place of a feature is known."""

from __future__ import annotations

import numpy as np

from codecbench.slam.geometry.camera import Camera, Floats
from codecbench.slam.thresholds import CAMERA_SIGMA_DEG, KEYPOINT_SIGMA_PX


def pixel_variances(camera: Camera, scale_factors: Floats) -> Floats:
    """Variance of a keypoint's place in the image along each axis, px^2, by level (L,), whose `scale_factors` are (L,).

    What a corner is missed by grows with its level; what the camera's model leaves out, of lens and shutter, does not.
    """
    return np.asarray(camera.pixels_across(CAMERA_SIGMA_DEG) ** 2 + (KEYPOINT_SIGMA_PX * scale_factors) ** 2)
