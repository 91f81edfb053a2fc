"""Images in gray, in which features are found."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

ImageArray = NDArray[np.uint8]


def to_gray(image: NDArray[Any]) -> ImageArray:
    """The image in gray (height, width), by BT.601 where it has three channels, red first.

    Raises TypeError for what is not a uint8 array (height, width) or (height, width, 1 or 3).
    """
    if not isinstance(image, np.ndarray) or image.dtype != np.uint8:
        raise TypeError(f"image: got {getattr(image, 'dtype', type(image).__name__)}; expected a uint8 array")
    if image.ndim == 3 and image.shape[2] == 1:
        image = image[:, :, 0]
    if image.ndim == 2:
        return np.ascontiguousarray(image)
    if image.ndim == 3 and image.shape[2] == 3:
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
    raise TypeError(f"image: got shape {image.shape}; expected (height, width) or (height, width, 3)")
