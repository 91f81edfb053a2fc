"""Hooks by which distributions register plugins.

A distribution names a module under the entry point group `codecbench`. The module implements one or more of the hooks
below. Each returns PluginSpecs, which are references: nothing heavy is imported until a cell needs it, so
`codecbench list` stays fast and a broken plugin harms no other.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import pluggy

GROUP = "codecbench"
"""Entry point group of plugins."""

Kind = Literal["codec", "evaluator", "dataset", "slam_backend", "executor", "link"]
KINDS: tuple[Kind, ...] = get_args(Kind)

hookspec = pluggy.HookspecMarker(GROUP)
hookimpl = pluggy.HookimplMarker(GROUP)


@dataclass(frozen=True)
class PluginSpec:
    """A reference to a plugin that a distribution offers."""

    name: str
    """As in matrix files: `[a-z][a-z0-9_]*`."""
    target: str
    """`package.module:Class`."""
    summary: str
    """One line for lists of plugins."""
    requires: tuple[str, ...] = ()
    """Modules that must be importable, beyond codecbench's own dependencies."""
    extra: str = ""
    """What to install for them, as given to pip (`codecbench[codecs]`)."""


@hookspec
def codecbench_codecs() -> list[PluginSpec]:  # type: ignore[empty-body]
    """Return codecs: subclasses of `codecbench.Codec`, `codecbench.StreamCodec` or `codecbench.FeatureCodec`."""


@hookspec
def codecbench_evaluators() -> list[PluginSpec]:  # type: ignore[empty-body]
    """Return evaluators: subclasses of FrameEvaluator, SequenceEvaluator or CodecEvaluator."""


@hookspec
def codecbench_datasets() -> list[PluginSpec]:  # type: ignore[empty-body]
    """Return datasets: subclasses of `codecbench.Dataset`."""


@hookspec
def codecbench_slam_backends() -> list[PluginSpec]:  # type: ignore[empty-body]
    """Return SLAM backends: subclasses of `codecbench.SlamBackend`."""


@hookspec
def codecbench_executors() -> list[PluginSpec]:  # type: ignore[empty-body]
    """Return executors: subclasses of `codecbench.Executor`."""


@hookspec
def codecbench_links() -> list[PluginSpec]:  # type: ignore[empty-body]
    """Return links: subclasses of `codecbench.Link`."""
