"""The dataset `synthetic`: a sequence that is always there, with a loop and with exact ground truth."""

from __future__ import annotations

import hashlib
import json
from functools import cache
from typing import Annotated, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from codecbench.core.contracts.errors import DatasetError
from codecbench.core.contracts.image import Image
from codecbench.core.contracts.sequence import Camera, Dataset, Frame, Sequence, Trajectory
from codecbench.core.kernels.cache_folder import cache_folder
from codecbench.plugins.datasets.selection import Selection, converted
from codecbench.plugins.datasets.synthetic.frame_store import FrameStore
from codecbench.plugins.datasets.synthetic.path import FRAME_RATE_HZ, HandheldPath
from codecbench.plugins.datasets.synthetic.photographs import photographs_digest

_OFFSETS_PX = ((-1 / 3, 0.0), (0.0, 1 / 3), (1 / 3, -1 / 3))
"""Where in the pixel the samples of a frame lie; the k-th of n is taken in the k-th n-th of the exposure."""


class SyntheticParams(Selection):
    """Parameters of `synthetic`. A round takes 340 / speed frames; the default adds 60 that see the start again."""

    frames: Annotated[int, Field(ge=1, le=100_000, description="length at 30 Hz")] = 400
    width: Annotated[int, Field(ge=16, le=4096, description="pixels")] = 640
    height: Annotated[int, Field(ge=16, le=4096, description="pixels")] = 480
    seed: Annotated[int, Field(ge=0, description="of the hand's tremor and the sensor's noise")] = 0
    speed: Annotated[float, Field(gt=0.0, le=4.0, description="1 walks round in 11.3 s at 0.7 m/s")] = 1.0
    noise: Annotated[float, Field(ge=0.0, le=20.0, description="factor on the sensor's noise")] = 1.0
    motion_blur: Annotated[float, Field(ge=0.0, le=1.0, description="exposure as a share of the frame interval")] = 0.25

    def picture(self) -> dict[str, Any]:
        """What determines the pixels of frame i, whichever frames are asked for."""
        return self.model_dump(include={"width", "height", "seed", "speed", "noise", "motion_blur"})


class Synthetic(Dataset[SyntheticParams]):
    """A furnished room with scikit-image's photographs, seen by a hand-held camera that walks round its table."""

    name: ClassVar[str] = "synthetic"
    version: ClassVar[str] = "1"
    kernels = ("codecbench.plugins.datasets.synthetic",)
    params_type = SyntheticParams

    def open(self) -> Sequence:
        return SyntheticSequence(self.params)


class SyntheticSequence(Sequence):
    """Frames rendered at first use and kept in the cache folder, 0.9 MB each at 640 x 480."""

    def __init__(self, params: SyntheticParams) -> None:
        self.name = "synthetic"
        self.frame_rate_hz = FRAME_RATE_HZ / params.stride
        self.channels = 1 if params.color == "gray" else 3
        self._params = params
        self._indices = params.indices(params.frames, "synthetic")
        self._path = HandheldPath(params.seed, params.speed)
        self.timestamps_s = np.array(self._indices) / FRAME_RATE_HZ
        self.camera = room_camera(params.width, params.height)
        poses = np.array([self._path.world_from_camera(time_s) for time_s in self.timestamps_s])
        self.ground_truth = Trajectory(self.timestamps_s, poses)
        identity = [Synthetic.version, params.picture(), photographs_digest()]
        picture = _digest(identity)
        self.fingerprint = _digest([picture, list(self._indices), self.channels])
        folder = cache_folder() / "synthetic" / picture[:16]
        self._store = FrameStore(folder, (params.height, params.width, 3))

    def read(self, index: int) -> Frame:
        if not 0 <= index < len(self):
            raise DatasetError(f"synthetic: frame {index} is not in 0..{len(self) - 1}")
        source = self._indices[index]
        image = self._store.load(source)
        if image is None:
            image = self._render(source)
            self._store.save(source, image)
        return Frame(index, float(self.timestamps_s[index]), converted(image, self._params.color))

    def _render(self, source: int) -> Image:
        from codecbench.plugins.datasets.synthetic.sensor import sensed

        params = self._params
        light = _renderer(params.width, params.height).mean_of_samples(
            self._exposure_poses(source / FRAME_RATE_HZ), np.array(_OFFSETS_PX)
        )
        return sensed(light, params.noise, np.random.default_rng([params.seed, 2, source]))

    def _exposure_poses(self, time_s: float) -> NDArray[np.float64]:
        """Poses (S, 4, 4) spread evenly over the exposure, whose middle is the frame's time."""
        count = len(_OFFSETS_PX)
        shares = (np.arange(count) + 0.5) / count - 0.5
        times_s = time_s + shares * self._params.motion_blur / FRAME_RATE_HZ
        return np.array([self._path.world_from_camera(time_s) for time_s in times_s])


def room_camera(width: int, height: int) -> Camera:
    """A camera without distortion with the field of view of TUM's: 525 pixels of focal length at 640 wide."""
    focal_px = 525.0 * width / 640.0
    return Camera(width, height, focal_px, focal_px, (width - 1) / 2, (height - 1) / 2)


@cache
def _renderer(width: int, height: int) -> Any:
    from codecbench.plugins.datasets.synthetic.render import Renderer
    from codecbench.plugins.datasets.synthetic.room import room_atlas

    return Renderer(room_atlas(), room_camera(width, height))


def _digest(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()
