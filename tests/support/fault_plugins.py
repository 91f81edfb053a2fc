"""Plugins that go wrong in every way that we could think of, and some that must not be disturbed by them."""

from __future__ import annotations

import ctypes
import errno
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from codecbench import (
    NULL_TRACE,
    BitstreamError,
    Capabilities,
    Codec,
    CodecEvaluator,
    CodedFrame,
    CodedSequence,
    Context,
    Dataset,
    DatasetError,
    Frame,
    FrameEvaluator,
    FrameSequence,
    Image,
    Measurement,
    Metric,
    NoParams,
    Params,
    PathParam,
    PluginSpec,
    SequenceEvaluator,
    Trace,
    hookimpl,
)
from codecbench.core.engine.identity import digest

_leaked: list[Any] = []


class StackParams(Params):
    path: PathParam


class StackSequence(FrameSequence):
    """Frames in one .npy file, (N, H, W)."""

    def __init__(self, path: Path) -> None:
        if not path.is_file():
            raise DatasetError(f"{path} is missing")
        self.frames = np.load(path)
        self.name = path.stem
        self.timestamps_s = np.arange(len(self.frames)) / 30.0
        self.frame_rate_hz = 30.0
        self.channels = 1
        self.camera = None
        self.ground_truth = None
        self.fingerprint = digest([path.read_bytes().hex()])

    def read(self, index: int) -> Frame:
        return Frame(index, index / 30.0, self.frames[index].copy())


class Stack(Dataset[StackParams]):
    name = "stack"
    version = "1"
    params_type = StackParams

    def open(self) -> FrameSequence:
        return StackSequence(self.params.path)


class FaultParams(Params):
    fault: str = "none"
    step: int = Field(default=0, ge=0, le=7)


class Faulty(Codec[FaultParams]):
    """Drops `step` lower bits; goes wrong as told. Frames 0, 1, 2... have their index in pixel (0, 0)."""

    name = "faulty"
    version = "1"
    params_type = FaultParams
    capabilities = Capabilities(channels=(1,))

    def encode(self, image: Image, *, trace: Trace = NULL_TRACE) -> Any:
        name = f"encode_{self.params.fault}"
        if hasattr(self, name) and image[0, 0] == 2:
            return getattr(self, name)(image)
        self.last_shape = image.shape
        return self.coded(image)

    def coded(self, image: Image) -> bytes:
        return bytes([*image.shape, self.params.step]) + (image >> self.params.step).tobytes()

    def decode(self, bitstream: bytes, *, trace: Trace = NULL_TRACE) -> Any:
        height, width, step = bitstream[:3]
        image = np.frombuffer(bitstream[3:], np.uint8).reshape(height, width) << step
        name = f"decode_{self.params.fault}"
        return getattr(self, name)(image) if hasattr(self, name) and image[0, 0] == 2 else image

    def remark(self) -> Any:
        return 7 if self.params.fault == "remark" else "keeps little" if self.params.step > 5 else ""

    def encode_raise(self, image: Image) -> bytes:
        raise ZeroDivisionError("divided by\nnothing")

    def encode_full(self, image: Image) -> bytes:
        raise OSError(errno.ENOSPC, "no room for the codec's own files")

    def encode_exit(self, image: Image) -> bytes:
        sys.exit("leaving")

    def encode_leave(self, image: Image) -> bytes:
        os._exit(0)

    def encode_segfault(self, image: Image) -> bytes:
        return ctypes.string_at(0)

    def encode_abort(self, image: Image) -> bytes:
        os.abort()

    def encode_kill_parent(self, image: Image) -> bytes:
        os.kill(os.getppid(), signal.SIGKILL)
        time.sleep(300)
        return b"late"

    def encode_hang(self, image: Image) -> bytes:
        ctypes.PyDLL(None).sleep(300)
        return b"late"

    def encode_hog(self, image: Image) -> bytes:
        return np.ones(2 << 30, np.uint8).tobytes()

    def encode_leak(self, image: Image) -> bytes:
        _leaked.append(np.ones(200 << 20, np.uint8))
        return self.coded(image)

    def encode_drip(self, image: Image) -> bytes:
        while True:
            _leaked.append(np.ones(10 << 20, np.uint8))

    def encode_fork(self, image: Image) -> bytes:
        subprocess.Popen(["sleep", "300"])
        return self.coded(image)

    def encode_noise(self, image: Image) -> bytes:
        sys.stdout.write("noise\n" * 10000)
        os.write(1, b"more noise\n")
        return self.coded(image)

    def encode_scribble(self, image: Image) -> bytes:
        bitstream = self.coded(image)
        image[:] = 0
        return bitstream

    def encode_text(self, image: Image) -> Any:
        return "text"

    def encode_empty(self, image: Image) -> bytes:
        return b""

    def decode_misread(self, image: Image) -> Image:
        raise BitstreamError("no such marker")

    def decode_shape(self, image: Image) -> Image:
        return image[:-1]

    def decode_dtype(self, image: Image) -> Any:
        return image.astype(float)

    def decode_nan(self, image: Image) -> Any:
        return np.full(image.shape, np.nan, np.float32)

    def decode_nothing(self, image: Image) -> Any:
        return None

    def decode_jump(self, image: Image) -> Any:
        return ctypes.string_at(0)

    def decode_memory(self, image: Image) -> Image:
        return image.reshape(self.last_shape)


