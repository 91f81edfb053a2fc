"""Sequences made of others: frames made smaller or larger, or with a camera that is slightly wrong."""

from __future__ import annotations

import hashlib
from dataclasses import replace
from functools import cached_property

import cv2
import numpy as np

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.contracts.image import MAX_PIXELS, Image
from codecbench.core.contracts.sequence import Camera, Frame, FrameSequence, Origin
from codecbench.plugins.datasets.calibration import miscalibrate

MIN_SIDE_PX = 16
"""Pixels: smaller frames show nothing, and no synthetic one is smaller."""


class AdaptedSequence(FrameSequence):
    """The frames of another sequence, its camera, times and ground truth, as far as a subclass does not change them."""

    def __init__(self, source: FrameSequence) -> None:
        self.name = source.name
        self.timestamps_s = source.timestamps_s
        self.frame_rate_hz = source.frame_rate_hz
        self.channels = source.channels
        self.camera = source.camera
        self.ground_truth = source.ground_truth
        self.notes = source.notes
        self._source = source

    @cached_property
    def origin(self) -> Origin:  # type: ignore[override]
        return self._source.origin

    def read(self, index: int) -> Frame:
        return self._source.read(index)


class MiscalibratedSequence(AdaptedSequence):
    """A sequence as a slightly wrong calibration gives it: k1 is too large by `error`, the focal length by half of it.

    Raises DatasetError where there is no camera.
    """

    def __init__(self, source: FrameSequence, error: float) -> None:
        super().__init__(source)
        if source.camera is None:
            raise DatasetError(f"{source.name}: no camera is known that could be wrong", {"calibration_error": 0.0})
        self.camera = miscalibrate(source.camera, error)
        self.name += f"-k1{error:+g}"
        self.as_calibrated = source.fingerprint
        self.fingerprint = hashlib.sha256(f"{source.fingerprint} miscalibrated by {error!r}".encode()).hexdigest()
        self.notes += (f"its calibration is wrong on purpose: k1 by {error:+g}, the focal length by {50 * error:+g} %",)


class ScaledSequence(AdaptedSequence):
    """The frames of another sequence at `scale` times their width and height; times and ground truth are its own.

    A pixel of a smaller frame is the mean of the area that it covers; larger frames are interpolated, bicubic. Raises
    DatasetError for frames that would have sides below MIN_SIDE_PX, or more than MAX_PIXELS.
    """

    def __init__(self, source: FrameSequence, scale: float) -> None:
        super().__init__(source)
        self._scale = scale
        camera = source.camera
        before = (camera.width, camera.height) if camera is not None else source.read(0).image.shape[1::-1]
        size = self._size(before)
        self.camera = None if camera is None else scaled_camera(camera, size)
        how = "as means over areas" if scale < 1.0 else "bicubic"
        self.notes += (
            f"frames of {before[0]}x{before[1]} are scaled to {size[0]}x{size[1]} ({how}), the camera with them",
        )

    @cached_property
    def fingerprint(self) -> str:  # type: ignore[override]
        """Digest over the other sequence's and the scale."""
        return hashlib.sha256(f"{self._source.fingerprint} scaled by {self._scale!r}".encode()).hexdigest()

    @cached_property
    def origin(self) -> Origin:  # type: ignore[override]
        found = self._source.origin
        return replace(found, sizes=tuple(self._size(size) for size in found.sizes))

    def read(self, index: int) -> Frame:
        frame = self._source.read(index)
        return Frame(frame.index, frame.timestamp_s, scaled_image(frame.image, self._size(frame.image.shape[1::-1])))

    def _size(self, size: tuple[int, ...]) -> tuple[int, int]:
        """Width and height of what frames of a size become."""
        width, height = (round(side * self._scale) for side in size)
        if min(width, height) < MIN_SIDE_PX or width * height > MAX_PIXELS:
            raise DatasetError(
                f"{self.name}: `scale` {self._scale:g} makes {width}x{height} of frames of {size[0]}x{size[1]}; "
                f"at least {MIN_SIDE_PX} pixels a side and at most {MAX_PIXELS:,} in all are allowed: choose another"
            )
        return width, height


def scaled_image(image: Image, size: tuple[int, int]) -> Image:
    """The image at another width and height: means over areas where it becomes smaller, bicubic where larger."""
    how = cv2.INTER_AREA if size[0] < image.shape[1] else cv2.INTER_CUBIC
    return np.asarray(cv2.resize(image, size, interpolation=how), dtype=np.uint8)


def scaled_camera(camera: Camera, size: tuple[int, int]) -> Camera:
    """The camera of frames that were scaled to a width and height.

    Pixel centres are at integers, so that the frame's corner, which stays the corner, is at -0.5.
    """
    across, down = size[0] / camera.width, size[1] / camera.height
    return replace(
        camera,
        width=size[0],
        height=size[1],
        fx=camera.fx * across,
        fy=camera.fy * down,
        cx=(camera.cx + 0.5) * across - 0.5,
        cy=(camera.cy + 0.5) * down - 0.5,
    )
