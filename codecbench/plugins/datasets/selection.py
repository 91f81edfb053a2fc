"""Parameters that all datasets share: which frames are used, how they are converted, and the camera."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import cv2
import numpy as np
from pydantic import Field, model_validator

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.contracts.image import Image, channel_count, gray_from_image
from codecbench.core.contracts.params import Params, PathParam
from codecbench.core.contracts.sequence import Camera, Depth, FrameSequence
from codecbench.plugins.datasets import catalog
from codecbench.plugins.datasets.adapted import MiscalibratedSequence, ScaledSequence
from codecbench.plugins.datasets.calibration import camera_from_file, camera_from_view

Color = Literal["as_is", "rgb", "gray"]


class Selection(Params):
    """Select frames start, start + stride, ... before stop (default: to the last), except those in skip.

    color: `as_is` gives gray files 1 channel and color files 3; `rgb` and `gray` convert. scale: factor on the frames'
    width and height and on the camera's lengths in pixels. calibration_error: see `MiscalibratedSequence`.
    """

    start: Annotated[int, Field(ge=0, description="first frame, counted from 0")] = 0
    stop: Annotated[int | None, Field(ge=1, description="frame before which to stop; default: after the last")] = None
    stride: Annotated[int, Field(ge=1, description="use every stride-th frame")] = 1
    skip: Annotated[
        tuple[Annotated[int, Field(ge=0)], ...],
        Field(description="frames to leave out, such as damaged ones; counted from 0"),
    ] = ()
    color: Annotated[Color, Field(description="as_is keeps the files' channels; rgb and gray convert")] = "as_is"
    scale: Annotated[
        float,
        Field(
            gt=0.0, le=16.0, description="factor on the frames' width and height, and on the camera's lengths in pixels"
        ),
    ] = 1.0
    calibration_error: Annotated[
        float,
        Field(
            ge=-0.1,
            le=0.1,
            description="error added to the camera's k1; half of it is the relative error of the focal length",
        ),
    ] = 0.0

    def indices(self, count: int, where: str) -> Sequence[int]:
        """Indices of the selected frames of `count`. Raises DatasetError, naming `where`, if they do not exist."""
        stop = count if self.stop is None else self.stop
        if stop > count:
            raise DatasetError(f"{where}: stop is {stop}, but there are {count} frames; leave it out to use them all")
        if self.start >= stop:
            limit = f"stop ({stop})" if self.stop is not None else f"the number of frames ({count})"
            raise DatasetError(f"{where}: start is {self.start}, which is not below {limit}; no frame is left")
        if self.skip and max(self.skip) >= count:
            raise DatasetError(f"{where}: skip has {max(self.skip)}, but there are {count} frames, counted from 0")
        skipped = set(self.skip)
        chosen = [index for index in range(self.start, stop, self.stride) if index not in skipped]
        if not chosen:
            raise DatasetError(f"{where}: skip removes every frame from {self.start} to {stop - 1}")
        return chosen

    def subset_notes(self, count: int) -> tuple[str, ...]:
        """Notes on which of a recording's `count` frames are used; none if all are."""
        chosen = self.indices(count, "")
        if len(chosen) == count:
            return ()
        if chosen[-1] == len(chosen) - 1:
            return (f"the first {len(chosen):,} of {count:,} frames are used",)
        steps = f", in steps of {self.stride}" if self.stride > 1 else ""
        skipped = f", without {len(self.skip)} in `skip`" if self.skip else ""
        span = f"from {chosen[0]:,} to {chosen[-1]:,}{steps}{skipped}"
        return (f"{len(chosen):,} of {count:,} frames are used, {span}",)

    def as_asked(self, sequence: FrameSequence) -> FrameSequence:
        """Apply `scale` and `calibration_error` to a sequence.

        Raises DatasetError if the scaled size is out of bounds, or if there is no camera for a calibration error.
        """
        sized = sequence if self.scale == 1.0 else ScaledSequence(sequence, self.scale)
        return MiscalibratedSequence(sized, self.calibration_error) if self.calibration_error else sized


def already_coded(what: str) -> str:
    """A note on frames that were coded with loss before; `what` says how."""
    return (
        f"THE FRAMES ARE ALREADY CODED: {what}; `raw` includes their losses, and every codec is compared with it, not "
        "with the camera's output"
    )


@contextmanager
def workaround(**params: Any) -> Iterator[None]:
    """Add these parameters to a DatasetError raised inside, as a way to open the rest, unless it names others."""
    try:
        yield
    except DatasetError as error:
        error.without = error.without or params
        raise


@dataclass(frozen=True)
class KnownCamera:
    """A camera or None, with its source and notes on it."""

    camera: Camera | None = None
    source: str = ""
    """File or topic that the camera was read from."""
    notes: tuple[str, ...] = ()


