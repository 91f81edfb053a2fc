"""The dataset `kitti`: the odometry benchmark of KITTI."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.contracts.sequence import Camera, Dataset, FrameSequence, Origin, Trajectory
from codecbench.plugins.datasets.files import Content, FileSequence, frame_size
from codecbench.plugins.datasets.selection import FolderSelection, KnownCamera, RecordedCameraParams, workaround
from codecbench.plugins.datasets.tables import increasing_times, orthonormalize, rate_hz, read_rows

Floats = NDArray[np.float64]
_Camera = Literal["image_0", "image_1", "image_2", "image_3"]
_CAMERA_0_POSES_NOTE = "without calibration the poses of camera 0 are used as this camera's"


class KittiParams(FolderSelection, RecordedCameraParams):
    """Set the number, camera and ground truth of a KITTI odometry sequence."""

    sequence: Annotated[str, Field(pattern=r"^[0-9]{2}$", description="number of two digits, as text: '00'")] = "00"
    camera: Annotated[
        _Camera,
        Field(description="image_0 and image_1 are gray, image_2 and image_3 color; even ones are the left ones"),
    ] = "image_0"
    ground_truth: Annotated[bool, Field(description="false for sequences 11 to 21, which have no public poses")] = True


class Kitti(Dataset[KittiParams]):
    """Rectified frames of one camera, with the poses of that camera.

    Source: Geiger, Lenz and Urtasun, "Are we ready for autonomous driving?", CVPR 2012, and the development
    kit's readme. The poses are those of camera 0; the projection matrix moves them to the camera in use.
    """

    name: ClassVar[str] = "kitti"
    version: ClassVar[str] = "1"
    params_type = KittiParams

    @classmethod
    def recognise(cls, path: Path) -> dict[str, Any] | None:
        """Recognize one sequence's folder, or the folder of sequences/ and poses/, whose first sequence is taken."""
        resolved = path.resolve()
        if (path / "times.txt").is_file() and resolved.parent.name == "sequences":
            root, folders = resolved.parent.parent, [resolved]
        else:
            root = path / "dataset" if (path / "dataset").is_dir() else path
            folders = sorted(root.glob("sequences/[0-9][0-9]"))
        cameras = [name for name in get_args(_Camera) if folders and (folders[0] / name).is_dir()]
        if not cameras:
            return None
        sequence = folders[0].name
        params = {"path": str(root), "sequence": sequence, "camera": cameras[0]}
        return params if (root / "poses" / f"{sequence}.txt").is_file() else {**params, "ground_truth": False}

    def open(self) -> FrameSequence:
        params = self.params
        root = params.folder("sequences/ and poses/")
        if (root / "dataset").is_dir():
            root = root / "dataset"  # the publisher's archives hold this folder
        folder = root / "sequences" / params.sequence
        if not folder.is_dir():
            raise DatasetError(f"{folder}: is not a folder; set `path` to the one that contains sequences/ and poses/")
        rows = read_rows(folder / "times.txt", "the list of times", 1)
        times_s = increasing_times([row.number(0) for row in rows], rows)
        chosen = params.indices(len(rows), str(folder / "times.txt"))
        files = tuple(folder / params.camera / f"{index:06d}.png" for index in chosen)
        with workaround(calibration="none"):
            known, projection = _camera(params, folder, lambda: frame_size(files[0], chosen[0]))
        truth = None
        if params.ground_truth:
            with workaround(ground_truth=False):
                truth = _trajectory(root / "poses" / f"{params.sequence}.txt", times_s, projection)
        pose_notes = () if truth is None or projection is not None else (_CAMERA_0_POSES_NOTE,)
        content = Content(
            name=f"kitti_{params.sequence}",
            where=str(folder),
            files=files,
            numbers=chosen,
            timestamps_s=times_s[np.array(chosen)],
            frame_rate_hz=rate_hz(times_s, 10.0) / params.stride,
            camera=known.camera,
            ground_truth=truth,
            color=params.color,
            notes=(*params.subset_notes(len(rows)), *known.notes, *pose_notes),
            origin=Origin(f"KITTI odometry, sequence {params.sequence}, {params.camera}", known.source),
        )
        return params.as_asked(FileSequence(content))


def read_projection(file: Path, name: str) -> Floats:
    """Read the projection matrix (3, 4) in the row `name:` of a calibration file. Raises DatasetError."""
    for row in read_rows(file, "calibration", 1, remedy="set `fov_deg` for an ideal camera"):
        if row.fields[0] == f"{name}:":
            numbers = row.numbers(1)
            if len(numbers) != 12:
                raise DatasetError(f"{row.where}: {name} has {len(numbers)} numbers; a projection matrix has 12")
            matrix = np.array(numbers).reshape(3, 4)
            if matrix[0, 0] <= 0.0 or matrix[1, 1] <= 0.0 or not np.array_equal(matrix[2, :3], [0.0, 0.0, 1.0]):
                raise DatasetError(f"{row.where}: {name} is not the matrix of a rectified camera")
            return matrix
    raise DatasetError(f"{file}: calibration has no row `{name}:`")


def _camera(
    params: KittiParams, folder: Path, size: Callable[[], tuple[int, int]]
) -> tuple[KnownCamera, Floats | None]:
    """The camera and its projection matrix, None if `calibration` is `none` or `fov_deg` replaces a missing file.

    size: KITTI's files do not give the frames' size, so it is read from the first frame.
    """
    file = folder / "calib.txt"
    if params.calibration == "none" or (params.fov_deg is not None and not file.exists()):
        return params.or_ideal_camera(KnownCamera(), size), None
    projection = read_projection(file, f"P{params.camera[-1]}")
    fx, fy, cx, cy = (float(projection[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return params.or_ideal_camera(KnownCamera(Camera(*size(), fx, fy, cx, cy), file.name), size), projection


def _trajectory(file: Path, times_s: Floats, projection: Floats | None) -> Trajectory:
    """Read camera 0's poses, one line of 12 numbers per frame; `projection` moves them to its camera."""
    rows = read_rows(file, "ground truth", 12, exact=True)
    if len(rows) != len(times_s):
        raise DatasetError(f"{file}: {len(rows)} poses, but {len(times_s)} times; both need one row per frame")
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    for index, row in enumerate(rows):
        poses[index, :3] = np.array(row.numbers()).reshape(3, 4)
        poses[index] = orthonormalize(poses[index], row.where)
    if projection is None:
        return Trajectory(times_s, poses)
    zero_from_camera = np.eye(4)
    zero_from_camera[:3, 3] = -np.linalg.solve(projection[:, :3], projection[:, 3])
    return Trajectory(times_s, poses @ zero_from_camera)
