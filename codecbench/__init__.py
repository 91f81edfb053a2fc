"""A benchmark of codecs by what they do to the task that uses the images.

The names below are loaded when they are first used, so that importing codecbench costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any
from warnings import warn

if TYPE_CHECKING:
    from codecbench.core.contracts.codec import Capabilities, Codec
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
        Measurement,
        Outcome,
        PluginUse,
        SequenceEvaluator,
    )
    from codecbench.core.contracts.executor import Executor, Finished, Task
    from codecbench.core.contracts.hooks import PluginSpec, hookimpl
    from codecbench.core.contracts.image import Image, check_image, gray_from_image
    from codecbench.core.contracts.metric import Metric
    from codecbench.core.contracts.params import NoParams, Params, PathParam
    from codecbench.core.contracts.sequence import Camera, Dataset, Frame, Sequence, Trajectory
    from codecbench.core.contracts.slam import LoopEvent, SlamBackend, SlamRun, TrackedFrame
    from codecbench.core.contracts.view import Drawing, Line, View
    from codecbench.core.counting.kernel import kernel
    from codecbench.core.counting.trace import NULL_TRACE, Trace
    from codecbench.core.results.collect import open_run
    from codecbench.core.results.running import run

__version__ = "0.1.0"

_CONTRACTS = "codecbench.core.contracts."
_HOMES = {
    _CONTRACTS + "codec": ("Capabilities", "Codec"),
    _CONTRACTS + "errors": (
        "BitstreamError", "CodecbenchError", "DatasetError", "ImageError", "KeyCollision", "MatrixError",
        "ParamsError", "PluginError", "SlamError", "StoreError", "Unsupported",
    ),
    _CONTRACTS + "evaluator": (
        "CodecEvaluator", "CodedFrame", "CodedSequence", "Context", "Evaluator", "FrameEvaluator",
        "Measurement", "Outcome", "PluginUse", "SequenceEvaluator",
    ),
    _CONTRACTS + "executor": ("Executor", "Finished", "Task"),
    _CONTRACTS + "hooks": ("PluginSpec", "hookimpl"),
    _CONTRACTS + "image": ("Image", "check_image", "gray_from_image"),
    _CONTRACTS + "metric": ("Metric",),
    _CONTRACTS + "params": ("NoParams", "Params", "PathParam"),
    _CONTRACTS + "sequence": ("Camera", "Dataset", "Frame", "Sequence", "Trajectory"),
    _CONTRACTS + "slam": ("LoopEvent", "SlamBackend", "SlamRun", "TrackedFrame"),
    _CONTRACTS + "view": ("Drawing", "Line", "View"),
    "codecbench.core.counting.kernel": ("kernel",),
    "codecbench.core.counting.trace": ("NULL_TRACE", "Trace"),
    "codecbench.core.results.collect": ("open_run",),
    "codecbench.core.results.running": ("run",),
}  # fmt: skip
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

__all__ = sorted(_HOME_OF)


_RENAMED = {"Offer": "PluginSpec"}


def __getattr__(name: str) -> Any:
    if name in _RENAMED:
        warn(f"codecbench.{name} is now called codecbench.{_RENAMED[name]}", DeprecationWarning, stacklevel=2)
        return __getattr__(_RENAMED[name])
    if name not in _HOME_OF:
        raise AttributeError(f"module 'codecbench' has no attribute {name!r}")
    value = getattr(import_module(_HOME_OF[name]), name)
    globals()[name] = value
    return value
