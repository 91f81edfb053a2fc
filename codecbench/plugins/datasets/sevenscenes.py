"""The dataset `sevenscenes`: a sequence of Microsoft's 7-Scenes as published, its color or its depth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, ClassVar, Final, Literal

import numpy as np
from pydantic import Field

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.contracts.sequence import Camera, Dataset, Depth, FrameSequence, Origin, Trajectory
from codecbench.plugins.datasets.files import Content, FileSequence, frame_size
from codecbench.plugins.datasets.selection import FolderSelection, GivenCameraParams, KnownCamera, workaround
from codecbench.plugins.datasets.tables import Floats, orthonormalize, read_rows

_RATE_HZ: Final = 30.0
_DEPTH: Final = Depth(0.001, 65535)
_DEPTH_CAMERA: Final = Camera(640, 480, 585.0, 585.0, 320.0, 240.0)
_POSES_NOTE: Final = "the poses are the depth camera's, some centimeters from the color camera's"


class SevenScenesParams(FolderSelection, GivenCameraParams):
    """Set the stream, the camera and the ground truth of a sequence of 7-Scenes."""

    stream: Annotated[Literal["color", "depth"], Field(description="color, or depth in millimeters")] = "color"
    ground_truth: Annotated[bool, Field(description="false for a sequence without frame-*.pose.txt")] = True


class SevenScenes(Dataset[SevenScenesParams]):
    """Frames of a folder such as chess/seq-01: frame-000000.color.png, .depth.png, .pose.txt.

    Depth is the sensor's own picture, not registered to color: millimeters, 65535 if unknown. Its camera is the one
    that the publisher states; color has none. Source: Shotton et al., "Scene Coordinate Regression Forests for Camera
    Relocalization in RGB-D Images", CVPR 2013, doi:10.1109/CVPR.2013.377, and the data set's page.
    """

    name: ClassVar[str] = "sevenscenes"
    version: ClassVar[str] = "1"
    params_type = SevenScenesParams

    @classmethod
    def recognise(cls, path: Path) -> dict[str, Any] | None:
        if not (path / "frame-000000.color.png").is_file():
            return None
        truth = (path / "frame-000000.pose.txt").is_file()
        return {"path": str(path)} | ({} if truth else {"ground_truth": False})

    def open(self) -> FrameSequence:
        params = self.params
        folder = params.folder("frame-000000.color.png and the others")
        is_depth = params.stream == "depth"
        pictures = sorted(folder.glob(f"frame-{'[0-9]' * 6}.{params.stream}.png"))
        if not pictures:
            raise DatasetError(f"{folder}: contains no frame-*.{params.stream}.png; set `path` to a folder like seq-01")
        chosen = params.indices(len(pictures), str(folder))
        files = tuple(pictures[index] for index in chosen)
        times_s = np.array([int(file.name[6:12]) for file in pictures]) / _RATE_HZ
        known = params.given_camera(lambda: frame_size(files[0], chosen[0]))
        if is_depth and known.camera is None:
            known = KnownCamera(_DEPTH_CAMERA, "the publisher")
        truth = None
        if params.ground_truth:
            with workaround(ground_truth=False):
                truth = Trajectory(times_s, np.array([_pose(file, params.stream) for file in pictures]))
        pose_notes = () if is_depth or truth is None else (_POSES_NOTE,)
        content = Content(
            name=f"{folder.resolve().parent.name}_{folder.resolve().name}" + ("_depth" if is_depth else ""),
            where=str(folder),
            files=files,
            numbers=chosen,
            timestamps_s=times_s[np.array(chosen)],
            frame_rate_hz=_RATE_HZ / params.stride,
            camera=known.camera,
            ground_truth=truth,
            depth=_DEPTH if is_depth else None,
            color=params.color,
            notes=(*params.subset_notes(len(pictures)), *known.notes, *pose_notes),
            origin=Origin(f"7-Scenes, {params.stream}", known.source),
        )
        return params.as_asked(FileSequence(content))


def _pose(picture: Path, stream: str) -> Floats:
    """The pose (4, 4) beside a picture: world from camera, in meters."""
    file = picture.with_name(picture.name.replace(f".{stream}.png", ".pose.txt"))
    rows = read_rows(file, "the pose of a frame", 4, exact=True)
    if len(rows) != 4:
        raise DatasetError(f"{file}: {len(rows)} rows; a pose has 4")
    return orthonormalize(np.array([row.numbers() for row in rows]), str(file))
