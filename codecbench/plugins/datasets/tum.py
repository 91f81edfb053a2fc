"""The dataset `tum`: the layout of the TUM RGB-D benchmark."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.contracts.sequence import Dataset, Depth, FrameSequence, Origin, Trajectory
from codecbench.plugins.datasets.calibration import FREIBURG, DepthCamera, depth_camera_from_file
from codecbench.plugins.datasets.files import Content, FileSequence, frame_size
from codecbench.plugins.datasets.selection import (
    DepthParams,
    FolderSelection,
    GivenCameraParams,
    KnownCamera,
    read_camera_file,
    workaround,
)
from codecbench.plugins.datasets.tables import (
    Floats,
    Row,
    increasing_times,
    rate_hz,
    read_rows,
    trajectory_from_quaternions,
)

_FOLDER_NAME = re.compile(r"freiburg([123])(?![0-9])")


_MOST_APART_S = 0.02
"""Largest distance in time of a pair of frames, as in the benchmark's own tool."""
_UNIT_M = 1.0 / 5000
"""Step of the benchmark's depth pictures, from its page on file formats."""


class TumParams(FolderSelection, GivenCameraParams, DepthParams):
    """Set the stream, the camera and the ground truth of a TUM RGB-D sequence."""

    stream: Annotated[
        Literal["color", "depth"],
        Field(description="color: rgb.txt; depth: frames of depth.txt beside a color one"),
    ] = "color"
    camera: Annotated[
        Literal["auto", "freiburg1", "freiburg2", "freiburg3", "none"],
        Field(description="auto: calib.yaml next to rgb.txt, else by `freiburgN` in the folder's name"),
    ] = "auto"
    ground_truth: Annotated[bool, Field(description="false for a sequence without groundtruth.txt")] = True

    @model_validator(mode="after")
    def _camera_once(self) -> Self:
        self.check_one_camera_source(self.camera)
        if self.stream == "color" and (self.depth_unit_m, self.depth_unknown) != (None, None):
            raise ValueError("`depth_unit_m` and `depth_unknown` are for `stream: depth`")
        return self


class Tum(Dataset[TumParams]):
    """Frames and times listed in rgb.txt or depth.txt; the camera's truth in groundtruth.txt with its own times.

    Depth is registered to color and has its camera, unless a calibration file has a section `depth`.

    Source: Sturm et al., "A Benchmark for the Evaluation of RGB-D SLAM Systems", IROS 2012, and the
    benchmark's page on file formats.
    """

    name: ClassVar[str] = "tum"
    version: ClassVar[str] = "1"
    params_type = TumParams

    @classmethod
    def recognise(cls, path: Path) -> dict[str, Any] | None:
        if path.name == "depth" and (path.parent / "depth.txt").is_file():
            params = cls.recognise(path.parent)
            return None if params is None else {**params, "stream": "depth"}
        if not (path / "rgb.txt").is_file():
            return None
        camera = (path / "calib.yaml").is_file() or _FOLDER_NAME.search(path.resolve().name)
        truth = (path / "groundtruth.txt").is_file()
        return {"path": str(path)} | ({} if camera else {"camera": "none"}) | ({} if truth else {"ground_truth": False})

    def open(self) -> FrameSequence:
        params = self.params
        folder = params.folder("rgb.txt")
        rows, times_s = _list(folder / "rgb.txt")
        is_depth = params.stream == "depth"
        pair_notes: tuple[str, ...] = ()
        if is_depth:
            rows, times_s, pair_notes = _beside(*_list(folder / "depth.txt"), times_s)
        uncalibrated = {} if params.calibration else {"camera": "none"}
        with workaround(**uncalibrated):
            recorded, fps = _known_camera(params, folder)
            depth_camera = _depth_camera(params, folder) if is_depth else None
        chosen = params.indices(len(rows), str(rows[0].file))
        files = tuple(folder / rows[index].fields[1] for index in chosen)
        if depth_camera is not None and recorded.camera is not None:
            recorded = replace(recorded, camera=depth_camera.camera)
        known = params.or_ideal_camera(recorded, lambda: frame_size(files[0], chosen[0]))
        truth = None
        if params.ground_truth:
            with workaround(ground_truth=False):
                truth = read_tum_trajectory(folder / "groundtruth.txt")
                if depth_camera is not None:
                    truth = Trajectory(truth.timestamps_s, truth.world_from_camera @ depth_camera.color_from_depth)
        content = Content(
            name=folder.resolve().name + ("_depth" if is_depth else ""),
            where=str(folder),
            files=files,
            numbers=chosen,
            timestamps_s=times_s[np.array(chosen)],
            frame_rate_hz=(fps or rate_hz(times_s, 30.0)) / params.stride,
            camera=known.camera,
            uncalibrated=uncalibrated,
            ground_truth=truth,
            depth=params.meaning(Depth(_UNIT_M) if depth_camera is None else depth_camera.depth) if is_depth else None,
            color=params.color,
            notes=(*params.subset_notes(len(rows)), *pair_notes, *known.notes),
            origin=Origin("TUM RGB-D folder" + (", depth" if is_depth else ""), known.source),
        )
        return params.as_asked(FileSequence(content))


