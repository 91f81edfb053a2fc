"""A benchmark of codecs by what they do to the task that uses the images.

The names below are loaded at their first use, so that importing codecbench is quick.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any
from warnings import warn

if TYPE_CHECKING:
    from codecbench.core.analysis.run_result import RunResult
    from codecbench.core.analysis.verification import verify_run
    from codecbench.core.contracts.codec import (
        AnyCodec,
        Capabilities,
        Codec,
        FeatureCodec,
        Fragment,
        PartialImage,
        StreamCodec,
        decoder_of,
        encoder_of,
    )
    from codecbench.core.contracts.errors import (
        BitstreamError,
        CodecbenchError,
        DatasetError,
        ImageError,
        KeyCollision,
        MatrixError,
        ParamsError,
        PluginError,
        SlamError,
        StoreError,
        Unsupported,
    )
    from codecbench.core.contracts.evaluator import (
        CodecEvaluator,
        CodedFrame,
        CodedSequence,
        Context,
        Evaluator,
        FrameEvaluator,
        FrameSender,
        Measurement,
        Outcome,
        PluginUse,
        SentPacket,
        SequenceEvaluator,
    )
    from codecbench.core.contracts.executor import Executor, Finished, Task
    from codecbench.core.contracts.features import FeatureDecoder, FeatureEncoder, FeatureFrame, Features, FeatureSet
    from codecbench.core.contracts.hooks import PluginSpec, hookimpl
    from codecbench.core.contracts.image import Image, Layout, check_image, gray_from_image
    from codecbench.core.contracts.link import Channel, Link, Passage, Queue
    from codecbench.core.contracts.metric import Metric
    from codecbench.core.contracts.params import NoParams, Params, PathParam
    from codecbench.core.contracts.recipe import Recipe, Scene
    from codecbench.core.contracts.sequence import Camera, Dataset, Depth, Frame, FrameSequence, Origin, Trajectory
    from codecbench.core.contracts.slam import LoopEvent, SlamBackend, SlamRun, TrackedFrame
    from codecbench.core.contracts.stream import LOST, Loss, Packet, Picture, StreamDecoder, StreamEncoder
    from codecbench.core.contracts.view import Drawing, FrameTimeline, KeypointOverlay, Line, TimelineRow, View
    from codecbench.core.counting.kernel import kernel
    from codecbench.core.counting.trace import NULL_TRACE, Trace
    from codecbench.core.engine.planning.description import codec
    from codecbench.core.facade import Run, bundle, open_bundle, open_run, run
    from codecbench.trial.choosing import choose
    from codecbench.trial.trial import trial

__version__ = "0.1.0"

_CONTRACTS = "codecbench.core.contracts."
_HOMES = {
    _CONTRACTS + "codec": (
        "AnyCodec", "Capabilities", "Codec", "FeatureCodec", "Fragment", "PartialImage", "StreamCodec", "decoder_of",
        "encoder_of",
    ),
    _CONTRACTS + "errors": (
        "BitstreamError", "CodecbenchError", "DatasetError", "ImageError", "KeyCollision", "MatrixError",
        "ParamsError", "PluginError", "SlamError", "StoreError", "Unsupported",
    ),
    _CONTRACTS + "evaluator": (
        "CodecEvaluator", "CodedFrame", "CodedSequence", "Context", "Evaluator", "FrameEvaluator",
        "FrameSender", "Measurement", "Outcome", "PluginUse", "SentPacket", "SequenceEvaluator",
    ),
    _CONTRACTS + "executor": ("Executor", "Finished", "Task"),
    _CONTRACTS + "features": (
        "FeatureDecoder", "FeatureEncoder", "FeatureFrame", "Features", "FeatureSet",
    ),
    _CONTRACTS + "hooks": ("PluginSpec", "hookimpl"),
    _CONTRACTS + "image": ("Image", "Layout", "check_image", "gray_from_image"),
    _CONTRACTS + "link": ("Channel", "Link", "Passage", "Queue"),
    _CONTRACTS + "metric": ("Metric",),
    _CONTRACTS + "params": ("NoParams", "Params", "PathParam"),
    _CONTRACTS + "recipe": ("Recipe", "Scene"),
    _CONTRACTS + "sequence": ("Camera", "Dataset", "Depth", "Frame", "FrameSequence", "Origin", "Trajectory"),
    _CONTRACTS + "slam": ("LoopEvent", "SlamBackend", "SlamRun", "TrackedFrame"),
    _CONTRACTS + "stream": ("LOST", "Loss", "Packet", "Picture", "StreamDecoder", "StreamEncoder"),
    _CONTRACTS + "view": ("Drawing", "FrameTimeline", "KeypointOverlay", "Line", "TimelineRow", "View"),
    "codecbench.core.counting.kernel": ("kernel",),
    "codecbench.core.counting.trace": ("NULL_TRACE", "Trace"),
    "codecbench.core.facade": ("Run", "bundle", "open_bundle", "open_run", "run"),
    "codecbench.core.engine.planning.description": ("codec",),
    "codecbench.core.analysis.run_result": ("RunResult",),
    "codecbench.trial.choosing": ("choose",),
    "codecbench.trial.trial": ("trial",),
    "codecbench.core.analysis.verification": ("verify_run",),
}  # fmt: skip
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

__all__ = sorted(_HOME_OF)


def __dir__() -> list[str]:
    """Return the public names, without modules that happen to be loaded."""
    return [*__all__, "__version__"]


_RENAMED = {"Course": "FrameTimeline", "Lane": "TimelineRow", "Marks": "KeypointOverlay"}


def __getattr__(name: str) -> Any:
    if name in _RENAMED:
        warn(f"codecbench.{name} is now called codecbench.{_RENAMED[name]}", DeprecationWarning, stacklevel=2)
        return __getattr__(_RENAMED[name])
    if name not in _HOME_OF:
        raise AttributeError(f"module 'codecbench' has no attribute {name!r}")
    value = getattr(import_module(_HOME_OF[name]), name)
    globals()[name] = value
    return value
