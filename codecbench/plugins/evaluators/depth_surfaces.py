"""Surfaces in depth images: their edges, and planes fitted to small patches of them.

On a plane the inverse of the distance along the optical axis is linear in the pixel coordinates of a pinhole camera, so
a plane is a linear least-squares fit. Sensors that triangulate have the same noise everywhere in the inverse distance,
so all pixels have the same weight.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.image import Image
from codecbench.core.contracts.sequence import Camera

_FARTHEST = 65535


class Edges(NamedTuple):
    """Edges of a depth image, and the distances around each pixel."""

    mask: NDArray[np.bool_]
    """(H, W) whether a jump, or a pixel without a distance, is in the neighborhood."""
    near: NDArray[Any]
    """(H, W) uint16, smallest distance in the neighborhood in steps."""
    far: NDArray[Any]
    """(H, W) uint16, largest distance in the neighborhood in steps."""


def edges_of(image: Image, unknown: int, radius_px: int, jump: float) -> Edges:
    """Find the edges of a depth image, (H, W) uint16.

    radius_px: reach of a neighborhood, which is a square around its pixel; at least 1. jump: difference within 3x3
    pixels beyond which there is an edge, as a share of the smallest distance.
    """
    holes = image == unknown
    nearest, farthest = np.where(holes, np.uint16(_FARTHEST), image), np.where(holes, np.uint16(0), image)
    adjacent, around = (np.ones((2 * radius + 1,) * 2, np.uint8) for radius in (1, radius_px))
    jumps = cv2.dilate(farthest, adjacent) > (1.0 + jump) * cv2.erode(nearest, adjacent)
    # A jump marks the pixels on both sides already, hence one pixel less on each side of the square.
    marked = cv2.max(cv2.dilate(jumps.astype(np.uint8), around[2:, 2:]), cv2.dilate(holes.astype(np.uint8), around))
    return Edges(np.asarray(marked > 0), cv2.erode(nearest, around), cv2.dilate(farthest, around))


@dataclass(frozen=True)
class Patches:
    """Planes fitted to the square patches of a depth image, row by row."""

    planes: NDArray[np.float64]
    """(N, 3) inverse distance at the center of each patch, and its slopes along x and y per pixel, in 1/steps."""
    residuals: NDArray[np.float32]
    """(N,) RMS difference between inverse distances and their plane in 1/steps."""
    centers_px: NDArray[np.float64]
    """(N, 2) x and y of the centers."""

    def distances(self) -> NDArray[np.float64]:
        """(N,) distances of the planes at the centers along the optical axis in steps."""
        return 1.0 / self.planes[:, 0]

    def normals(self, camera: Camera) -> NDArray[np.float64]:
        """(N, 3) unit normals in the frame of a pinhole camera, whose distortion is ignored."""
        slopes = self.planes[:, 1:]
        at_axis = self.planes[:, 0] + (slopes * ((camera.cx, camera.cy) - self.centers_px)).sum(axis=1)
        normals = np.column_stack([slopes * (camera.fx, camera.fy), at_axis])
        return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True))


def fit_patches(image: Image, side_px: int) -> Patches:
    """Fit a plane to each patch of side_px x side_px pixels of a depth image; a distance of 0 counts as one step."""
    inverses = cut(np.float32(1.0) / np.maximum(image, 1), side_px)
    y, x = np.indices((side_px, side_px), np.float32).reshape(2, -1) - (side_px - 1) / 2
    design = np.stack([np.ones_like(x), x, y])  # its rows are orthogonal
    planes = inverses @ (design / (design**2).sum(axis=1, keepdims=True)).T
    deviations = inverses - planes @ design
    residuals = np.sqrt(np.einsum("ij,ij->i", deviations, deviations) / side_px**2)
    rows, columns = (length // side_px for length in image.shape)
    centers_px = np.indices((rows, columns)).reshape(2, -1).T[:, ::-1] * side_px + (side_px - 1) / 2
    return Patches(planes.astype(np.float64), residuals, centers_px)


def cut(pixels: NDArray[Any], side_px: int) -> NDArray[Any]:
    """Cut (H, W) pixels into (N, side_px^2) patches, row by row, without the last rows and columns that fill none."""
    rows, columns = (length // side_px for length in pixels.shape)
    inside = pixels[: rows * side_px, : columns * side_px].reshape(rows, side_px, columns, side_px)
    return inside.swapaxes(1, 2).reshape(rows * columns, side_px * side_px)