def _list(file: Path) -> tuple[list[Row], Floats]:
    """The rows of a list of frames, and their times in seconds."""
    rows = read_rows(file, "the list of frames", 2)
    return rows, increasing_times([row.number(0) for row in rows], rows)


def _beside(rows: list[Row], times_s: Floats, color_s: Floats) -> tuple[list[Row], Floats, tuple[str, ...]]:
    """The rows and times of the depth frames that are nearest to a color frame, and a note on the others."""
    nearest = np.searchsorted((times_s[1:] + times_s[:-1]) / 2, color_s)
    kept = np.unique(nearest[np.abs(times_s[nearest] - color_s) <= _MOST_APART_S])
    if not len(kept):
        raise DatasetError(f"{rows[0].file}: no depth frame is within {_MOST_APART_S:g} s of a color frame of rgb.txt")
    fewer = len(rows) - len(kept)
    note = f"{fewer} of {len(rows)} depth frames are left out: they are not the nearest of a color frame within 20 ms"
    return [rows[index] for index in kept], times_s[kept], (note,) if fewer else ()


def _depth_camera(params: TumParams, folder: Path) -> DepthCamera | None:
    """The depth camera of the calibration file; None if it is the color camera."""
    file = folder / "calib.yaml" if params.calibration is None else params.calibration
    return depth_camera_from_file(file) if params.camera in ("auto", "none") and file.is_file() else None


def read_tum_trajectory(file: Path) -> Trajectory:
    """Read poses from lines `time tx ty tz qx qy qz qw`: seconds, meters, world from camera. Raises DatasetError."""
    rows = read_rows(file, "ground truth", 8, exact=True)
    table = np.array([row.numbers() for row in rows])
    times_s = increasing_times(table[:, 0].tolist(), rows)
    return trajectory_from_quaternions(times_s, table[:, 1:], "xyzw", rows)


def _known_camera(params: TumParams, folder: Path) -> tuple[KnownCamera, float | None]:
    """The published or recorded camera, and the frame rate if its file has one."""
    if params.camera == "none":
        return KnownCamera(), None
    if params.camera != "auto":
        return KnownCamera(FREIBURG[params.camera], params.camera), None
    beside = folder / "calib.yaml"
    if params.calibration is not None:
        return read_camera_file(params.calibration)
    if beside.is_file():
        return read_camera_file(beside)
    match = _FOLDER_NAME.search(folder.resolve().name)
    if match is None and params.fov_deg is not None:
        return KnownCamera(), None
    if match is None:
        raise DatasetError(
            f"{beside}: calibration is missing, and the folder's name does not contain freiburg1, 2 or 3; "
            "give `camera`, `calibration`, `fov_deg`, or `camera: none`"
        )
    return KnownCamera(FREIBURG[match[0]], f"the folder's name ({match[0]})"), None