class FieldOfView(Params):
    """Set an ideal camera for recordings without calibration."""

    fov_deg: Annotated[
        float | None,
        Field(gt=0.0, lt=180.0, description="without calibration: horizontal field of view of an ideal pinhole camera"),
    ] = None

    def or_ideal_camera(self, known: KnownCamera, frame_size: Callable[[], tuple[int, int]]) -> KnownCamera:
        """The `known` camera if there is one, else the ideal camera if `fov_deg` was given.

        frame_size: returns width and height of the frames in pixels; called only if needed.
        """
        if self.fov_deg is None:
            return known
        view = f"{self.fov_deg:g} degrees"
        if known.camera is not None:
            unused = f"`fov_deg`, {view}, is not used: the camera is from {known.source}"
            return replace(known, notes=(*known.notes, unused))
        ideal = f"the camera is an ideal one of {view}: calibrate it before you trust a trajectory"
        return KnownCamera(camera_from_view(*frame_size(), self.fov_deg), "the field of view", (ideal,))


class RecordedCameraParams(FieldOfView):
    """Set the camera of recordings that include a calibration."""

    calibration: Annotated[
        Literal["auto", "none"], Field(description="auto: read the recording's own; none: do not read it")
    ] = "auto"


class GivenCameraParams(FieldOfView):
    """Set the camera of recordings without calibration by a file, or by an ideal camera's field of view."""

    calibration: Annotated[PathParam | None, Field(description="calibration file of the camera")] = None

    @model_validator(mode="after")
    def _one_camera(self) -> Self:
        if self.calibration is not None and self.fov_deg is not None:
            raise ValueError("give `calibration` or `fov_deg`, not both")
        return self

    def check_one_camera_source(self, camera: str) -> None:
        """Raise ValueError if both `camera` (other than `auto` or `none`) and another parameter set the camera."""
        if camera != "auto" and self.calibration is not None:
            raise ValueError("give `camera` or `calibration`, not both")
        if camera not in ("auto", "none") and self.fov_deg is not None:
            raise ValueError("give `camera` or `fov_deg`, not both")

    def given_camera(self, frame_size: Callable[[], tuple[int, int]]) -> KnownCamera:
        """The camera, if one was given. Raises DatasetError if its file is wrong."""
        known = KnownCamera() if self.calibration is None else read_camera_file(self.calibration)[0]
        return self.or_ideal_camera(known, frame_size)


def read_camera_file(calibration: Path) -> tuple[KnownCamera, float | None]:
    """Read the camera in a calibration file, and the frame rate if it has one. Raises DatasetError."""
    camera, fps = camera_from_file(calibration)
    return KnownCamera(camera, calibration.name), fps


class DepthParams(Params):
    """Say what the steps of depth pictures mean."""

    depth_unit_m: Annotated[
        float | None, Field(gt=0.0, le=1.0, description="meters of a step of depth pictures, such as 0.001")
    ] = None
    depth_unknown: Annotated[
        int | None,
        Field(ge=0, le=65535, description="value of depth pixels without distance; default: as recorded, or 0"),
    ] = None

    def meaning(self, recorded: Depth) -> Depth:
        """What depth pixels mean: as recorded, but for what was given."""
        unknown = recorded.unknown if self.depth_unknown is None else self.depth_unknown
        return Depth(self.depth_unit_m or recorded.unit_m, unknown)


class FolderSelection(Selection):
    """Select from a folder on disk: your own, or one fetched by `codecbench data fetch`."""

    path: Annotated[PathParam | None, Field(description="folder of the sequence")] = None
    fetched: Annotated[
        str | None, Field(description="instead of path: name of a dataset in `codecbench data list`")
    ] = None

    @model_validator(mode="after")
    def _one_place(self) -> Self:
        if (self.path is None) == (self.fetched is None):
            raise ValueError("give either `path` or `fetched`")
        return self

    def folder(self, holds: str) -> Path:
        """The sequence's folder. Raises DatasetError if it is missing; the message names what it `holds`."""
        if self.path is None:
            return catalog.path(str(self.fetched))
        if not self.path.is_dir():
            raise DatasetError(f"{self.path}: is not a folder; set `path` to the one that contains {holds}")
        return self.path


def convert_color(image: Image, color: Color) -> Image:
    """Convert an image to the channels of `color`."""
    if color == "gray":
        return gray_from_image(image)
    if color == "rgb" and channel_count(image) == 1:
        if image.dtype == np.uint16:
            raise DatasetError("frames of 16 bits are gray: leave out `color: rgb`", {"color": "as_is"})
        return np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2RGB), dtype=np.uint8)
    return image
