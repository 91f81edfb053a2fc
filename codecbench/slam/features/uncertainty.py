"""How well the place of a feature is known."""

from __future__ import annotations

from typing import Any

from codecbench.core.kernels.compiled import compiled
from codecbench.slam.thresholds import CAMERA_SIGMA_PX, KEYPOINT_SIGMA_PX


@compiled
def pixel_variance(scale: Any) -> Any:
    """Variance of a keypoint's place in the image along each axis, px^2, by its level's scale factor.

    What a corner is missed by grows with its level; what the camera's model leaves out, of lens and shutter, does not.
    """
    return CAMERA_SIGMA_PX * CAMERA_SIGMA_PX + (KEYPOINT_SIGMA_PX * scale) ** 2
