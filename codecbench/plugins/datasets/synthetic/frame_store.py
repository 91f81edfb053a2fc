"""Rendered frames on disk: one file a frame, checked whenever it is read, written whole or not at all."""

from __future__ import annotations

import hashlib
import os
import tempfile
from pathlib import Path

import numpy as np

from codecbench.core.contracts.image import Image

_DIGEST_BYTES = 32


class FrameStore:
    """Frames of one shape in a folder, by index.

    Any number of processes may read and write at once: a file appears complete, and its first bytes are the
    SHA-256 of the rest. A folder that cannot be written costs time and nothing else.
    """

    def __init__(self, folder: Path, shape: tuple[int, int, int]) -> None:
        self.folder = folder
        self.shape = shape

    def file(self, index: int) -> Path:
        return self.folder / f"{index:06d}.rgb"

    def load(self, index: int) -> Image | None:
        """The frame, or None where it is not there or not as it was written."""
        try:
            content = self.file(index).read_bytes()
        except OSError:
            return None
        pixels = memoryview(content)[_DIGEST_BYTES:]
        if len(pixels) != int(np.prod(self.shape)) or hashlib.sha256(pixels).digest() != content[:_DIGEST_BYTES]:
            return None
        return np.frombuffer(pixels, np.uint8).reshape(self.shape).copy()

    def save(self, index: int, image: Image) -> None:
        """Keep a frame, as far as the disk allows."""
        pixels = image.tobytes()
        unfinished = None
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            handle, unfinished = tempfile.mkstemp(prefix=".new-", dir=self.folder)
            with os.fdopen(handle, "wb") as stream:
                stream.write(hashlib.sha256(pixels).digest())
                stream.write(pixels)
            os.replace(unfinished, self.file(index))
        except OSError:
            if unfinished is not None:
                Path(unfinished).unlink(missing_ok=True)
