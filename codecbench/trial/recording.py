"""Recognition of a recording: which installed dataset opens a path, and what it is."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from PIL import ExifTags, Image, UnidentifiedImageError

from codecbench.core.contracts.errors import CodecbenchError, DatasetError, ParamsError
from codecbench.core.contracts.image import Layout
from codecbench.core.engine.planning.description import InvalidParams, describe
from codecbench.core.engine.planning.schema import plugin_schema
from codecbench.core.engine.plugins.registry import Registry
from codecbench.core.engine.text import clean_line, counted
from codecbench.plugins.datasets.files import EXTENSIONS

_MOST_SIZES: Final = 3
_MOST_LEFT_OUT: Final = 20
"""How often a recording is opened again with something left out."""
MOST_LISTED: Final = 3
"""How many left-out items are listed one by one."""
_HEAD_BYTES: Final = 4096


@dataclass(frozen=True)
class Recording:
    """A recording that a dataset recognized and opened."""

    dataset: str
    """Name of the dataset that opens it, with `params`."""
    kind: str
    """What it is, in its user's words."""
    params: dict[str, Any]
    name: str
    frames: int
    channels: int
    width: int
    """Width of the first frame in pixels, as `height`."""
    height: int
    has_camera: bool
    has_ground_truth: bool
    bits: int = 8
    """Bits of a sample."""
    depth_unit_m: float | None = None
    """Meters of a step if its pixels are distances."""
    sizes: tuple[tuple[int, int], ...] = ()
    """Each frame size once, if frames differ."""
    camera_from: str = ""
    """Source of the camera's calibration, if known."""
    suited: dict[str, Any] = field(default_factory=dict)
    """Parameters that suit the recording better than those in `params`."""
    settable: frozenset[str] = frozenset()
    """Names of all parameters of the dataset."""
    notes: tuple[str, ...] = ()
    """Notes of the dataset."""
    assumed: tuple[str, ...] = ()
    """Assumptions that the user did not state, and what is wrong and left out."""

    def __str__(self) -> str:
        """`ROS 2 bag, topic /camera/image_raw, 1,204 frames, 640x480, color, camera_info found, no ground truth`."""
        known = f"camera from {self.camera_from}" if self.camera_from else "camera known"
        return ", ".join((
            self.kind,
            counted(self.frames, "frame"),
            self._size,
            str(Layout(self.channels, self.bits)) if self.depth_unit_m is None
            else f"depth in steps of {1e3 * self.depth_unit_m:.3g} mm",
            known if self.has_camera else "no calibration",
            "ground truth" if self.has_ground_truth else "no ground truth",
        ))  # fmt: skip

    @property
    def _size(self) -> str:
        sizes = [f"{width}x{height}" for width, height in self.sizes]
        if not sizes:
            return f"{self.width}x{self.height}"
        if len(sizes) <= _MOST_SIZES:
            return f"frames of {', '.join(sizes[:-1])} and {sizes[-1]}"
        return f"frames of {len(sizes)} sizes from {sizes[0]} to {sizes[-1]}"


def recognize(registry: Registry, path: Path, given: dict[str, Any]) -> Recording:
    """Open the recording at `path` with the first dataset that recognizes it, catch-alls last.

    given: parameters that the user adds. Faulty parts are left out if the rest can be opened without them; `assumed`
    lists them. Raises DatasetError if no dataset recognizes it or it cannot be opened, and ParamsError for a parameter
    that the dataset does not have.
    """
    if not path.exists():
        raise DatasetError(f"{path}: no such file or folder")
    matches = [(plugin, answer) for plugin in registry.plugins("dataset") if plugin.missing is None
             if (answer := _ask_recognition(registry, plugin.spec.name, path)) is not None]  # fmt: skip
    if not matches:
        names = ", ".join(plugin.spec.name for plugin in registry.plugins("dataset"))
        unusable = [str(plugin.missing) for plugin in registry.plugins("dataset") if plugin.missing is not None]
        hint = f"; not tried: {'; '.join(unusable)}" if unusable else ""
        raise DatasetError(
            f"{path}: {describe_contents(path)}, which no dataset recognizes ({names}); give a folder of images "
            f"({', '.join(EXTENSIONS)}), a video, a TUM, KITTI or EuRoC folder, a ROS bag, or a LeRobot dataset{hint}"
        )
    plugin, (_, params) = min(matches, key=lambda pair: pair[1][0])
    params = {**params, **given}
    name = plugin.spec.name
    _check_params(registry, name, params)
    settable = frozenset(plugin_schema(registry, f"dataset:{name}").get("properties", {}))
    left_out: list[str] = []
    while True:
        try:
            facts = registry.ask(facts_of, name, params, of=[("dataset", name)], times=10)
            break
        except DatasetError as error:
            refused = [key for key in error.without if key in given and key != "skip"]
            if not error.without or refused or len(left_out) == _MOST_LEFT_OUT:
                lines = [f"{error}{_option_hint(str(error), settable)}", *left_out[:MOST_LISTED]]
                raise DatasetError("\n".join(lines)) from error
            params = params_without(params, error.without)
            left_out.append(describe_left_out(error))
    facts |= {"notes": tuple(facts["notes"]), "sizes": tuple((width, height) for width, height in facts["sizes"])}
    kind = facts.pop("kind") or f"{name} ({clean_line(plugin.spec.summary)})"
    return Recording(name, kind, params, settable=settable, assumed=tuple(left_out), **facts)


