"""The door through which plugins come in.

A distribution names a module under the entry point group `codecbench`; the module implements one or more
of the hooks below; each returns PluginSpecs, which are references. Nothing heavy is imported until a cell
needs it, so `codecbench list` stays fast and one broken plugin harms no other.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import pluggy

GROUP = "codecbench"

Kind = Literal["codec", "evaluator", "dataset", "slam_backend", "executor", "link"]
KINDS: tuple[Kind, ...] = get_args(Kind)

hookspec = pluggy.HookspecMarker(GROUP)
hookimpl = pluggy.HookimplMarker(GROUP)


@dataclass(frozen=True)
class PluginSpec:
    """A plugin that a distribution offers.

    name: as used in a matrix, `[a-z][a-z0-9_]*`. target: `package.module:Class`. summary: one line.
    requires: modules that must be importable, beyond codecbench's own. extra: what to install for them,
    as given to pip (`codecbench[codecs]`).
    """

    name: str
    target: str
    summary: str
    requires: tuple[str, ...] = ()
    extra: str = ""


@hookspec
def codecbench_codecs() -> list[PluginSpec]:  # type: ignore[empty-body]
    """Codecs: subclasses of `codecbench.Codec`, of `codecbench.StreamCodec` for those with memory, or of
    `codecbench.FeatureCodec` for those of features."""


@hookspec
def codecbench_evaluators() -> list[PluginSpec]:  # type: ignore[empty-body]
    """Evaluators: subclasses of FrameEvaluator, SequenceEvaluator or CodecEvaluator."""


@hookspec
def codecbench_datasets() -> list[PluginSpec]:  # type: ignore[empty-body]
    """Datasets: subclasses of `codecbench.Dataset`."""


@hookspec
def codecbench_slam_backends() -> list[PluginSpec]:  # type: ignore[empty-body]
    """SLAM backends: subclasses of `codecbench.SlamBackend`."""


@hookspec
def codecbench_executors() -> list[PluginSpec]:  # type: ignore[empty-body]
    """Executors: subclasses of `codecbench.Executor`."""


@hookspec
def codecbench_links() -> list[PluginSpec]:  # type: ignore[empty-body]
    """Links: subclasses of `codecbench.Link`."""
