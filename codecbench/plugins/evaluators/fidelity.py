"""PSNR and structural similarity (SSIM) of 8-bit images, SSIM in two definitions and in its multi-scale form.

Sources: Wang, Bovik, Sheikh, Simoncelli, "Image quality assessment: from error visibility to structural
similarity", IEEE TIP 13(4), 2004, doi:10.1109/TIP.2003.819861 (eqs. 13 and 17); Wang, Simoncelli, Bovik,
"Multiscale structural similarity for image quality assessment", Asilomar 2003,
doi:10.1109/ACSSC.2003.1292216 (eq. 7).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.image import Image
from codecbench.core.kernels.compiled import compiled

WINDOW_RADIUS = 5
"""Pixels on each side of the centre of the 11x11 Gaussian window (Wang 2004, section III-C)."""
WINDOW_SIGMA = 1.5
"""Standard deviation of the window, pixels (Wang 2004, section III-C)."""
K1, K2 = 0.01, 0.03
"""Stabilising constants (Wang 2004, section III-C)."""
PEAK = 255.0
"""The dynamic range L of 8-bit images."""
SCALE_WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)
"""Exponents of the five scales, finest first (Wang 2003, section 3.2)."""

WINDOW_SIDE = 2 * WINDOW_RADIUS + 1
"""Smallest side for which the window fits inside the image."""
MULTISCALE_SIDE = WINDOW_SIDE << (len(SCALE_WEIGHTS) - 1)
"""Smallest side for which the window fits inside the image at the coarsest scale: 176."""


class Similarity(NamedTuple):
    """Mean SSIM of a pair of images under both definitions of the border, and its contrast part."""

    full: float
    """Over all pixels, with the border replicated outside the image."""
    inner: float
    """Over the pixels whose window lies inside the image; NaN if there are none."""
    contrast_structure: float
    """Mean product of contrast and structure over the same inner pixels, which the finer scales of MS-SSIM use."""


def gaussian_window() -> NDArray[np.float64]:
    """(6,) weights of the window in one dimension from its centre outwards; the whole window sums to 1."""
    weights = np.exp(-0.5 * (np.arange(WINDOW_RADIUS + 1) / WINDOW_SIGMA) ** 2)
    return np.asarray(weights / (weights[0] + 2.0 * weights[1:].sum()), dtype=np.float64)


_WINDOW = gaussian_window()


def similarity(gray: NDArray[Any], other: NDArray[Any]) -> Similarity:
    """SSIM of two (H, W) images of equal shape and dtype (uint8 or float64), values 0..255."""
    full, inner, contrast = _mean_similarity(gray, other, _WINDOW, (K1 * PEAK) ** 2, (K2 * PEAK) ** 2)
    height, width = gray.shape
    if min(height, width) < WINDOW_SIDE:
        return Similarity(full / gray.size, float("nan"), float("nan"))
    inner_pixels = (height - 2 * WINDOW_RADIUS) * (width - 2 * WINDOW_RADIUS)
    return Similarity(full / gray.size, inner / inner_pixels, contrast / inner_pixels)


def multiscale_similarity(gray: NDArray[Any], other: NDArray[Any], finest: Similarity) -> float:
    """MS-SSIM of two (H, W) images whose `similarity` is `finest`; NaN if a side is below MULTISCALE_SIDE.

    Each scale halves the image by averaging 2x2 blocks, leaving out an odd last row or column. A negative mean of
    contrast and structure counts as zero, because the exponents are fractions.
    """
    if min(gray.shape) < MULTISCALE_SIDE:
        return float("nan")
    value = max(finest.contrast_structure, 0.0) ** SCALE_WEIGHTS[0]
    for scale, weight in enumerate(SCALE_WEIGHTS[1:], start=1):
        gray, other = _halve(gray), _halve(other)
        at_scale = similarity(gray, other)
        coarsest = scale == len(SCALE_WEIGHTS) - 1
        value *= max(at_scale.inner if coarsest else at_scale.contrast_structure, 0.0) ** weight
    return float(value)


@compiled
def _halve(gray: NDArray[Any]) -> NDArray[np.float64]:
    """(H // 2, W // 2) means of the 2x2 blocks of an image."""
    height, width = gray.shape[0] // 2, gray.shape[1] // 2
    half = np.empty((height, width))
    for row in range(height):
        for column in range(width):
            upper = np.float64(gray[2 * row, 2 * column]) + np.float64(gray[2 * row, 2 * column + 1])
            lower = np.float64(gray[2 * row + 1, 2 * column]) + np.float64(gray[2 * row + 1, 2 * column + 1])
            half[row, column] = 0.25 * (upper + lower)
    return half


@compiled
def _mean_similarity(
    gray: NDArray[Any], other: NDArray[Any], window: NDArray[np.float64], c1: float, c2: float
) -> tuple[float, float, float]:
    """Sums of SSIM over all pixels, of SSIM and of contrast x structure over the inner ones.

    Only four windowed means are needed, x, y, x^2 + y^2 and x y, because SSIM holds the two variances as their sum.
    They lie in one line, each with its border continued, so that both directions are filtered by one loop over
    contiguous memory, which compilers vectorise. `lines` holds the rows under the window, each computed once.
    """
    height, width = gray.shape
    padded = width + 2 * WINDOW_RADIUS
    lines = np.empty((WINDOW_SIDE, 4 * padded))
    filtered = np.empty(4 * padded)
    means = np.zeros(4 * padded)
    similarities, contrasts = np.empty(width), np.empty(width)
    for row in range(-WINDOW_RADIUS, WINDOW_RADIUS):
        _load_line(gray, other, min(max(row, 0), height - 1), lines[row % WINDOW_SIDE])
    full, inner, inner_contrast = 0.0, 0.0, 0.0
    for row in range(height):
        last = row + WINDOW_RADIUS
        _load_line(gray, other, min(last, height - 1), lines[last % WINDOW_SIDE])
        _filter_down(lines, row % WINDOW_SIDE, window, filtered)
        _filter_along(filtered, window, means)
        _compare(means, c1, c2, similarities, contrasts)
        full += similarities.sum()
        if WINDOW_RADIUS <= row < height - WINDOW_RADIUS and width >= WINDOW_SIDE:
            inner += similarities[WINDOW_RADIUS : width - WINDOW_RADIUS].sum()
            inner_contrast += contrasts[WINDOW_RADIUS : width - WINDOW_RADIUS].sum()
    return full, inner, inner_contrast


@compiled
def _load_line(gray: NDArray[Any], other: NDArray[Any], row: int, line: NDArray[np.float64]) -> None:
    """The four quantities of a row, one after the other, each continued at both ends by WINDOW_RADIUS pixels."""
    width = gray.shape[1]
    quantities = line.reshape(4, width + 2 * WINDOW_RADIUS)
    for column in range(width):
        x, y = np.float64(gray[row, column]), np.float64(other[row, column])
        quantities[0, WINDOW_RADIUS + column] = x
        quantities[1, WINDOW_RADIUS + column] = y
        quantities[2, WINDOW_RADIUS + column] = x * x + y * y
        quantities[3, WINDOW_RADIUS + column] = x * y
    for quantity in range(4):
        quantities[quantity, :WINDOW_RADIUS] = quantities[quantity, WINDOW_RADIUS]
        quantities[quantity, WINDOW_RADIUS + width :] = quantities[quantity, WINDOW_RADIUS + width - 1]


@compiled
def _filter_down(
    lines: NDArray[np.float64], centre: int, window: NDArray[np.float64], filtered: NDArray[np.float64]
) -> None:
    """Weighted sum of the lines around line `centre` of the ring."""
    w0, w1, w2, w3, w4, w5 = window
    side = WINDOW_SIDE
    a5, a4, a3 = lines[(centre + 6) % side], lines[(centre + 7) % side], lines[(centre + 8) % side]
    a2, a1, c = lines[(centre + 9) % side], lines[(centre + 10) % side], lines[centre]
    b1, b2, b3 = lines[(centre + 1) % side], lines[(centre + 2) % side], lines[(centre + 3) % side]
    b4, b5 = lines[(centre + 4) % side], lines[(centre + 5) % side]
    for i in range(filtered.size):
        near = w0 * c[i] + w1 * (a1[i] + b1[i]) + w2 * (a2[i] + b2[i])
        filtered[i] = near + w3 * (a3[i] + b3[i]) + w4 * (a4[i] + b4[i]) + w5 * (a5[i] + b5[i])


@compiled
def _filter_along(line: NDArray[np.float64], window: NDArray[np.float64], means: NDArray[np.float64]) -> None:
    """Weighted sum along the line; entry i of `means` is centred on entry i + WINDOW_RADIUS of `line`."""
    w0, w1, w2, w3, w4, w5 = window
    a5, a4, a3, a2, a1 = line, line[1:], line[2:], line[3:], line[4:]
    c, b1, b2, b3, b4, b5 = line[5:], line[6:], line[7:], line[8:], line[9:], line[10:]
    for i in range(line.size - 2 * WINDOW_RADIUS):
        near = w0 * c[i] + w1 * (a1[i] + b1[i]) + w2 * (a2[i] + b2[i])
        means[i] = near + w3 * (a3[i] + b3[i]) + w4 * (a4[i] + b4[i]) + w5 * (a5[i] + b5[i])


@compiled
def _compare(
    means: NDArray[np.float64],
    c1: float,
    c2: float,
    similarities: NDArray[np.float64],
    contrasts: NDArray[np.float64],
) -> None:
    """SSIM (Wang 2004, eq. 13) and its contrast x structure part for each pixel of a row."""
    quantities = means.reshape(4, means.size // 4)
    for column in range(similarities.size):
        mean_x, mean_y = quantities[0, column], quantities[1, column]
        product, squares = mean_x * mean_y, mean_x * mean_x + mean_y * mean_y
        variances, covariance = quantities[2, column] - squares, quantities[3, column] - product
        contrasts[column] = (2.0 * covariance + c2) / (variances + c2)
        similarities[column] = (2.0 * product + c1) / (squares + c1) * contrasts[column]


def psnr_db(image: Image, other: Image) -> float:
    """10 log10(peak^2 / MSE) of two images of equal shape and dtype, the error averaged over pixels and channels alike.

    The peak is the largest value of the dtype: 255 or 65535.

    Infinite for identical images. The squared error is an integer; it is rounded because OpenCV's code for some
    processors takes its root and squares it again.
    """
    squared_error = round(cv2.norm(image, other, cv2.NORM_L2SQR))
    if squared_error == 0:
        return math.inf
    return 10.0 * math.log10(float(np.iinfo(image.dtype).max) ** 2 * image.size / squared_error)
