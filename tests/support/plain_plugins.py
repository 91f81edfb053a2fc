"""The smallest plugin of each kind, for tests of the engine."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from pydantic import Field

from codecbench import (
    NULL_TRACE,
    Camera,
    Capabilities,
    Codec,
    CodecEvaluator,
    CodedFrame,
    Context,
    Dataset,
    DatasetError,
    Depth,
    Frame,
    FrameEvaluator,
    FrameSequence,
    Image,
    Measurement,
    Metric,
    NoParams,
    Params,
    PluginSpec,
    Trace,
    Unsupported,
    hookimpl,
)


class RampParams(Params):
    frames: int = Field(default=3, ge=1)
    channels: int = 1
    bits: int = 8
    unit_m: float | None = None
    camera: bool = False
    broken: bool = False


class RampSequence(FrameSequence):
    """Horizontal ramps, one gray level brighter each frame."""

    def __init__(self, params: RampParams) -> None:
        self.name = "ramp"
        self.timestamps_s = np.arange(params.frames) / 30.0
        self.frame_rate_hz = 30.0
        self.channels, self.bits = params.channels, params.bits
        self.depth = None if params.unit_m is None else Depth(params.unit_m)
        self.camera = Camera(16, 8, 10.0, 10.0, 8.0, 4.0) if params.camera else None
        self.ground_truth = None
        self.fingerprint = f"ramp-{params.frames}-{params.channels}-{params.camera}"

    def read(self, index: int) -> Frame:
        row = np.arange(16, dtype=f"uint{self.bits}") * 8 + index
        image = np.tile(row, (8, 1))
        return Frame(index, index / 30.0, image if self.channels == 1 else np.repeat(image[:, :, None], 3, axis=2))


class Ramp(Dataset[RampParams]):
    name = "ramp"
    version = "1"
    params_type = RampParams

    def open(self) -> FrameSequence:
        if self.params.broken:
            raise DatasetError("ramp.txt:3: broken on purpose")
        return RampSequence(self.params)


class ShiftParams(Params):
    bits: int = Field(default=0, ge=0, le=7)


class Shift(Codec[ShiftParams]):
    """Gray only: drops lower bits."""

    name = "shift"
    version = "1"
    params_type = ShiftParams
    capabilities = Capabilities(channels=(1,))

    def encode(self, image: Image, *, trace: Trace = NULL_TRACE) -> bytes:
        return bytes([*image.shape, self.params.bits]) + (image >> self.params.bits).tobytes()

    def decode(self, bitstream: bytes, *, trace: Trace = NULL_TRACE) -> Image:
        height, width, bits = bitstream[:3]
        return np.frombuffer(bitstream[3:], np.uint8).reshape(height, width) << bits


class Absent(Codec[NoParams]):
    """A codec whose library is missing."""

    name = "absent"
    version = "1"
    params_type = NoParams
    capabilities = Capabilities()

    def __init__(self, params: NoParams) -> None:
        raise Unsupported("libabsent is not here; run: apt install libabsent")

    def encode(self, image: Image, *, trace: Trace = NULL_TRACE) -> bytes:
        return b""

    def decode(self, bitstream: bytes, *, trace: Trace = NULL_TRACE) -> Image:
        return np.zeros((1, 1), np.uint8)


class ErrorEvaluator(FrameEvaluator[NoParams]):
    name = "error"
    version = "1"
    params_type = NoParams
    metrics = (Metric("max_error", "1", "lower", "largest absolute difference", aggregates=("max",)),)

    def evaluate(self, coded: CodedFrame) -> Iterator[Measurement]:
        difference = coded.original.image.astype(int) - coded.decoded
        yield Measurement("max_error", float(np.abs(difference).max()))


class CameraEvaluator(ErrorEvaluator):
    name = "camera"
    needs = frozenset({"camera"})


class RoundsParams(Params):
    rounds: int = 2


class Stopwatch(CodecEvaluator[RoundsParams]):
    name = "stopwatch"
    version = "1"
    params_type = RoundsParams
    metrics = (Metric("ticks", "1", "lower", "a count", aggregates=("median",), repeatable=False),)
    exclusive = True

    @property
    def repeats(self) -> int:
        return self.params.rounds

    def repeat_identity(self, repeat: int) -> dict[str, Any]:
        return {}

    def evaluate(self, codec: Codec[Any], sequence: FrameSequence, context: Context) -> Iterator[Measurement]:
        yield Measurement("ticks", float(len(codec.encode(sequence.read(0).image))))


@hookimpl
def codecbench_codecs() -> list[PluginSpec]:
    return [
        PluginSpec("shift", "plain_plugins:Shift", "drops lower bits"),
        PluginSpec("absent", "plain_plugins:Absent", "its library is missing"),
        PluginSpec("uninstalled", "nothing_here:Codec", "needs a module", requires=("nothing_here",), extra="nothing"),
    ]


@hookimpl
def codecbench_evaluators() -> list[PluginSpec]:
    return [
        PluginSpec("error", "plain_plugins:ErrorEvaluator", "largest difference"),
        PluginSpec("camera", "plain_plugins:CameraEvaluator", "needs a camera"),
        PluginSpec("stopwatch", "plain_plugins:Stopwatch", "runs alone"),
    ]


@hookimpl
def codecbench_datasets() -> list[PluginSpec]:
    return [PluginSpec("ramp", "plain_plugins:Ramp", "ramps")]