class Wandering(FrameEvaluator[FaultParams]):
    """Yields what it should not on frame 2."""

    name = "wandering"
    version = "1"
    params_type = FaultParams
    metrics = (Metric("error", "1", "lower", "mean absolute difference"), Metric("note", "1", "neither", "a note"))

    def evaluate(self, coded: CodedFrame) -> Iterator[Any]:
        error = float(np.abs(coded.original.image.astype(int) - coded.decoded).mean())
        coded.original.image[:] = 0
        if coded.original.index != 2 or self.params.fault == "none":
            yield Measurement("error", error)
            return
        match self.params.fault:
            case "nan":
                yield Measurement("error", float("nan"))
            case "reasoned_nan":
                yield Measurement("error", float("nan"), reason="cloudy")
            case "infinite":
                yield Measurement("error", float("inf"))
            case "undeclared":
                yield Measurement("surprise", 1.0)
            case "text":
                yield Measurement("error", "much")  # type: ignore[arg-type]
            case "bool":
                yield Measurement("error", True)
            case "tuple":
                yield ("error", 1.0)
            case "frame":
                yield Measurement("error", 1.0, frame=7)
            case "raise":
                raise KeyError("gone")
            case "sleep":
                time.sleep(300)


class Whole(SequenceEvaluator[FaultParams]):
    """Looks at all frames in order, and leaves an artifact."""

    name = "whole"
    version = "1"
    params_type = FaultParams
    metrics = (Metric("size_bytes", "bytes", "lower", "sum"), Metric("draw", "1", "neither", "a random number"))

    def evaluate(self, coded: CodedSequence, context: Context) -> Iterator[Measurement]:
        total = 0
        for one in coded:
            total += one.size_bytes
            if self.params.fault == "raise" and one.original.index == 2:
                raise RuntimeError("lost the thread")
        (context.artifacts / "total.txt").write_text(f"{total}\n")
        if self.params.fault == "folder":
            (context.artifacts / "nested").mkdir()
        if self.params.fault == "undeclared_plugin":
            context.plugins.create("codec", "faulty", {})
        yield Measurement("size_bytes", total)
        yield Measurement("draw", float(context.rng.random()))


class Alone(CodecEvaluator[NoParams]):
    """Exclusive; says when it ran."""

    name = "alone"
    version = "1"
    params_type = NoParams
    metrics = (
        Metric("begun_s", "s", "neither", "monotonic", repeatable=False),
        Metric("cores", "1", "neither", "pinned"),
    )
    exclusive = True
    repeats = 2  # type: ignore[assignment]

    def evaluate(self, codec: Codec[Any], sequence: FrameSequence, context: Context) -> Iterator[Measurement]:
        yield Measurement("begun_s", time.monotonic())
        yield Measurement("cores", len(os.sched_getaffinity(0)))


class Slow(FrameEvaluator[FaultParams]):
    """Takes a while a frame, so that there is something to interrupt."""

    name = "slow"
    version = "1"
    params_type = FaultParams
    metrics = (Metric("error", "1", "lower", "mean absolute difference"),)

    def evaluate(self, coded: CodedFrame) -> Iterator[Measurement]:
        time.sleep(0.01)
        yield Measurement("error", float(np.abs(coded.original.image.astype(int) - coded.decoded).mean()))


class Gated(FrameEvaluator[NoParams]):
    """Takes a file out of the folder that GATE names before it measures a sequence; where there is none, it hangs."""

    name = "gated"
    version = "1"
    params_type = NoParams
    metrics = (Metric("error", "1", "lower", "mean absolute difference"),)

    def evaluate(self, coded: CodedFrame) -> Iterator[Measurement]:
        if coded.original.index == 0:
            ticket = next(Path(os.environ["GATE"]).iterdir(), None)
            if ticket is None:
                time.sleep(3600)
            else:
                ticket.unlink()
        yield Measurement("error", 0.0)


_HERE = "fault_plugins:"


@hookimpl
def codecbench_datasets() -> list[PluginSpec]:
    return [PluginSpec("stack", _HERE + "Stack", "frames in one file")]


@hookimpl
def codecbench_codecs() -> list[PluginSpec]:
    return [PluginSpec("faulty", _HERE + "Faulty", "goes wrong as told")]


@hookimpl
def codecbench_evaluators() -> list[PluginSpec]:
    return [
        PluginSpec("wandering", _HERE + "Wandering", "yields what it should not"),
        PluginSpec("whole", _HERE + "Whole", "looks at all frames"),
        PluginSpec("alone", _HERE + "Alone", "runs alone"),
        PluginSpec("slow", _HERE + "Slow", "takes a while"),
        PluginSpec("gated", _HERE + "Gated", "waits to be let through"),
    ]
