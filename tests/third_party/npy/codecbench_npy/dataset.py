"""A dataset: a sequence whose frames lie in one NumPy file."""

import hashlib
from pathlib import Path

import numpy as np
from pydantic import Field

from codecbench import Dataset, DatasetError, Frame, FrameSequence, Params, PathParam


class NpyParams(Params):
    path: PathParam = Field(description="a .npy file of uint8: (N, H, W) gray or (N, H, W, 3) RGB")
    frame_rate_hz: float = Field(default=30.0, gt=0)


class NpySequence(FrameSequence):
    camera = None
    ground_truth = None

    def __init__(self, file: Path, frame_rate_hz: float) -> None:
        try:
            self._frames = np.load(file, mmap_mode="r", allow_pickle=False)
        except (OSError, ValueError) as error:
            raise DatasetError(f"{file}: {error}; `path` must be a .npy file") from error
        shape = self._frames.shape
        if self._frames.dtype != np.uint8 or not (len(shape) == 3 or (len(shape) == 4 and shape[3] == 3)):
            raise DatasetError(f"{file}: {self._frames.dtype} {shape}; allowed: uint8 (N, H, W) or (N, H, W, 3)")
        self.name = file.stem
        self.channels = 1 if len(shape) == 3 else 3
        self.frame_rate_hz = frame_rate_hz
        self.timestamps_s = np.arange(len(self._frames)) / frame_rate_hz
        content = hashlib.sha256(f"{shape} {frame_rate_hz} ".encode() + self._frames.tobytes())
        self.fingerprint = content.hexdigest()

    def read(self, index: int) -> Frame:
        return Frame(index, float(self.timestamps_s[index]), np.array(self._frames[index]))


class Npy(Dataset[NpyParams]):
    name = "npy"
    version = "1"
    params_type = NpyParams

    @classmethod
    def recognise(cls, path: Path) -> dict[str, str] | None:
        return {"path": str(path)} if path.suffix == ".npy" and path.is_file() else None

    def open(self) -> FrameSequence:
        return NpySequence(self.params.path, self.params.frame_rate_hz)
