"""A codec whose size is an exact function of its parameters, and evaluators of known answers, for tests of searches."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any, Literal

import numpy as np
from pydantic import Field

from codecbench import (
    NULL_TRACE,
    AnyCodec,
    Capabilities,
    Codec,
    CodecEvaluator,
    CodedFrame,
    CodedSequence,
    Context,
    Dataset,
    Frame,
    FrameEvaluator,
    FrameSequence,
    Image,
    Measurement,
    Metric,
    NoParams,
    Params,
    PluginSpec,
    SequenceEvaluator,
    Trace,
    hookimpl,
)
from codecbench.core.contracts.metric import Quantity

HEIGHT, WIDTH = 4, 8


class FlatParams(Params):
    frames: int = Field(default=3, ge=1)
    gray: int = Field(default=0, ge=0, le=255)


class FlatSequence(FrameSequence):
    """Frames of one gray."""

    def __init__(self, params: FlatParams) -> None:
        self._gray = params.gray
        self.name = f"flat{params.gray}"
        self.timestamps_s = np.arange(params.frames) / 30.0
        self.frame_rate_hz = 30.0
        self.channels = 1
        self.camera = None
        self.ground_truth = None
        self.fingerprint = f"flat-{params.frames}-{params.gray}"

    def read(self, index: int) -> Frame:
        return Frame(index, index / 30.0, np.full((HEIGHT, WIDTH), self._gray, np.uint8))


class Flat(Dataset[FlatParams]):
    name = "flat"
    version = "1"
    params_type = FlatParams

    def open(self) -> FrameSequence:
        return FlatSequence(self.params)


class DialParams(Params):
    level: int = Field(default=0, ge=0, le=1000)
    share: float = Field(default=0.0, ge=0.0, le=1.0)
    effort: Literal["low", "middle", "high"] = "low"
    broken_from: int = 1001
    pause_s: float = 0.0


class Dial(Codec[DialParams]):
    """Writes 10 bytes, 3 more a level, 100 more for the whole share and 5 for each effort but the first."""

    name = "dial"
    version = "1"
    params_type = DialParams
    capabilities = Capabilities(channels=(1,))

    @staticmethod
    def size_bytes(level: int = 0, share: float = 0.0, effort: str = "low") -> int:
        return 10 + 3 * level + round(100 * share) + 5 * ("low", "middle", "high").index(effort)

    def encode(self, image: Image, *, trace: Trace = NULL_TRACE) -> bytes:
        if self.params.level >= self.params.broken_from:
            raise RuntimeError("the dial came off")
        time.sleep(self.params.pause_s)
        p = self.params
        return bytes([image.shape[0], image.shape[1], image[0, 0]]).ljust(self.size_bytes(p.level, p.share, p.effort))

    def decode(self, bitstream: bytes, *, trace: Trace = NULL_TRACE) -> Image:
        return np.full((bitstream[0], bitstream[1]), bitstream[2], np.uint8)


class Still(Dial):
    """The baseline."""

    name = "still"
    reference = "baseline"


class Scales(FrameEvaluator[NoParams]):
    """What a frame spends; its gray adds to it, so that sequences differ."""

    name = "scales"
    version = "1"
    params_type = NoParams
    metrics = (
        Metric(
            "weight_bytes", "bytes", "lower", "size and gray", ("mean", "max"), role="rate", headline=True, scale="log"
        ),
    )

    def evaluate(self, coded: CodedFrame) -> Iterator[Measurement]:
        yield Measurement("weight_bytes", float(coded.size_bytes + int(coded.original.image[0, 0])))


class TossParams(Params):
    runs: int = Field(default=1, ge=1)
    even_at_bytes: float = 100.0
    steep: float = 0.0


class Toss(SequenceEvaluator[TossParams]):
    """Is caught with a chance that grows with the size of the first frame: 1/2 at `even_at_bytes`."""

    name = "toss"
    version = "1"
    params_type = TossParams
    metrics = (Metric("caught", "1", "higher", "1 or 0", ("mean",), role="success", headline=True),)

    @property
    def repeats(self) -> int:
        return self.params.runs

    def repeat_identity(self, repeat: int) -> dict[str, Any]:
        return {"even_at_bytes": self.params.even_at_bytes, "steep": self.params.steep, "run": repeat}

    def evaluate(self, coded: CodedSequence, context: Context) -> Iterator[Measurement]:
        size = next(iter(coded)).size_bytes
        yield Measurement("caught", float(context.rng.random() < chance(size, self.params)))


class Stray(Toss):
    """How far something goes astray that reads what comes."""

    name = "stray"
    metrics = (Metric("stray_m", "m", "lower", "a distance", quantity="error"),)


class Sight(Toss):
    """How well something is seen."""

    name = "sight"
    metrics = (Metric("seen", "1", "higher", "a share", role="task", headline=True, label="seen", enough=0.9),)


class LagParams(Params):
    runs: int = Field(default=1, ge=1)


class Lag(CodecEvaluator[LagParams]):
    """Times encoding."""

    name = "lag"
    version = "1"
    params_type = LagParams
    metrics = (Metric("lag_ms", "ms", "lower", "a time", repeatable=False, quantity="encoding"),)

    @property
    def repeats(self) -> int:
        return self.params.runs

    def repeat_identity(self, repeat: int) -> dict[str, Any]:
        return {}

    def evaluate(self, codec: AnyCodec[Any], sequence: FrameSequence, context: Context) -> Iterator[Measurement]:
        yield Measurement("lag_ms", 1.5)


class WaiterParams(Params):
    pause_ms: float | Literal["measured"] = "measured"
    runs: int = Field(default=1, ge=1)


class Waiter(SequenceEvaluator[WaiterParams]):
    """Says how long the pause was that it was given."""

    name = "waiter"
    version = "1"
    params_type = WaiterParams
    metrics = (Metric("paused_ms", "ms", "lower", "the pause", headline=True, role="task"),)

    @property
    def repeats(self) -> int:
        return self.params.runs

    def repeat_identity(self, repeat: int) -> dict[str, Any]:
        return {"pause_ms": self.params.pause_ms}

    @property
    def requires(self) -> dict[str, Quantity]:
        return {"pause_ms": "encoding"} if self.params.pause_ms == "measured" else {}

    def evaluate(self, coded: CodedSequence, context: Context) -> Iterator[Measurement]:
        yield Measurement("paused_ms", context.inputs["pause_ms"])


def chance(size_bytes: float, params: TossParams) -> float:
    """That a frame of this size is caught; all or nothing where the chance is not steep."""
    if params.steep == 0.0:
        return float(size_bytes >= params.even_at_bytes)
    return float(1.0 / (1.0 + np.exp(-params.steep * (size_bytes - params.even_at_bytes))))


@hookimpl
def codecbench_datasets() -> list[PluginSpec]:
    return [PluginSpec("flat", "search_plugins:Flat", "one gray")]


@hookimpl
def codecbench_codecs() -> list[PluginSpec]:
    return [
        PluginSpec("still", "search_plugins:Still", "the baseline"),
        PluginSpec("dial", "search_plugins:Dial", "of known size"),
    ]


@hookimpl
def codecbench_evaluators() -> list[PluginSpec]:
    return [
        PluginSpec("scales", "search_plugins:Scales", "what a frame spends"),
        PluginSpec("toss", "search_plugins:Toss", "caught or not"),
        PluginSpec("stray", "search_plugins:Stray", "goes astray"),
        PluginSpec("sight", "search_plugins:Sight", "sees"),
        PluginSpec("lag", "search_plugins:Lag", "times encoding"),
        PluginSpec("waiter", "search_plugins:Waiter", "awaits a time"),
    ]
