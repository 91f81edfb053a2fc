"""What a path holds: asked of every dataset that is installed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from codecbench.core.contracts.errors import CodecbenchError, DatasetError, ParamsError
from codecbench.core.engine.foreign_text import clean_line
from codecbench.core.engine.planning.description import InvalidParams, describe
from codecbench.core.engine.registry import Registry


@dataclass(frozen=True)
class Recording:
    """A recording that a dataset recognised and opened.

    dataset, params: what opens it. width, height: of its first frame in pixels. notes: what its dataset says of it.
    assumed: what nobody said and was taken for granted.
    """

    dataset: str
    summary: str
    params: dict[str, Any]
    name: str
    frames: int
    channels: int
    width: int
    height: int
    has_camera: bool
    has_ground_truth: bool
    notes: tuple[str, ...] = ()
    assumed: tuple[str, ...] = ()

    def __str__(self) -> str:
        """`tum (TUM RGB-D benchmark layout): 715 frames, 640x480, colour, camera known, ground truth`."""
        facts = [
            f"{self.frames:,} frame{'' if self.frames == 1 else 's'}",
            f"{self.width}x{self.height}",
            "gray" if self.channels == 1 else "colour",
            "camera known" if self.has_camera else "no calibration",
            "ground truth" if self.has_ground_truth else "no ground truth",
        ]
        return f"{self.dataset} ({clean_line(self.summary)}): {', '.join(facts)}"


def recognised(registry: Registry, path: Path, given: dict[str, Any]) -> Recording:
    """The recording at `path`, opened by the first dataset that knows it, catch-alls last.

    given: parameters that its user adds. Raises DatasetError where nobody knows it and where it cannot be opened, and
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
            f"{path}: no dataset recognises it ({names}); it may be a folder of pictures, a video, a TUM, KITTI or "
            f"EuRoC folder, or a ROS bag{hint}"
        )
    plugin, (_, params) = min(found, key=lambda pair: pair[1][0])
    params = {**params, **given}
    _check_params(registry, plugin.spec.name, params)
    facts = registry.ask(opened, plugin.spec.name, params, of=[("dataset", plugin.spec.name)], times=10)
    return Recording(plugin.spec.name, plugin.spec.summary, params, **{**facts, "notes": tuple(facts["notes"])})


def opened(registry: Registry, name: str, params: dict[str, Any]) -> dict[str, Any]:
    """What a Recording says of the sequence, as JSON types; frames but the first are not read. Raises DatasetError."""
    sequence = registry.create("dataset", name, params).open()
    height, width = sequence.read(0).image.shape[:2]
    return {
        "name": clean_line(str(sequence.name)),
        "frames": len(sequence),
        "channels": int(sequence.channels),
        "width": int(width),
        "height": int(height),
        "has_camera": sequence.camera is not None,
        "has_ground_truth": sequence.ground_truth is not None,
        "notes": [clean_line(str(note)) for note in sequence.notes],
    }


def answered(registry: Registry, name: str, path: str) -> tuple[bool, dict[str, Any]] | None:
    """Whether a dataset is a catch-all and how it opens what lies at `path`; None where that is not its kind."""
    cls = registry.load("dataset", name)
    params = cls.recognise(Path(path))
    return None if params is None else (bool(cls.catch_all), dict(params))


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
