"""Sequences rendered at first use, and the cache of their frames on disk."""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from abc import abstractmethod
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.sequence import Camera, Frame, FrameSequence, Trajectory
from codecbench.core.kernels.folders import cache_folder
from codecbench.plugins.datasets.selection import Selection, convert_color

_DIGEST_BYTES = 32


class FrameStore:
    """Stores frames of one shape in a folder, one file per frame.

    Any number of processes may read and write at once: a file appears complete, and its first bytes are the
    SHA-256 of the rest. If the folder cannot be written, frames are rendered again.
    """

    def __init__(self, folder: Path, shape: tuple[int, int, int]) -> None:
        self.folder = folder
        self.shape = shape

    def file(self, index: int) -> Path:
        return self.folder / f"{index:06d}.rgb"

    def load(self, index: int) -> Image | None:
        """Load a frame; None if it is missing or its checksum is wrong."""
        try:
            content = self.file(index).read_bytes()
        except OSError:
            return None
        pixels = memoryview(content)[_DIGEST_BYTES:]
        if len(pixels) != int(np.prod(self.shape)) or hashlib.sha256(pixels).digest() != content[:_DIGEST_BYTES]:
            return None
        return np.frombuffer(pixels, np.uint8).reshape(self.shape).copy()

    def save(self, index: int, image: Image) -> None:
        """Store a frame; errors of the disk are ignored."""
        pixels = image.tobytes()
        temporary = None
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            handle, temporary = tempfile.mkstemp(prefix=".new-", dir=self.folder)
            with os.fdopen(handle, "wb") as stream:
                stream.write(hashlib.sha256(pixels).digest())
                stream.write(pixels)
            os.replace(temporary, self.file(index))
        except OSError:
            if temporary is not None:
                Path(temporary).unlink(missing_ok=True)


class CameraPath(Protocol):
    """A camera's path."""

    loop_s: float
    """Time at which the camera first sees its start again."""

    def world_from_camera(self, time_s: float) -> NDArray[np.float64]:
        """The exact pose (4, 4) at a time in seconds: x right, y down, z forward in the camera, metres."""


class RenderedSequence(FrameSequence):
    """Renders frames at first use and keeps them in the cache folder, 0.9 MB each at 640 x 480.

    frames, rate_hz: length and frame rate before the selection. pixel_inputs: everything that determines the pixels of
    frame i, independent of the selection. has_loop: whether the selected frames return to the first one.
    """

    def __init__(
        self,
        name: str,
        selection: Selection,
        frames: int,
        rate_hz: float,
        camera: Camera,
        path: CameraPath,
        pixel_inputs: Any,
    ) -> None:
        self.name = name
        self.frame_rate_hz = rate_hz / selection.stride
        self.channels = 1 if selection.color == "gray" else 3
        self.camera = camera
        self.path = path
        self._color = selection.color
        self._rate_hz = rate_hz
        self._indices = selection.indices(frames, "synthetic")
        self.timestamps_s = np.array(self._indices) / rate_hz
        poses = np.array([path.world_from_camera(time_s) for time_s in self.timestamps_s])
        self.ground_truth = Trajectory(self.timestamps_s, poses)
        self.has_loop = bool(self.timestamps_s[-1] - self.timestamps_s[0] >= path.loop_s)
        digest = _digest(pixel_inputs)
        self.fingerprint = _digest([digest, list(self._indices), self.channels])
        folder = cache_folder() / "synthetic" / digest[:16]
        self._store = FrameStore(folder, (camera.height, camera.width, 3))

    def read(self, index: int) -> Frame:
        if not 0 <= index < len(self):
            raise DatasetError(f"synthetic: frame {index} is not in 0..{len(self) - 1}")
        source = self.source(index)
        image = self._store.load(source)
        if image is None:
            image = self.render(source)
            self._store.save(source, image)
        return Frame(index, float(self.timestamps_s[index]), convert_color(image, self._color))

    def source(self, index: int) -> int:
        """The number of a frame before the selection."""
        return self._indices[index]

    @abstractmethod
    def distances_m(self, source: int) -> NDArray[np.float64]:
        """Distances (H, W) along the optical axis at frame `source`, in meters; infinity where there is nothing."""

    @abstractmethod
    def render(self, source: int) -> Image:
        """Render frame `source`, counted before the selection, as (H, W, 3), without the cache."""


def _digest(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()
