"""The dataset `synthetic`: rendered sequences with exact ground truth, some with loops."""

from __future__ import annotations

from functools import cache
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from codecbench.core.contracts.image import Image
from codecbench.core.contracts.sequence import Camera, Dataset, FrameSequence
from codecbench.plugins.datasets.selection import Selection
from codecbench.plugins.datasets.synthetic.depth import DepthSequence
from codecbench.plugins.datasets.synthetic.paths import FRAME_RATE_HZ, HandheldPath
from codecbench.plugins.datasets.synthetic.rendered import RenderedSequence
from codecbench.plugins.datasets.synthetic.textures import photographs_digest, round_to_uint8
from codecbench.plugins.datasets.synthetic.worlds.presets import WORLD_NAMES, WORLDS, WorldName
from codecbench.plugins.datasets.synthetic.worlds.sequence import WorldSequence

_OFFSETS_PX = ((-1 / 3, 0.0), (0.0, 1 / 3), (1 / 3, -1 / 3))
"""Offsets in the pixel of a frame's samples; the k-th of n is taken in the k-th n-th of the exposure."""

READ_NOISE = 1.0
"""Standard deviation in gray levels at black."""

SHOT_NOISE = 0.02
"""Variance per gray level: with READ_NOISE a standard deviation of 1.9 at 128, typical of an indoor webcam."""

_CORNER_LOSS = 0.22


class SyntheticParams(Selection):
    """Set a synthetic scene: a `world` with its own length, size, rate and conditions, or the room.

    Without a world one loop takes 340 / speed frames; the default adds 60 frames that revisit its beginning.
    """

    world: Annotated[WorldName | None, Field(description="a named synthetic scene; default: the room")] = None
    severity: Annotated[
        float | None,
        Field(
            ge=0.0,
            le=1.0,
            description="severity of the world's conditions, 0 (calm) to 1 (hard); default with a world: 0.5",
        ),
    ] = None
    frames: Annotated[
        int, Field(ge=1, le=100_000, description="number of frames; default with a world: a loop and a seventh")
    ] = 400
    rate_hz: Annotated[float, Field(gt=0.0, le=1000.0, description="frames per second; always 30 without a world")] = (
        30.0
    )
    width: Annotated[int, Field(ge=16, le=4096, description="width in pixels")] = 640
    height: Annotated[int, Field(ge=16, le=4096, description="height in pixels")] = 480
    seed: Annotated[int, Field(ge=0, description="seed of the hand's tremor and the sensor's noise")] = 0
    speed: Annotated[
        float, Field(gt=0.0, le=4.0, description="factor on the walking speed; at 1 a loop takes 11.3 s at 0.7 m/s")
    ] = 1.0
    noise: Annotated[float, Field(ge=0.0, le=20.0, description="factor on the sensor's noise")] = 1.0
    motion_blur: Annotated[
        float, Field(ge=0.0, le=1.0, description="exposure time as a share of the frame interval")
    ] = 0.25

    stream: Annotated[Literal["color", "depth"], Field(description="color, or depth in millimeters")] = "color"
    depth_noise: Annotated[
        float,
        Field(ge=0.0, le=20.0, description="factor on the depth sensor's noise; 0: exact, without shadows"),
    ] = 1.0

    @model_validator(mode="before")
    @classmethod
    def _fill_in_from_world(cls, values: Any) -> Any:
        """Fill in the defaults of a synthetic scene, so that equivalent parameters become equal."""
        if not isinstance(values, dict) or values.get("world") not in WORLD_NAMES:
            return values
        world = WORLDS[values["world"]]
        given = {name: value for name, value in values.items() if (name, value) != ("severity", None)}
        filled = {"severity": 0.5, "rate_hz": world.rate_hz, "width": world.width, "height": world.height, **given}
        severity, rate_hz = filled["severity"], filled["rate_hz"]
        if "frames" not in filled and isinstance(severity, int | float) and isinstance(rate_hz, int | float):
            filled["frames"] = world.frames(min(max(severity, 0.0), 1.0), rate_hz)
        return filled

    @model_validator(mode="after")
    def _check_world_or_conditions(self) -> Self:
        """Refuse single conditions together with a synthetic scene, and severity or rate without one."""
        names = ("severity", "rate_hz") if self.world is None else ("speed", "noise", "motion_blur")
        for name in names:
            if getattr(self, name) != type(self).model_fields[name].default:
                if self.world is None:
                    raise ValueError(f"{name} needs a world; set world to one of {', '.join(WORLD_NAMES)}")
                raise ValueError(f"{name} is fixed by world {self.world}; set severity, or leave out world")
        if self.stream == "depth" and self.color == "rgb":
            raise ValueError("depth is gray; leave out `color: rgb`")
        return self

    def pixel_inputs(self) -> dict[str, Any]:
        """Everything that determines the pixels of frame i of the room without `world`, whatever is selected."""
        return self.model_dump(include={"width", "height", "seed", "speed", "noise", "motion_blur"})


