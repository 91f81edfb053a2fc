"""Cameras from calibration files and published calibrations."""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.contracts.sequence import Camera, CameraModel, Depth
from codecbench.plugins.datasets.tables import read_text, transforms_from_quaternions

FREIBURG = {
    "freiburg1": Camera(640, 480, 517.3, 516.5, 318.6, 255.3, (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)),
    "freiburg2": Camera(640, 480, 520.9, 521.0, 325.1, 249.7, (0.2312, -0.7849, -0.0033, -0.0001, 0.9172)),
    "freiburg3": Camera(640, 480, 535.4, 539.2, 320.1, 247.6),
}
"""The color cameras of the TUM RGB-D benchmark, from its page on file formats."""

_MOST_SHOWN = 60
_INTRINSICS = ("width", "height", "fx", "fy", "cx", "cy")
_DISTORTION: dict[Any, tuple[str, ...]] = {
    "pinhole": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    "equidistant": ("k1", "k2", "k3", "k4"),
}
"""Names of each model's coefficients, in the order of `Camera.distortion`."""


class YamlFile:
    """The mapping in a YAML file; errors name the line of an entry."""

    def __init__(self, file: Path, what: str, remedy: str = "") -> None:
        self.file = file
        text = read_text(file, what, remedy)
        text = text.removeprefix("\ufeff")
        if text.startswith("%YAML:"):
            text = text.replace("%YAML:", "# YAML ", 1)
        try:
            self._entries: Any = YAML(typ="rt").load(text)
        except MarkedYAMLError as error:
            line = error.problem_mark.line if error.problem_mark else 0
            content = "".join(text.splitlines()[line : line + 1]).strip()
            problem = f"{what} is not YAML: {error.problem} in {content[:_MOST_SHOWN]!r}"
            raise DatasetError(f"{file}:{line + 1}: {problem}") from error
        if not isinstance(self._entries, dict):
            raise DatasetError(f"{file}: {what} has no `key: value` lines")

    def where(self, key: str) -> str:
        return f"{self.file}:{self._entries.lc.value(key)[0] + 1}" if key in self._entries else str(self.file)

    def get(self, key: str, default: Any = None) -> Any:
        return self._entries.get(key, default)

    def section(self, key: str) -> Self | None:
        """The mapping below a key; None if there is none. Raises DatasetError if it is no mapping."""
        entries = self.get(key)
        if entries is None:
            return None
        if not isinstance(entries, dict):
            raise DatasetError(f"{self.where(key)}: `{key}` has no `key: value` lines below it")
        section = copy(self)
        section._entries = entries
        return section

    def number(self, key: str, default: float | None = None) -> float:
        """A finite number. Raises DatasetError if it is no number, or is missing without a default."""
        value = self.get(key, default)
        if value is None:
            raise DatasetError(f"{self.file}: `{key}` is missing")
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise DatasetError(f"{self.where(key)}: `{key}` is {value!r}, which is not a finite number")
        return float(value)

    def numbers(self, key: str, counts: tuple[int, ...]) -> list[float]:
        """A list of finite numbers; its length is one of `counts`. Raises DatasetError."""
        return finite_numbers(self.get(key), counts, self.where(key), key)


def finite_numbers(value: Any, counts: tuple[int, ...], where: str, key: str) -> list[float]:
    """Check that `value` is a list of finite numbers with one of the lengths `counts`. Raises DatasetError."""
    is_list_of_numbers = isinstance(value, list) and all(
        isinstance(number, int | float) and not isinstance(number, bool) and math.isfinite(number) for number in value
    )
    if not is_list_of_numbers or len(value) not in counts:
        lengths = " or ".join(str(count) for count in counts)
        raise DatasetError(f"{where}: `{key}` is {value!r}, not a list of {lengths} numbers")
    return [float(number) for number in value]


def camera_from_model(
    model: str, size: tuple[int, int], intrinsics: tuple[float, float, float, float], coefficients: Sequence[float]
) -> Camera:
    """Make a camera of `model` `pinhole` or `equidistant`; omitted coefficients are 0."""
    padded = (*coefficients, *[0.0] * (8 - len(coefficients)))
    camera_model: CameraModel = "equidistant" if model == "equidistant" else "pinhole"
    return Camera(*size, *intrinsics, distortion=padded if any(padded[5:]) else padded[:5], model=camera_model)


