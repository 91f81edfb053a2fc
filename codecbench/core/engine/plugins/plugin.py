"""A plugin as the registry stores it, the problem of one that was rejected, and the loading of plugin classes."""

from __future__ import annotations

import difflib
import functools
import importlib.metadata
import importlib.util
import inspect
import re
from contextlib import suppress
from dataclasses import dataclass
from importlib.machinery import ModuleSpec, PathFinder
from typing import TYPE_CHECKING, Any, Final

from codecbench.core.contracts.errors import PluginError, Unsupported
from codecbench.core.contracts.hooks import Kind, PluginSpec
from codecbench.core.engine.text import describe_error

if TYPE_CHECKING:
    from packaging.requirements import Requirement

OURS = "codecbench"
"""The distribution whose plugins ship with the program."""

_NAME: Final = re.compile(r"[a-z][a-z0-9_]*")
_LONGEST_NAME: Final = 100
_TARGET: Final = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*")


@dataclass(frozen=True)
class Plugin:
    """What a distribution offers: the specification of a plugin, and its origin."""

    kind: Kind
    spec: PluginSpec
    distribution: str
    """With its version."""
    hosted: bool = False
    """Whether it is imported in a host process."""

    @property
    def foreign(self) -> str:
        """The distribution with its version; empty for codecbench's own plugins."""
        return "" if self.distribution.startswith(f"{OURS} ") else self.distribution

    @property
    def title(self) -> str:
        """The plugin and its distribution, for messages."""
        return f"{kind_title(self.kind)} {self.spec.name} of {self.distribution}"

    @property
    def missing(self) -> str | None:
        """Why the plugin cannot be used here, with the command that installs it, or None. Imports nothing."""
        prefix = f"{self.kind} {self.spec.name} needs"
        not_installed = [name for name in self.spec.requires if module_spec(name) is None]
        if not_installed:
            command = (
                f"pip install '{self.spec.extra}'" if self.spec.extra else f"pip install {' '.join(not_installed)}"
            )
            return f"{prefix} {', '.join(not_installed)}, which is not installed; run: {command}"
        unmet = _unmet_requirements(self.distribution.partition(" ")[0], self.spec.requires)
        if not unmet:
            return None
        return f"{prefix} {' and '.join(unmet)}; run: pip install --upgrade '{self.spec.extra or unmet[0].split()[0]}'"


@dataclass(frozen=True)
class Problem:
    """A plugin of a distribution that was rejected, and why."""

    distribution: str
    entry_point: str
    reason: str
    nameless: bool = False
    """Whether the plugin's name is unknown, because its module never gave it."""

    def __str__(self) -> str:
        return f"{self.distribution} (entry point {self.entry_point}): {self.reason}"


def _unmet_requirements(distribution: str, libraries: tuple[str, ...]) -> list[str]:
    """Return those libraries whose installed version does not meet the distribution's metadata."""
    unmet = []
    with suppress(importlib.metadata.PackageNotFoundError):  # without metadata there are no requirements
        for requirement in _requirements(distribution) if libraries else ():
            if requirement.name.replace("-", "_") in libraries:
                version = _version(requirement.name)
                if not requirement.specifier.contains(version, prereleases=True):
                    unmet.append(f"{requirement.name} {requirement.specifier}, but {version} is installed")
    return unmet


@functools.cache
def _requirements(distribution: str) -> tuple[Requirement, ...]:
    from packaging.requirements import Requirement  # slow, and `codecbench list` rarely needs it

    return tuple(map(Requirement, importlib.metadata.requires(distribution) or ()))


_version: Final = functools.cache(importlib.metadata.version)
"""Returns the version of an installed library; cached, because it parses a file."""


def kind_title(kind: Kind) -> str:
    """Return a kind of plugin for messages: `slam_backend` is "slam backend"."""
    return kind.replace("_", " ")