def params_without(params: dict[str, Any], without: dict[str, Any]) -> dict[str, Any]:
    """Return parameters of a dataset that also leave out what an error names."""
    skip = sorted({*params.get("skip", []), *without.get("skip", [])})
    return {**params, **without, **({"skip": skip} if skip else {})}


def describe_left_out(error: DatasetError) -> str:
    """Describe what is wrong, and which parameters leave it out."""
    return f"{error.what}; left out ({error.settings})"


def unreadable_frames(registry: Registry, name: str, params: dict[str, Any], frames: int) -> list[list[Any]]:
    """Read the first frames; return the error of each that `skip` can leave out, and the parameters for that."""
    sequence, faults = registry.create("dataset", name, params).open(), []
    for index in range(min(frames, len(sequence))):
        try:
            sequence.read(index)
        except DatasetError as error:
            if "skip" in error.without:
                faults.append([error.what, error.without])
    return faults


def describe_contents(path: Path) -> str:
    """Describe a path that is no recording, such as `contains no images but 3 files such as a.txt`."""
    if path.suffix.lower() in EXTENSIONS:
        return "is a single image"
    try:
        if path.is_dir():
            return _describe_folder(sorted(path.iterdir()))
        with open(path, "rb") as stream:
            head = stream.read(_HEAD_BYTES)
    except OSError as error:
        return f"cannot be read ({error.strerror})"
    if not head:
        return "is an empty file"
    return "is text" if b"\0" not in head and _is_text(head) else "is a file of another kind"


def _describe_folder(entries: list[Path]) -> str:
    if not entries:
        return "is an empty folder"
    for folder in filter(Path.is_dir, entries):
        if any(file.suffix.lower() in EXTENSIONS for file in folder.iterdir()):
            return f"contains no images, but its folder {folder.name} does"
    files = [entry.name for entry in entries if entry.is_file()]
    what = f"{counted(len(files), 'file')} such as {files[0]}" if files else counted(len(entries), "folder")
    return f"contains no images but {what}"


def _is_text(head: bytes) -> bool:
    try:
        head.decode()
    except UnicodeDecodeError as error:
        return error.end == len(head) == _HEAD_BYTES  # cut in the middle of a character
    return True


def facts_of(registry: Registry, name: str, params: dict[str, Any]) -> dict[str, Any]:
    """Return the facts of a sequence for `Recording` as JSON types. Reads the first frame only. Raises DatasetError."""
    sequence = registry.create("dataset", name, params).open()
    height, width = sequence.read(0).image.shape[:2]
    origin = sequence.origin
    return {
        "name": clean_line(str(sequence.name)),
        "frames": len(sequence),
        "channels": int(sequence.channels),
        "bits": int(sequence.bits),
        "depth_unit_m": None if sequence.depth is None else float(sequence.depth.unit_m),
        "width": int(width),
        "height": int(height),
        "has_camera": sequence.camera is not None,
        "has_ground_truth": sequence.ground_truth is not None,
        "kind": clean_line(origin.kind),
        "sizes": [list(size) for size in origin.sizes],
        "camera_from": clean_line(origin.camera),
        "suited": dict(origin.params),
        "notes": [clean_line(str(note)) for note in sequence.notes],
    }


def recognition(registry: Registry, name: str, path: str) -> tuple[bool, dict[str, Any]] | None:
    """Return whether a dataset is a catch-all and the parameters by which it opens `path`; None if it cannot."""
    cls = registry.load("dataset", name)
    params = cls.recognise(Path(path))
    return None if params is None else (bool(cls.catch_all), dict(params))


def _option_hint(message: str, settable: frozenset[str]) -> str:
    """Return how to give the parameters that an error names on the command line; empty if it names none."""
    names = [name for name in dict.fromkeys(re.findall(r"`(\w+)[`:]", message)) if name in settable and name != "path"]
    options = ["--fov DEGREES" if name == "fov_deg" else f"--set {name}=VALUE" for name in names]
    return f"\nwith `codecbench try` and `init --from`: {', '.join(options)}" if options else ""


def _check_params(registry: Registry, dataset: str, params: dict[str, Any]) -> None:
    """Raise ParamsError for parameters that the dataset does not have."""
    try:
        describe(registry, "dataset", dataset, params)
    except InvalidParams as invalid:
        raise ParamsError(f"dataset {dataset}: {invalid.sentence}") from None


def _ask_recognition(registry: Registry, name: str, path: Path) -> tuple[bool, dict[str, Any]] | None:
    """Ask for the `recognition` of a path. A dataset that fails does not recognize it."""
    try:
        answer = registry.ask(recognition, name, str(path.absolute()), of=[("dataset", name)])
    except (CodecbenchError, OSError):
        return None
    return None if answer is None else (bool(answer[0]), dict(answer[1]))


_FILM_WIDTH_MM = 36.0


def fov_from_exif(path: Path) -> float | None:
    """Return the horizontal field of view in degrees from the first image of a folder with a focal length in EXIF.

    EXIF gives the equivalent focal length for film of 36 mm width. Returns None if no image has it.
    """
    if not path.is_dir():
        return None
    for file in sorted(path.iterdir())[:3]:
        try:
            with Image.open(file) as picture:
                focal_length_mm = picture.getexif().get_ifd(ExifTags.IFD.Exif).get(ExifTags.Base.FocalLengthIn35mmFilm)
        except (OSError, UnidentifiedImageError, ValueError, SyntaxError, Image.DecompressionBombError):
            continue
        if isinstance(focal_length_mm, int) and 5 <= focal_length_mm <= 2000:
            return round(math.degrees(2 * math.atan(_FILM_WIDTH_MM / 2 / focal_length_mm)), 1)
    return None
