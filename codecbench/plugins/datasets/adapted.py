"""Sequences derived from others: scaled frames, or a slightly wrong camera calibration."""

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
"""Smallest side of a scaled frame; synthetic frames are never smaller."""


class AdaptedSequence(FrameSequence):
    """Relays another sequence's frames, camera, times and ground truth; subclasses override some of them."""

    def __init__(self, source: FrameSequence) -> None:
        self.name = source.name
        self.timestamps_s = source.timestamps_s
        self.frame_rate_hz = source.frame_rate_hz
        self.channels = source.channels
        self.bits = source.bits
        self.depth = source.depth
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
    """A sequence with a slightly wrong calibration: k1 is too large by `error`, the focal length by half of it.

    Raises DatasetError if the sequence has no camera.
    """

    def __init__(self, source: FrameSequence, error: float) -> None:
        super().__init__(source)
        if source.camera is None:
            raise DatasetError(f"{source.name}: `calibration_error` needs a camera", {"calibration_error": 0.0})
        self.camera = miscalibrate(source.camera, error)
        self.name += f"-k1{error:+g}"
        self.as_calibrated = source.fingerprint
        self.fingerprint = hashlib.sha256(f"{source.fingerprint} miscalibrated by {error!r}".encode()).hexdigest()
        self.notes += (f"its calibration is wrong on purpose: k1 by {error:+g}, the focal length by {50 * error:+g} %",)


class ScaledSequence(AdaptedSequence):
    """The frames of another sequence at `scale` times their width and height; times and ground truth stay.

    A pixel of a smaller frame is the mean of the area it covers. Larger frames are interpolated bicubically. Pixels of
    depth are those nearest. Raises DatasetError if a scaled frame has a side below MIN_SIDE_PX or more than MAX_PIXELS.
    """

    def __init__(self, source: FrameSequence, scale: float) -> None:
        super().__init__(source)
        self._scale = scale
        camera = source.camera
        unscaled = (camera.width, camera.height) if camera is not None else source.read(0).image.shape[1::-1]
        size = self._scaled_size(unscaled)
        self.camera = None if camera is None else scaled_camera(camera, size)
        how = "as means over areas" if scale < 1.0 else "bicubic"
        how = how if self.depth is None else "nearest pixels: a mean of distances may be nowhere"
        self.notes += (
            f"frames of {unscaled[0]}x{unscaled[1]} are scaled to {size[0]}x{size[1]} ({how}), and so is the camera",
        )

    @cached_property
    def fingerprint(self) -> str:  # type: ignore[override]
        """Digest over the other sequence's fingerprint and the scale."""
        return hashlib.sha256(f"{self._source.fingerprint} scaled by {self._scale!r}".encode()).hexdigest()

    @cached_property
    def origin(self) -> Origin:  # type: ignore[override]
        origin = self._source.origin
        return replace(origin, sizes=tuple(self._scaled_size(size) for size in origin.sizes))

    def read(self, index: int) -> Frame:
        frame = self._source.read(index)
        size = self._scaled_size(frame.image.shape[1::-1])
        return Frame(frame.index, frame.timestamp_s, scaled_image(frame.image, size, nearest=self.depth is not None))

    def _scaled_size(self, size: tuple[int, ...]) -> tuple[int, int]:
        """Width and height that frames of `size` are scaled to."""
        width, height = (round(side * self._scale) for side in size)
        if min(width, height) < MIN_SIDE_PX or width * height > MAX_PIXELS:
            raise DatasetError(
                f"{self.name}: `scale` {self._scale:g} makes {width}x{height} from frames of {size[0]}x{size[1]}; "
                f"at least {MIN_SIDE_PX} pixels a side and at most {MAX_PIXELS:,} in all are allowed: choose another"
            )
        return width, height


def scaled_image(image: Image, size: tuple[int, int], *, nearest: bool = False) -> Image:
    """Scale an image to another width and height: means over areas if it shrinks, bicubic if it grows.

    nearest: each pixel is the one at the nearest place.
    """
    smooth = cv2.INTER_AREA if size[0] < image.shape[1] else cv2.INTER_CUBIC
    interpolation = cv2.INTER_NEAREST_EXACT if nearest else smooth
    return np.asarray(cv2.resize(image, size, interpolation=interpolation), dtype=image.dtype)


def scaled_camera(camera: Camera, size: tuple[int, int]) -> Camera:
    """The camera of frames that were scaled to a width and height.

    Pixel centers are at integers, so the frame's corner is at -0.5 at every scale.
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
