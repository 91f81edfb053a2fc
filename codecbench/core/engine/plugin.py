"""A plugin as the registry knows it, and what is wrong with one that it could not take."""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass

from codecbench.core.contracts.hooks import Kind, PluginSpec

OURS = "codecbench"
"""The distribution whose plugins ship with the program."""


@dataclass(frozen=True)
class Plugin:
    """What a distribution offers: the specification of a plugin, and where it came from.

    hosted: it is imported in a host process. absent: what it needs and is not installed, as its host found.
    """

    kind: Kind
    spec: PluginSpec
    distribution: str
    hosted: bool = False
    absent: str | None = None

    @property
    def company(self) -> str:
        """Its distribution with its version; empty for codecbench's own plugins."""
        return "" if self.distribution.startswith(f"{OURS} ") else self.distribution

    @property
    def title(self) -> str:
        """The plugin and its distribution, as messages name them."""
        return f"{spoken(self.kind)} {self.spec.name} of {self.distribution}"

    @property
    def missing(self) -> str | None:
        """Why this plugin cannot be used here and the command that installs it, or None. Imports nothing of its own."""
        if self.hosted:
            return self.absent
        absent = [name for name in self.spec.requires if importlib.util.find_spec(name) is None]
        if not absent:
            return None
        command = f"pip install '{self.spec.extra}'" if self.spec.extra else f"pip install {' '.join(absent)}"
        return f"{self.kind} {self.spec.name} needs {', '.join(absent)}, which is not installed; run: {command}"


@dataclass(frozen=True)
class Problem:
    """A distribution's plugin that could not be taken, and why.

    nameless: nobody knows what it would have been called, because its module never said.
    """

    distribution: str
    entry_point: str
    reason: str
    nameless: bool = False

    def __str__(self) -> str:
        return f"{self.distribution} (entry point {self.entry_point}): {self.reason}"


def spoken(kind: Kind) -> str:
    """A kind of plugin as messages name it: `slam_backend` is "slam backend"."""
    return kind.replace("_", " ")
