"""Color transforms: RGB to YCbCr and back as in JFIF, luma as in OpenCV, and 4:2:0 chroma.

The integer arithmetic is libjpeg's, with 16 fractional bits (15 for luma) and halves up, so that its decoder and ours
agree.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from codecbench.core.counting.kernel import kernel


@kernel
def luma_from_rgb(image: Any, luma: Any) -> None:
    """Compute BT.601 luma. image: (H, W, 3) uint8. luma: (H, W) uint8, filled; equals `gray_from_image`."""
    for row in range(image.shape[0]):
        for column in range(image.shape[1]):
            red = np.int32(image[row, column, 0])
            green = np.int32(image[row, column, 1])
            blue = np.int32(image[row, column, 2])
            luma[row, column] = np.uint8((9798 * red + 19235 * green + 3735 * blue + 16384) >> 15)


@kernel
def chroma_from_rgb(image: Any, cb: Any, cr: Any) -> None:
    """Compute JFIF chroma with 128 for gray. image: (H, W, 3) uint8. cb, cr: (H, W) uint8, filled."""
    for row in range(image.shape[0]):
        for column in range(image.shape[1]):
            red = np.int32(image[row, column, 0])
            green = np.int32(image[row, column, 1])
            blue = np.int32(image[row, column, 2])
            cb[row, column] = np.uint8((32768 * blue - 11059 * red - 21709 * green + 8421375) >> 16)
            cr[row, column] = np.uint8((32768 * red - 27439 * green - 5329 * blue + 8421375) >> 16)


@kernel
def _clamp(sample: Any) -> Any:
    return np.uint8(min(max(sample, 0), 255))


@kernel
def rgb_from_ycbcr(luma: Any, cb: Any, cr: Any, image: Any) -> None:
    """Convert JFIF YCbCr to RGB, clamped to 0..255. luma, cb, cr: (H, W) uint8. image: (H, W, 3) uint8, filled."""
    for row in range(luma.shape[0]):
        for column in range(luma.shape[1]):
            y = np.int32(luma[row, column])
            blue = np.int32(cb[row, column]) - 128
            red = np.int32(cr[row, column]) - 128
            image[row, column, 0] = _clamp(y + ((91881 * red + 32768) >> 16))
            image[row, column, 1] = _clamp(y + ((32768 - 22554 * blue - 46802 * red) >> 16))
            image[row, column, 2] = _clamp(y + ((116130 * blue + 32768) >> 16))


@kernel
def halve(plane: Any, halved: Any) -> None:
    """Average 2x2 samples; an odd edge is repeated. plane: (H, W) uint8. halved: (ceil H/2, ceil W/2), filled."""
    last_row = plane.shape[0] - 1
    last_column = plane.shape[1] - 1
    for row in range(halved.shape[0]):
        top = 2 * row
        bottom = min(top + 1, last_row)
        for column in range(halved.shape[1]):
            left = 2 * column
            right = min(left + 1, last_column)
            upper = np.int32(plane[top, left]) + np.int32(plane[top, right])
            lower = np.int32(plane[bottom, left]) + np.int32(plane[bottom, right])
            halved[row, column] = np.uint8((upper + lower + 2) >> 2)


@kernel
def double(plane: Any, doubled: Any) -> None:
    """Interpolate linearly to twice the size, as libjpeg upsamples 4:2:0.

    plane: (ceil H/2, ceil W/2) uint8. doubled: (H, W) uint8, filled. Weights are 9, 3, 3, 1 sixteenths,
    rounded with 8 on even columns and 7 on odd ones.
    """
    last_row = plane.shape[0] - 1
    last_column = plane.shape[1] - 1
    for row in range(doubled.shape[0]):
        near = row >> 1
        far = min(max(near - 1 + 2 * (row & 1), 0), last_row)
        for column in range(doubled.shape[1]):
            odd = column & 1
            this = column >> 1
            other = min(max(this - 1 + 2 * odd, 0), last_column)
            here = 3 * np.int32(plane[near, this]) + np.int32(plane[far, this])
            beside = 3 * np.int32(plane[near, other]) + np.int32(plane[far, other])
            doubled[row, column] = np.uint8((3 * here + beside + 8 - odd) >> 4)