def fault_of(kind: Kind, spec: PluginSpec) -> str | None:
    """Return what makes a specification unusable, or None."""
    if not (isinstance(spec.name, str) and _NAME.fullmatch(spec.name) and len(spec.name) <= _LONGEST_NAME):
        name = f"{kind} name {spec.name!r:.120}"
        return f"{name} is not of the form [a-z][a-z0-9_]*, of at most {_LONGEST_NAME} characters"
    if not (isinstance(spec.target, str) and _TARGET.fullmatch(spec.target)):
        return f"{kind} {spec.name}: target {spec.target!r} is not package.module:Class"
    for field in ("summary", "extra"):
        if not isinstance(getattr(spec, field), str):
            return f"{kind} {spec.name}: {field} is {getattr(spec, field)!r}; it must be text"
    if not isinstance(spec.requires, list | tuple) or not all(isinstance(name, str) for name in spec.requires):
        return f"{kind} {spec.name}: requires is {spec.requires!r}; it must be a tuple of module names"
    return None


def module_spec(module: str, *, to_first_file: bool = False) -> ModuleSpec | None:
    """Return how a module would be imported, or None; not even its parent packages are imported.

    to_first_file: return the spec of the topmost parent that is no namespace package.
    """
    parts = module.split(".")
    with suppress(ImportError, ValueError, AttributeError):
        spec = importlib.util.find_spec(parts[0])
        for depth in range(2, len(parts) + 1):
            if spec is None or (to_first_file and spec.origin is not None):
                break
            spec = PathFinder.find_spec(".".join(parts[:depth]), list(spec.submodule_search_locations or ()))
        return spec
    return None


_BASES: Final[dict[Kind, tuple[str, ...]]] = {
    "codec": ("codec:Codec", "codec:StreamCodec", "codec:FeatureCodec"),
    "evaluator": ("evaluator:Evaluator",),
    "dataset": ("sequence:Dataset",),
    "slam_backend": ("slam:SlamBackend",),
    "executor": ("executor:Executor",),
    "link": ("link:Link",),
}
"""Base classes in codecbench.core.contracts; a plugin subclasses one of those of its kind."""


def load_class(kind: Kind, spec: PluginSpec, title: str) -> Any:
    """Import a plugin's class into this process. title: how messages name the plugin.

    Raises PluginError if its module fails to import or it violates its contract, and Unsupported if its module does.
    """
    module_name, _, class_name = spec.target.partition(":")
    try:
        module = importlib.import_module(module_name)
    except Unsupported:
        raise
    except Exception as error:
        raise PluginError(f"{title}: {module_name} does not import: {describe_error(error)}") from error
    cls: Any = getattr(module, class_name, None)
    if not hasattr(module, class_name):
        nearest = difflib.get_close_matches(class_name, vars(module), n=1)
        hint = f"; did you mean {nearest[0]}?" if nearest else ""
        raise PluginError(f"{title}: {module_name} has no {class_name}{hint}")
    bases = _bases(kind)
    base = next((base for base in bases if isinstance(cls, type) and issubclass(cls, base)), None)
    if base is None:
        allowed = " or ".join(f"codecbench.{base.__name__}" for base in bases)
        raise PluginError(f"{title}: {spec.target} is not a subclass of {allowed}")
    name = getattr(cls, "name", None)
    if name != spec.name:
        raise PluginError(f"{title}: {spec.target} has the name {name!r}, not {spec.name!r}")
    for attribute in dict.fromkeys(name for ancestor in base.__mro__ for name in inspect.get_annotations(ancestor)):
        if not hasattr(cls, attribute):
            raise PluginError(f"{title}: {spec.target} has no class attribute {attribute!r}")
    if undefined := sorted(getattr(cls, "__abstractmethods__", ())):
        raise PluginError(f"{title}: {spec.target} does not define {', '.join(undefined)}")
    return cls


def _bases(kind: Kind) -> list[type]:
    places = (place.split(":") for place in _BASES[kind])
    return [getattr(importlib.import_module(f"codecbench.core.contracts.{module}"), name) for module, name in places]
