"""The dataset `tum`: the layout of the TUM RGB-D benchmark."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.contracts.sequence import Dataset, FrameSequence, Origin, Trajectory
from codecbench.plugins.datasets.calibration import FREIBURG
from codecbench.plugins.datasets.files import Content, FileSequence, frame_size
from codecbench.plugins.datasets.selection import (
    FolderSelection,
    GivenCameraParams,
    KnownCamera,
    read_camera_file,
    workaround,
)
from codecbench.plugins.datasets.tables import increasing_times, rate_hz, read_rows, trajectory_from_quaternions

_FOLDER_NAME = re.compile(r"freiburg([123])(?![0-9])")


class TumParams(FolderSelection, GivenCameraParams):
    """Set the camera and the ground truth of a TUM RGB-D sequence."""

    camera: Annotated[
        Literal["auto", "freiburg1", "freiburg2", "freiburg3", "none"],
        Field(description="auto: calib.yaml next to rgb.txt, else by `freiburgN` in the folder's name"),
    ] = "auto"
    ground_truth: Annotated[bool, Field(description="false for a sequence without groundtruth.txt")] = True

    @model_validator(mode="after")
    def _camera_once(self) -> Self:
        self.check_one_camera_source(self.camera)
        return self


class Tum(Dataset[TumParams]):
    """Frames and times listed in rgb.txt; the camera's ground truth in groundtruth.txt with its own times.

    Source: Sturm et al., "A Benchmark for the Evaluation of RGB-D SLAM Systems", IROS 2012, and the
    benchmark's page on file formats.
    """

    name: ClassVar[str] = "tum"
    version: ClassVar[str] = "1"
    params_type = TumParams

    @classmethod
    def recognise(cls, path: Path) -> dict[str, Any] | None:
        if not (path / "rgb.txt").is_file():
            return None
        camera = (path / "calib.yaml").is_file() or _FOLDER_NAME.search(path.resolve().name)
        truth = (path / "groundtruth.txt").is_file()
        return {"path": str(path)} | ({} if camera else {"camera": "none"}) | ({} if truth else {"ground_truth": False})

    def open(self) -> FrameSequence:
        params = self.params
        folder = params.folder("rgb.txt")
        rows = read_rows(folder / "rgb.txt", "the list of frames", 2)
        times_s = increasing_times([row.number(0) for row in rows], rows)
        uncalibrated = {} if params.calibration else {"camera": "none"}
        with workaround(**uncalibrated):
            recorded, fps = _known_camera(params, folder)
        chosen = params.indices(len(rows), str(folder / "rgb.txt"))
        files = tuple(folder / rows[index].fields[1] for index in chosen)
        known = params.or_ideal_camera(recorded, lambda: frame_size(files[0], chosen[0]))
        truth = None
        if params.ground_truth:
            with workaround(ground_truth=False):
                truth = read_tum_trajectory(folder / "groundtruth.txt")
        content = Content(
            name=folder.resolve().name,
            where=str(folder),
            files=files,
            numbers=chosen,
            timestamps_s=times_s[np.array(chosen)],
            frame_rate_hz=(fps or rate_hz(times_s, 30.0)) / params.stride,
            camera=known.camera,
            uncalibrated=uncalibrated,
            ground_truth=truth,
            color=params.color,
            notes=(*params.subset_notes(len(rows)), *known.notes),
            origin=Origin("TUM RGB-D folder", known.source),
        )
        return params.as_asked(FileSequence(content))


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
