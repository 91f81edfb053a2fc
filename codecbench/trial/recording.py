"""What a path holds: asked of every dataset that is installed."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from codecbench.core.contracts.errors import CodecbenchError, DatasetError, ParamsError
from codecbench.core.engine.planning.description import InvalidParams, describe
from codecbench.core.engine.planning.schema import plugin_schema
from codecbench.core.engine.plugins.registry import Registry
from codecbench.core.engine.text import clean_line, counted
from codecbench.plugins.datasets.files import EXTENSIONS

_MOST_SIZES: Final = 3
_MOST_LEFT_OUT: Final = 20
"""How often a recording is opened to find what of it has to be left out."""
MOST_SAID: Final = 3
"""What is left out and said one by one."""
_HEAD_BYTES: Final = 4096


@dataclass(frozen=True)
class Recording:
    """A recording that a dataset recognised and opened.

    dataset, params: what opens it. kind: what it is, in its user's words. width, height: of its first frame in pixels;
    sizes: where frames differ, each once. camera_from: what the camera was taken from, as far as that is known. suited:
    parameters that suit it better than those by which it was opened. settable: all that its dataset takes. notes: what
    its dataset says of it. assumed: what nobody said and was taken for granted, and what is wrong and left out.
    """

    dataset: str
    kind: str
    params: dict[str, Any]
    name: str
    frames: int
    channels: int
    width: int
    height: int
    has_camera: bool
    has_ground_truth: bool
    sizes: tuple[tuple[int, int], ...] = ()
    camera_from: str = ""
    suited: dict[str, Any] = field(default_factory=dict)
    settable: frozenset[str] = frozenset()
    notes: tuple[str, ...] = ()
    assumed: tuple[str, ...] = ()

    def __str__(self) -> str:
        """`ROS 2 bag, topic /camera/image_raw, 1,204 frames, 640x480, colour, camera_info found, no ground truth`."""
        known = f"camera from {self.camera_from}" if self.camera_from else "camera known"
        return ", ".join((
            self.kind,
            counted(self.frames, "frame"),
            self._size,
            "gray" if self.channels == 1 else "colour",
            known if self.has_camera else "no calibration",
            "ground truth" if self.has_ground_truth else "no ground truth",
        ))  # fmt: skip

    @property
    def _size(self) -> str:
        sizes = [f"{width}x{height}" for width, height in self.sizes]
        if not sizes:
            return f"{self.width}x{self.height}"
        if len(sizes) <= _MOST_SIZES:
            return f"pictures of {', '.join(sizes[:-1])} and {sizes[-1]}"
        return f"pictures of {len(sizes)} sizes from {sizes[0]} to {sizes[-1]}"


def recognised(registry: Registry, path: Path, given: dict[str, Any]) -> Recording:
    """The recording at `path`, opened by the first dataset that knows it, catch-alls last.

    given: parameters that its user adds. What is wrong costs itself where the rest can be opened without it, which
    `assumed` says. Raises DatasetError where nobody knows it and where it cannot be opened, and
    ParamsError for a parameter that the dataset does not have.
    """
    if not path.exists():
        raise DatasetError(f"{path}: there is no such file or folder")
    found = [(plugin, answer) for plugin in registry.plugins("dataset") if plugin.missing is None
             if (answer := _answer(registry, plugin.spec.name, path)) is not None]  # fmt: skip
    if not found:
        names = ", ".join(plugin.spec.name for plugin in registry.plugins("dataset"))
        unusable = [str(plugin.missing) for plugin in registry.plugins("dataset") if plugin.missing is not None]
        hint = f"; not asked: {'; '.join(unusable)}" if unusable else ""
        raise DatasetError(
            f"{path}: {contents(path)}, which no dataset recognises ({names}); name a folder of pictures "
            f"({', '.join(EXTENSIONS)}), a video, a TUM, KITTI or EuRoC folder, or a ROS bag{hint}"
        )
    plugin, (_, params) = min(found, key=lambda pair: pair[1][0])
    params = {**params, **given}
    name = plugin.spec.name
    _check_params(registry, name, params)
    settable = frozenset(plugin_schema(registry, f"dataset:{name}").get("properties", {}))
    left_out: list[str] = []
    while True:
        try:
            facts = registry.ask(opened, name, params, of=[("dataset", name)], times=10)
            break
        except DatasetError as error:
            refused = [key for key in error.without if key in given and key != "skip"]
            if not error.without or refused or len(left_out) == _MOST_LEFT_OUT:
                said = [f"{error}{_how_to_set(str(error), settable)}", *left_out[:MOST_SAID]]
                raise DatasetError("\n".join(said)) from error
            params = less(params, error.without)
            left_out.append(said_of(error))
    facts |= {"notes": tuple(facts["notes"]), "sizes": tuple((width, height) for width, height in facts["sizes"])}
    kind = facts.pop("kind") or f"{name} ({clean_line(plugin.spec.summary)})"
    return Recording(name, kind, params, settable=settable, assumed=tuple(left_out), **facts)


def less(params: dict[str, Any], without: dict[str, Any]) -> dict[str, Any]:
    """Parameters of a dataset that also leave out what an error says."""
    skip = sorted({*params.get("skip", []), *without.get("skip", [])})
    return {**params, **without, **({"skip": skip} if skip else {})}


def said_of(error: DatasetError) -> str:
    """What is wrong, and by which parameters it is left out."""
    return f"{error.what}; left out ({error.settings})"


def unreadable(registry: Registry, name: str, params: dict[str, Any], frames: int) -> list[list[Any]]:
    """What is wrong with those of the first frames that `skip` can leave out, and that; all of them are read."""
    sequence, found = registry.create("dataset", name, params).open(), []
    for index in range(min(frames, len(sequence))):
        try:
            sequence.read(index)
        except DatasetError as error:
            if "skip" in error.without:
                found.append([error.what, error.without])
    return found


def contents(path: Path) -> str:
    """What a path is or holds that is no recording, such as `holds no pictures but 3 files such as a.txt`."""
    if path.suffix.lower() in EXTENSIONS:
        return "is a single picture"
    try:
        if path.is_dir():
            return _folder_contents(sorted(path.iterdir()))
        with open(path, "rb") as stream:
            head = stream.read(_HEAD_BYTES)
    except OSError as error:
        return f"cannot be read ({error.strerror})"
    if not head:
        return "is an empty file"
    return "is text" if b"\0" not in head and _is_text(head) else "is a file of another kind"


def _folder_contents(entries: list[Path]) -> str:
    if not entries:
        return "is an empty folder"
    for folder in filter(Path.is_dir, entries):
        if any(file.suffix.lower() in EXTENSIONS for file in folder.iterdir()):
            return f"holds no pictures, but its folder {folder.name} does"
    files = [entry.name for entry in entries if entry.is_file()]
    what = f"{counted(len(files), 'file')} such as {files[0]}" if files else counted(len(entries), "folder")
    return f"holds no pictures but {what}"


def _is_text(head: bytes) -> bool:
    try:
        head.decode()
    except UnicodeDecodeError as error:
        return error.end == len(head) == _HEAD_BYTES  # cut in the middle of a character
    return True


def opened(registry: Registry, name: str, params: dict[str, Any]) -> dict[str, Any]:
    """What a Recording says of the sequence, as JSON types; frames but the first are not read. Raises DatasetError."""
    sequence = registry.create("dataset", name, params).open()
    height, width = sequence.read(0).image.shape[:2]
    origin = sequence.origin
    return {
        "name": clean_line(str(sequence.name)),
        "frames": len(sequence),
        "channels": int(sequence.channels),
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


def answered(registry: Registry, name: str, path: str) -> tuple[bool, dict[str, Any]] | None:
    """Whether a dataset is a catch-all and how it opens what lies at `path`; None where that is not its kind."""
    cls = registry.load("dataset", name)
    params = cls.recognise(Path(path))
    return None if params is None else (bool(cls.catch_all), dict(params))


def _how_to_set(said: str, settable: frozenset[str]) -> str:
    """How the parameters that an error names are given on the command line; empty where it names none."""
    named = [name for name in dict.fromkeys(re.findall(r"`(\w+)[`:]", said)) if name in settable and name != "path"]
    words = ["--fov DEGREES" if name == "fov_deg" else f"--set {name}=VALUE" for name in named]
    return f"\nwith `codecbench try` and `init --from`: {', '.join(words)}" if words else ""


def _check_params(registry: Registry, dataset: str, params: dict[str, Any]) -> None:
    """Raise ParamsError for parameters that the dataset does not take."""
    try:
        describe(registry, "dataset", dataset, params)
    except InvalidParams as invalid:
        raise ParamsError(f"dataset {dataset}: {invalid.sentence}") from None


def _answer(registry: Registry, name: str, path: Path) -> tuple[bool, dict[str, Any]] | None:
    """As `answered`; a dataset of another distribution that fails at it does not recognise the path."""
    try:
        answer = registry.ask(answered, name, str(path.absolute()), of=[("dataset", name)])
    except (CodecbenchError, OSError):
        return None
    return None if answer is None else (bool(answer[0]), dict(answer[1]))
