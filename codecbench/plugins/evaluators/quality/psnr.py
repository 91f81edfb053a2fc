"""Peak signal-to-noise ratio of 8-bit images."""

from __future__ import annotations

import math

import cv2

from codecbench.core.contracts.image import Image


def psnr_db(image: Image, other: Image) -> float:
    """10 log10(255^2 / MSE) of two images of equal shape, the error averaged over pixels and channels alike.

    Infinite for identical images. The squared error is an integer, which OpenCV's code for some processors takes the
    root of and squares again.
    """
    squared_error = round(cv2.norm(image, other, cv2.NORM_L2SQR))
    if squared_error == 0:
        return math.inf
    return 10.0 * math.log10(255.0**2 * image.size / squared_error)
