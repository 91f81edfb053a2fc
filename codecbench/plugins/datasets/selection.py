"""Which frames of a sequence are used, and as what: parameters that all datasets share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal, Self

import cv2
import numpy as np
from pydantic import Field, model_validator

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.contracts.image import Image, channel_count, gray_from_image
from codecbench.core.contracts.params import Params, PathParam
from codecbench.core.contracts.sequence import Camera
from codecbench.plugins.datasets.calibration import camera_from_file, camera_from_view

Color = Literal["as_is", "rgb", "gray"]


class Selection(Params):
    """Frames start, start + stride, ... before stop, counted from 0; without stop, up to the last.

    color: `as_is` gives gray files 1 channel and colour files 3; `rgb` and `gray` convert.
    """

    start: Annotated[int, Field(ge=0, description="first frame, counted from 0")] = 0
    stop: Annotated[int | None, Field(ge=1, description="frame before which to stop; default: after the last")] = None
    stride: Annotated[int, Field(ge=1, description="use every stride-th frame")] = 1
    color: Annotated[Color, Field(description="as_is keeps the files' channels; rgb and gray convert")] = "as_is"

    def indices(self, count: int, where: str) -> range:
        """The selected frames of `count`. Raises DatasetError, naming `where`, for a selection that is not there."""
        stop = count if self.stop is None else self.stop
        if stop > count:
            raise DatasetError(f"{where}: stop is {stop}, but there are {count} frames; leave it out to use them all")
        if self.start >= stop:
            limit = f"stop ({stop})" if self.stop is not None else f"the number of frames ({count})"
            raise DatasetError(f"{where}: start is {self.start}, which is not below {limit}; no frame is left")
        return range(self.start, stop, self.stride)

    def notes_of_part(self, count: int) -> tuple[str, ...]:
        """What is to be said of a recording of `count` frames of which only some are used."""
        chosen = self.indices(count, "")
        if len(chosen) == count:
            return ()
        if chosen[-1] == len(chosen) - 1:
            return (f"the first {len(chosen):,} of {count:,} frames are used",)
        steps = f", in steps of {self.stride}" if self.stride > 1 else ""
        return (f"{len(chosen):,} of {count:,} frames are used, from {chosen[0]:,} to {chosen[-1]:,}{steps}",)


class OwnCamera(Params):
    """The camera of recordings that bring none: from a calibration file, or an ideal one by its field of view."""

    calibration: Annotated[PathParam | None, Field(description="calibration file of the camera")] = None
    fov_deg: Annotated[
        float | None,
        Field(gt=0.0, lt=180.0, description="instead: horizontal field of view of an ideal pinhole camera"),
    ] = None

    @model_validator(mode="after")
    def _one_camera(self) -> Self:
        if self.calibration is not None and self.fov_deg is not None:
            raise ValueError("give `calibration` or `fov_deg`, not both")
        return self

    @property
    def camera_notes(self) -> tuple[str, ...]:
        """What is to be said of a camera that nobody measured."""
        if self.fov_deg is None:
            return ()
        return (f"the camera is an ideal one of {self.fov_deg:g} degrees: calibrate it before you trust a path",)

    def camera(self, frame_size: Callable[[], tuple[int, int]]) -> Camera | None:
        """The camera, if one was given, of frames whose width and height are asked for if they are needed.

        Raises DatasetError for a wrong file.
        """
        if self.fov_deg is not None:
            return camera_from_view(*frame_size(), self.fov_deg)
        return None if self.calibration is None else camera_from_file(self.calibration)[0]


class Located(Selection):
    """Selection from a folder on disk: one's own, or one that `codecbench data fetch` brought."""

    path: Annotated[PathParam | None, Field(description="folder of the sequence")] = None
    fetched: Annotated[str | None, Field(description="name of a dataset of `codecbench data list`, instead")] = None

    @model_validator(mode="after")
    def _one_place(self) -> Self:
        if (self.path is None) == (self.fetched is None):
            raise ValueError("give either `path` or `fetched`")
        return self

    def folder(self, holds: str) -> Path:
        """The sequence's folder. Raises DatasetError where it is not there, saying what it `holds`."""
        from codecbench.plugins.datasets import catalog

        if self.path is None:
            return catalog.path(str(self.fetched))
        if not self.path.is_dir():
            raise DatasetError(f"{self.path}: is not a folder; `path` names the one that holds {holds}")
        return self.path


def converted(image: Image, color: Color) -> Image:
    """The image with the channels that `color` asks for."""
    if color == "gray":
        return gray_from_image(image)
    if color == "rgb" and channel_count(image) == 1:
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2RGB), dtype=np.uint8)
    return image
