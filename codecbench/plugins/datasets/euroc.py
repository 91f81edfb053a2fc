"""The dataset `euroc`: the ASL layout of the EuRoC micro aerial vehicle sequences."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.contracts.sequence import Camera, Dataset, FrameSequence, Origin, Trajectory
from codecbench.plugins.datasets.calibration import YamlFile, camera_from_model, finite_numbers
from codecbench.plugins.datasets.files import Content, FileSequence, frame_size
from codecbench.plugins.datasets.selection import FolderSelection, KnownCamera, RecordedCameraParams, workaround
from codecbench.plugins.datasets.tables import increasing_times, orthonormalize, read_rows, trajectory_from_quaternions

Floats = NDArray[np.float64]
_USUAL_RATE_HZ = 20.0
_SENSOR_POSES_NOTE = "without calibration the poses of the vehicle's sensor are used as the camera's"


class EurocParams(FolderSelection, RecordedCameraParams):
    """Set the camera and the ground truth of a EuRoC MAV sequence."""

    camera: Annotated[Literal["cam0", "cam1"], Field(description="cam0 is the left one")] = "cam0"
    ground_truth: Annotated[bool, Field(description="false for a sequence without state_groundtruth_estimate0")] = True


class Euroc(Dataset[EurocParams]):
    """Frames of one camera of the vehicle; the camera's poses are computed from those of the body.

    Source: Burri et al., "The EuRoC micro aerial vehicle datasets", IJRR 35(10), 2016. Times in ns become
    seconds; `T_BS` of the camera is body_from_camera, that of the ground truth body_from_sensor.
    """

    name: ClassVar[str] = "euroc"
    version: ClassVar[str] = "1"
    params_type = EurocParams

    @classmethod
    def recognise(cls, path: Path) -> dict[str, Any] | None:
        """Recognize the folder that holds mav0/, or mav0/ itself."""
        root = path.resolve().parent if path.resolve().name == "mav0" else path
        cameras = [name for name in ("cam0", "cam1") if (root / "mav0" / name / "data.csv").is_file()]
        if not cameras:
            return None
        params = {"path": str(root), "camera": cameras[0]}
        truth = root / "mav0" / "state_groundtruth_estimate0" / "data.csv"
        return params if truth.is_file() else {**params, "ground_truth": False}

    def open(self) -> FrameSequence:
        params = self.params
        root = params.folder("mav0/")
        folder = root / "mav0" / params.camera
        if not folder.is_dir():
            raise DatasetError(f"{folder}: is not a folder; set `path` to the one that contains mav0/")
        rows = read_rows(folder / "data.csv", "the list of frames", 2, ",")
        times_s = increasing_times([row.seconds_from_ns(0) for row in rows], rows)
        chosen = params.indices(len(rows), str(folder / "data.csv"))
        files = tuple(folder / "data" / rows[index].fields[1] for index in chosen)
        with workaround(calibration="none"):
            sensor = _sensor(params, folder / "sensor.yaml")
            recorded = KnownCamera() if sensor is None else KnownCamera(_camera(sensor), sensor.file.name)
            rate_hz = _rate_hz(sensor)
        known = params.or_ideal_camera(recorded, lambda: frame_size(files[0], chosen[0]))
        truth = None
        if params.ground_truth:
            with workaround(ground_truth=False):
                truth = _trajectory(root / "mav0", sensor)
        notes = known.notes if sensor or not params.ground_truth else (*known.notes, _SENSOR_POSES_NOTE)
        content = Content(
            name=root.resolve().name,
            where=str(folder),
            files=files,
            numbers=chosen,
            timestamps_s=times_s[np.array(chosen)],
            frame_rate_hz=rate_hz / params.stride,
            camera=known.camera,
            uncalibrated={"calibration": "none"},
            ground_truth=truth,
            color=params.color,
            notes=(*params.subset_notes(len(rows)), *notes),
            origin=Origin(f"EuRoC MAV folder, {params.camera}", known.source),
        )
        return params.as_asked(FileSequence(content))


def _sensor(params: EurocParams, file: Path) -> YamlFile | None:
    """Read the camera's sensor.yaml; None if it is not wanted, or missing and not needed. Raises DatasetError."""
    if params.calibration == "none" or (params.fov_deg is not None and not file.exists()):
        return None
    return YamlFile(file, "calibration", "set `fov_deg` for an ideal camera")


def _rate_hz(sensor: YamlFile | None) -> float:
    """The frame rate. Raises DatasetError if it is not positive."""
    if sensor is None:
        return _USUAL_RATE_HZ
    rate_hz = sensor.number("rate_hz", _USUAL_RATE_HZ)
    if rate_hz <= 0.0:
        raise DatasetError(f"{sensor.where('rate_hz')}: `rate_hz` is {rate_hz}, which is not above 0")
    return rate_hz


def _camera(sensor: YamlFile) -> Camera:
    """The camera that sensor.yaml describes. Raises DatasetError if its model is unknown."""
    if sensor.get("camera_model", "pinhole") != "pinhole":
        model = sensor.get("camera_model")
        raise DatasetError(f"{sensor.where('camera_model')}: `camera_model` is {model!r}; only `pinhole` is supported")
    model = sensor.get("distortion_model", "radial-tangential")
    if model not in ("radial-tangential", "equidistant"):
        raise DatasetError(
            f"{sensor.where('distortion_model')}: `distortion_model` is {model!r}; "
            "supported: `radial-tangential` and `equidistant`"
        )
    width, height = sensor.numbers("resolution", (2,))
    fx, fy, cx, cy = sensor.numbers("intrinsics", (4,))
    for key, values in (("resolution", (width, height)), ("intrinsics", (fx, fy))):
        if min(values) <= 0.0:
            raise DatasetError(f"{sensor.where(key)}: `{key}` contains a number that is not above 0")
    counts = (4,) if model == "equidistant" else (4, 5)
    coefficients = sensor.numbers("distortion_coefficients", counts)
    return camera_from_model(model, (round(width), round(height)), (fx, fy, cx, cy), coefficients)


def _mounting(sensor: YamlFile) -> Floats:
    """body_from_sensor (4, 4) of a sensor.yaml. Raises DatasetError."""
    entry: Any = sensor.get("T_BS")
    values = entry.get("data") if isinstance(entry, dict) else None
    matrix = np.array(finite_numbers(values, (16,), sensor.where("T_BS"), "T_BS.data")).reshape(4, 4)
    return orthonormalize(matrix, sensor.where("T_BS"))


def _trajectory(mav: Path, camera: YamlFile | None) -> Trajectory:
    """The trajectory of `camera`; without one, that of the body's sensor. Raises DatasetError."""
    folder = mav / "state_groundtruth_estimate0"
    rows = read_rows(folder / "data.csv", "ground truth", 8, ",")
    times_s = increasing_times([row.seconds_from_ns(0) for row in rows], rows)
    poses = np.array([[row.number(column) for column in range(1, 8)] for row in rows])
    sensor = trajectory_from_quaternions(times_s, poses, "wxyz", rows)
    if camera is None:
        return sensor
    sensor_file = folder / "sensor.yaml"
    body_from_sensor = _mounting(YamlFile(sensor_file, "mounting")) if sensor_file.is_file() else np.eye(4)
    sensor_from_camera = np.linalg.inv(body_from_sensor) @ _mounting(camera)
    return Trajectory(times_s, sensor.world_from_camera @ sensor_from_camera)