def describe_lens(camera: Camera) -> str:
    """The usual name of a camera's lens distortion."""
    if camera.model == "equidistant":
        return "equidistant fisheye (Kannala-Brandt)"
    if any(camera.distortion[5:]):
        return "rational distortion (k1 to k6)"
    return "Brown-Conrady distortion" if any(camera.distortion) else "no distortion"


def camera_from_view(width: int, height: int, fov_deg: float) -> Camera:
    """An ideal pinhole camera with a horizontal field of view; the principal point is the frame's center."""
    focal = width / 2 / math.tan(math.radians(fov_deg) / 2)
    return Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)


def miscalibrate(camera: Camera, error: float) -> Camera:
    """Perturb a camera's calibration: k1 by +`error`, the focal length by half of it relatively."""
    k1, *others = camera.distortion
    focal = 1.0 + error / 2
    return replace(camera, fx=focal * camera.fx, fy=focal * camera.fy, distortion=(k1 + error, *others))


def camera_from_file(file: Path) -> tuple[Camera, float | None]:
    """Read a camera, and the frame rate if the file has `fps`. Raises DatasetError with file and line.

    Keys: width, height, fx, fy, cx, cy in pixels; `model`, `pinhole` (default) or `equidistant`; the coefficients.
    A pinhole camera has k1, k2, p1, p2, k3 (a rational lens also k4, k5, k6), a fisheye k1, k2, k3, k4. Omitted
    coefficients are 0.
    """
    entries = YamlFile(file, "calibration")
    camera = _camera(entries)
    if "fps" not in entries._entries:
        return camera, None
    if entries.number("fps") <= 0.0:
        raise DatasetError(f"{entries.where('fps')}: `fps` is {entries.get('fps')}, which is not above 0")
    return camera, entries.number("fps")


@dataclass(frozen=True)
class DepthCamera:
    """The depth camera beside a color camera."""

    camera: Camera
    depth: Depth
    color_from_depth: NDArray[np.float64]
    """(4, 4) rigid transform, in meters."""


def depth_camera_from_file(file: Path) -> DepthCamera | None:
    """Read the section `depth` of a calibration file; None if it has none. Raises DatasetError with file and line.

    Keys: those of the camera; steps_per_m, the steps of a meter; `unknown`, the value of unknown distances, by default
    0; color_from_depth, a list of tx ty tz in meters and a unit quaternion qx qy qz qw, by default the identity.
    """
    entries = YamlFile(file, "calibration").section("depth")
    if entries is None:
        return None
    steps, unknown = entries.number("steps_per_m"), entries.number("unknown", 0.0)
    if steps < 1.0:
        raise DatasetError(f"{entries.where('steps_per_m')}: `steps_per_m` is {steps:g}, which is below 1")
    if unknown not in range(1 << 16):
        raise DatasetError(f"{entries.where('unknown')}: `unknown` is {unknown:g}, which is not within 0..65535")
    pose = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]])
    if entries.get("color_from_depth") is not None:
        pose[0] = entries.numbers("color_from_depth", (7,))
    (transform,) = transforms_from_quaternions(pose, lambda _: entries.where("color_from_depth"))
    return DepthCamera(_camera(entries), Depth(1.0 / steps, int(unknown)), transform)


def _camera(entries: YamlFile) -> Camera:
    model = entries.get("model", "pinhole")
    if not isinstance(model, str) or model not in _DISTORTION:
        models = " and ".join(f"`{name}`" for name in _DISTORTION)
        raise DatasetError(f"{entries.where('model')}: `model` is {model!r}; supported: {models}")
    for key in _INTRINSICS[:4]:
        if entries.number(key) <= 0.0:
            raise DatasetError(f"{entries.where(key)}: `{key}` is {entries.get(key)}, which is not above 0")
    coefficients = [entries.number(key, 0.0) for key in _DISTORTION[model]]
    width, height, fx, fy, cx, cy = (entries.number(key) for key in _INTRINSICS)
    return camera_from_model(model, (round(width), round(height)), (fx, fy, cx, cy), coefficients)
