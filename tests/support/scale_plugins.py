"""Plugins that do nothing, many times over: what is left is what the engine costs."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

from pydantic import Field

from codecbench import (
    NULL_TRACE,
    Capabilities,
    Codec,
    CodecEvaluator,
    CodedFrame,
    Context,
    FrameEvaluator,
    FrameSequence,
    Image,
    Measurement,
    Metric,
    Params,
    PluginSpec,
    Trace,
    hookimpl,
)


class Number(Params):
    number: int = Field(0, ge=0)


class Idle(Codec[Number]):
    """Never called."""

    name = "idle"
    version = "1"
    params_type = Number
    capabilities = Capabilities(channels=(1,))

    def encode(self, image: Image, *, trace: Trace = NULL_TRACE) -> bytes:
        raise NotImplementedError("the evaluators of these runs look at no coded frame")

    def decode(self, bitstream: bytes, *, trace: Trace = NULL_TRACE) -> Image:
        raise NotImplementedError("the evaluators of these runs look at no coded frame")


class Noop(CodecEvaluator[Number]):
    """Measures its own number."""

    name = "noop"
    version = "1"
    params_type = Number
    metrics = (Metric("number", "1", "neither", "its own number"),)

    def evaluate(self, codec: Codec[Any], sequence: FrameSequence, context: Context) -> Iterator[Measurement]:
        yield Measurement("number", float(self.params.number))


class Burn(CodecEvaluator[Number]):
    """Uses up half a second of a core."""

    name = "burn"
    version = "1"
    params_type = Number
    metrics = (Metric("number", "1", "neither", "its own number"),)

    def evaluate(self, codec: Codec[Any], sequence: FrameSequence, context: Context) -> Iterator[Measurement]:
        burn(0.5)
        yield Measurement("number", float(self.params.number))


def burn(cpu_s: float) -> None:
    """Compute until this process has had that much of a core."""
    until = time.process_time() + cpu_s
    while time.process_time() < until:
        sum(range(10000))


class Sampled(FrameEvaluator[Number]):
    """Declares five metrics a frame; what a run would have kept of it is written by the test."""

    name = "sampled"
    version = "1"
    params_type = Number
    metrics = tuple(Metric(f"m{n}", "1", "lower", "a sample", aggregates=("mean", "median", "p95")) for n in range(5))

    def evaluate(self, coded: CodedFrame) -> Iterator[Measurement]:
        for metric in self.metrics:
            yield Measurement(metric.name, float(coded.original.index))


_HERE = "scale_plugins:"


@hookimpl
def codecbench_codecs() -> list[PluginSpec]:
    return [PluginSpec("idle", _HERE + "Idle", "does nothing")]


@hookimpl
def codecbench_evaluators() -> list[PluginSpec]:
    return [
        PluginSpec("noop", _HERE + "Noop", "measures nothing"),
        PluginSpec("burn", _HERE + "Burn", "computes for half a second"),
        PluginSpec("sampled", _HERE + "Sampled", "many samples"),
    ]
