"""Convert an image to the planes that are coded, and back."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.image import Image
from codecbench.core.counting.kernel import kernel
from codecbench.core.counting.trace import NULL_TRACE, Trace
from codecbench.plugins.codecs.dct.color import (
    chroma_from_rgb,
    double,
    halve,
    luma_from_rgb,
    rgb_from_ycbcr,
)

Color = Literal["gray", "rgb", "ycbcr444", "ycbcr420"]
Plane = NDArray[np.uint8]

_DCT = "codecbench.plugins.codecs.dct"


def dct_kernels(color: Color) -> tuple[str, ...]:
    """Kernels of this package that planes of this color space need, for `Codec.kernels`."""
    names = ["blocks", "planes", "transform"]
    if color != "rgb":
        names += ["color.luma_from_rgb", "color.chroma_from_rgb", "color.rgb_from_ycbcr"]
    if color == "ycbcr420":
        names += ["color.halve", "color.double"]
    return tuple(f"{_DCT}.{name}" for name in names)


def plane_shapes(height: int, width: int, color: Color) -> list[tuple[int, int]]:
    """Return (height, width) of every plane, before padding."""
    full = (height, width)
    if color == "gray":
        return [full]
    if color == "ycbcr420":
        chroma = ((height + 1) // 2, (width + 1) // 2)
        return [full, chroma, chroma]
    return [full, full, full]


def planes_from_image(image: Image, color: Color, trace: Trace = NULL_TRACE) -> list[Plane]:
    """Split an image into planes of a color space.

    A gray image is one plane for every `color`. The planes may share memory with `image`, so they are read-only.
    """
    if image.ndim == 2:
        return [np.asarray(image, np.uint8)]
    height, width = image.shape[:2]
    planes = [np.empty(shape, np.uint8) for shape in plane_shapes(height, width, color)]
    with trace.stage("color_transform") as run:
        if color == "rgb":
            for channel, plane in enumerate(planes):
                run(_take_channel, image, channel, plane)
            return planes
        run(luma_from_rgb, image, planes[0])
        if color == "gray":
            return planes
        if color == "ycbcr444":
            run(chroma_from_rgb, image, planes[1], planes[2])
            return planes
        cb, cr = np.empty((height, width), np.uint8), np.empty((height, width), np.uint8)
        run(chroma_from_rgb, image, cb, cr)
        run(halve, cb, planes[1])
        run(halve, cr, planes[2])
    return planes


def image_from_planes(planes: list[Plane], color: Color, channels: int, trace: Trace = NULL_TRACE) -> Image:
    """Merge planes of `planes_from_image` into an (H, W) or (H, W, 3) image; a single plane fills all channels."""
    height, width = planes[0].shape
    if channels == 1:
        return planes[0]
    image = np.empty((height, width, 3), np.uint8)
    with trace.stage("inverse_color_transform") as run:
        if len(planes) == 1 or color == "rgb":
            for channel in range(3):
                run(_put_channel, planes[channel % len(planes)], channel, image)
            return image
        cb, cr = planes[1:]
        if color == "ycbcr420":
            cb, cr = np.empty((height, width), np.uint8), np.empty((height, width), np.uint8)
            run(double, planes[1], cb)
            run(double, planes[2], cr)
        run(rgb_from_ycbcr, planes[0], cb, cr, image)
    return image


def pad_plane(plane: Plane, multiple: int = 8, trace: Trace = NULL_TRACE) -> Plane:
    """Repeat the last row and column up to a multiple of `multiple`; returns the plane itself if it fits."""
    height, width = (-(-size // multiple) * multiple for size in plane.shape)
    if (height, width) == plane.shape:
        return plane
    larger = np.empty((height, width), np.uint8)
    with trace.stage("padding") as run:
        run(_repeat_edges, plane, larger)
    return larger


def crop_plane(plane: Plane, shape: tuple[int, int], trace: Trace = NULL_TRACE) -> Plane:
    """Copy the top left part of a plane; returns the plane itself if it has that shape."""
    if plane.shape == shape:
        return plane
    smaller = np.empty(shape, np.uint8)
    with trace.stage("cropping") as run:
        run(_copy_part, plane, smaller)
    return smaller


@kernel
def _take_channel(image: Any, channel: Any, plane: Any) -> None:
    for row in range(image.shape[0]):
        for column in range(image.shape[1]):
            plane[row, column] = image[row, column, channel]


@kernel
def _put_channel(plane: Any, channel: Any, image: Any) -> None:
    for row in range(image.shape[0]):
        for column in range(image.shape[1]):
            image[row, column, channel] = plane[row, column]


@kernel
def _repeat_edges(plane: Any, larger: Any) -> None:
    height, width = plane.shape
    for row in range(larger.shape[0]):
        source = min(row, height - 1)
        for column in range(width):
            larger[row, column] = plane[source, column]
        for column in range(width, larger.shape[1]):
            larger[row, column] = plane[source, width - 1]


@kernel
def _copy_part(plane: Any, smaller: Any) -> None:
    for row in range(smaller.shape[0]):
        for column in range(smaller.shape[1]):
            smaller[row, column] = plane[row, column]
