"""The dataset `folder`: any image files, in the order of their names."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.contracts.sequence import Dataset, Depth, FrameSequence, Origin
from codecbench.plugins.datasets.files import EXTENSIONS, Content, FileSequence, frame_size, image_header
from codecbench.plugins.datasets.selection import DepthParams, FolderSelection, GivenCameraParams


class FolderParams(FolderSelection, GivenCameraParams, DepthParams):
    """Set the frame rate and the camera of a folder of images; with `depth_unit_m` its 16-bit images are depth."""

    frame_rate_hz: Annotated[float, Field(gt=0.0, description="frames per second; frame times follow from it")] = 30.0


class Folder(Dataset[FolderParams]):
    """Image files in natural order (2 before 10), of any sizes; no ground truth.

    Of 16 bits, with `depth` in its name, a folder is recognized as depth in millimeters.
    """

    name: ClassVar[str] = "folder"
    version: ClassVar[str] = "1"
    params_type = FolderParams
    catch_all = True

    @classmethod
    def recognise(cls, path: Path) -> dict[str, Any] | None:
        images = [file for file in path.iterdir() if file.suffix.lower() in EXTENSIONS] if path.is_dir() else []
        if not images:
            return None
        first = min(images, key=natural_key)
        called_depth = "depth" in path.resolve().name.lower() or "depth" in first.name.lower()
        is_depth = called_depth and image_header(first)[1].startswith("I;16")
        return {"path": str(path), **({"depth_unit_m": 0.001} if is_depth else {})}

    def open(self) -> FrameSequence:
        params = self.params
        folder = params.folder("image files")
        files = image_files(folder)
        chosen = params.indices(len(files), str(folder))
        known = params.given_camera(lambda: frame_size(files[chosen[0]], chosen[0]))
        depth = None if params.depth_unit_m is None else params.meaning(Depth(params.depth_unit_m))
        depth_notes = () if depth is None else (f"its pixels are taken as distances in steps of {depth.unit_m:g} m",)
        content = Content(
            name=folder.resolve().name,
            where=str(folder),
            files=tuple(files[index] for index in chosen),
            numbers=chosen,
            timestamps_s=np.array(chosen, dtype=np.float64) / params.frame_rate_hz,
            frame_rate_hz=params.frame_rate_hz / params.stride,
            camera=known.camera,
            depth=depth,
            color=params.color,
            sizes_differ=True,
            notes=(*params.subset_notes(len(files)), *known.notes, *depth_notes),
            origin=Origin("folder of images" if depth is None else "folder of depth images", known.source),
        )
        return params.as_asked(FileSequence(content))


def image_files(folder: Path) -> list[Path]:
    """The image files of a folder in natural order. Raises DatasetError if there are none."""
    try:
        names = [file for file in folder.iterdir() if not file.name.startswith(".")]
    except OSError as error:
        raise DatasetError(f"{folder}: cannot be listed: {error.strerror}; set `path` to a folder of images") from error
    files = [file for file in names if file.suffix.lower() in EXTENSIONS]
    if not files:
        raise DatasetError(f"{folder}: contains no image files ({', '.join(EXTENSIONS)})")
    return sorted(files, key=natural_key)


def natural_key(file: Path) -> tuple[list[tuple[int, int | str]], str]:
    """Sort key of natural order: numbers in names compare as numbers."""
    parts = re.split(r"([0-9]+)", file.name.lower())
    return [(0, int(part)) if part.isdecimal() else (1, part) for part in parts], file.name