class Synthetic(Dataset[SyntheticParams]):
    """Rendered sequences with exact ground truth: a hand-held walk around a room, or a named synthetic scene."""

    name: ClassVar[str] = "synthetic"
    version: ClassVar[str] = "1"
    kernels = ("codecbench.plugins.datasets.synthetic",)
    params_type = SyntheticParams

    def open(self) -> FrameSequence:
        p = self.params
        rendered: RenderedSequence = (
            SyntheticSequence(p)
            if p.world is None or p.severity is None
            else WorldSequence(p.world, p.severity, p, p.frames, p.rate_hz, (p.width, p.height), p.seed)
        )
        return p.as_asked(rendered if p.stream == "color" else DepthSequence(rendered, p.seed, p.depth_noise))


class SyntheticSequence(RenderedSequence):
    """The furnished room with scikit-image's photographs, seen by a hand-held camera that circles its table."""

    def __init__(self, params: SyntheticParams) -> None:
        self._params = params
        pixel_inputs = [Synthetic.version, params.pixel_inputs(), photographs_digest()]
        path = HandheldPath(params.seed, params.speed)
        camera = room_camera(params.width, params.height)
        super().__init__("synthetic", params, params.frames, FRAME_RATE_HZ, camera, path, pixel_inputs)

    def render(self, source: int) -> Image:
        params = self._params
        light = _renderer(params.width, params.height).mean_of_samples(
            self._exposure_poses(source / FRAME_RATE_HZ), np.array(_OFFSETS_PX)
        )
        return expose_and_digitize(light, params.noise, np.random.default_rng([params.seed, 2, source]))

    def distances_m(self, source: int) -> NDArray[np.float64]:
        pose = self.path.world_from_camera(source / FRAME_RATE_HZ)
        return np.asarray(_renderer(self._params.width, self._params.height).visible(pose)[1])

    def _exposure_poses(self, time_s: float) -> NDArray[np.float64]:
        """Poses (S, 4, 4) spread evenly over the exposure, which is centered on the frame's time."""
        count = len(_OFFSETS_PX)
        shares = (np.arange(count) + 0.5) / count - 0.5
        times_s = time_s + shares * self._params.motion_blur / FRAME_RATE_HZ
        return np.array([self.path.world_from_camera(time_s) for time_s in times_s])


def room_camera(width: int, height: int) -> Camera:
    """A camera without distortion, with the field of view of TUM's: a focal length of 525 pixels at 640 wide."""
    focal_px = 525.0 * width / 640.0
    return Camera(width, height, focal_px, focal_px, (width - 1) / 2, (height - 1) / 2)


@cache
def _renderer(width: int, height: int) -> Any:
    # Imported here because they load numba, which cached frames do not need.
    from codecbench.plugins.datasets.synthetic.render import Renderer
    from codecbench.plugins.datasets.synthetic.room import room_atlas

    return Renderer(room_atlas(), room_camera(width, height))


def expose_and_digitize(light: NDArray[np.float32], noise: float, rng: np.random.Generator) -> Image:
    """The sensor's image (H, W, 3) of `light`, 0..255: vignetting, noise, rounding; `noise` scales both deviations."""
    exposed = light * _vignette(*light.shape[:2])
    if noise > 0.0:
        deviation = np.sqrt(np.float32(READ_NOISE**2) + np.float32(SHOT_NOISE) * exposed) * np.float32(noise)
        exposed += deviation * rng.standard_normal(light.shape, dtype=np.float32)
    return round_to_uint8(exposed)


@cache
def _vignette(height: int, width: int) -> NDArray[np.float32]:
    """Vignetting factors (H, W, 1): 1 in the middle, falling with the squared distance from it."""
    rows = (np.arange(height) - (height - 1) / 2)[:, None]
    columns = (np.arange(width) - (width - 1) / 2)[None, :]
    squares = (rows**2 + columns**2) / (((height - 1) / 2) ** 2 + ((width - 1) / 2) ** 2 + 1e-9)
    return np.asarray((1.0 - _CORNER_LOSS * squares)[:, :, None], dtype=np.float32)
