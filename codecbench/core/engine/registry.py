"""Which plugins are installed, what they are called, and how a name becomes a class.

Listing imports hook modules only. A distribution that fails to import, misspells a hook or offers a name
that is taken is reported by name and version, and takes nobody down with it.
"""

from __future__ import annotations

import difflib
import functools
import importlib
import importlib.util
import inspect
import re
from collections.abc import Iterable
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from types import ModuleType
from typing import Any

import pluggy

from codecbench.core.contracts import hooks
from codecbench.core.contracts.errors import PluginError, Unsupported
from codecbench.core.contracts.hooks import KINDS, Kind, PluginSpec

_NAME = re.compile(r"[a-z][a-z0-9_]*")
_TARGET = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_]\w*")
_BASES: dict[Kind, tuple[str, str]] = {
    "codec": ("codecbench.core.contracts.codec", "Codec"),
    "evaluator": ("codecbench.core.contracts.evaluator", "Evaluator"),
    "dataset": ("codecbench.core.contracts.sequence", "Dataset"),
    "slam_backend": ("codecbench.core.contracts.slam", "SlamBackend"),
    "executor": ("codecbench.core.contracts.executor", "Executor"),
}


@dataclass(frozen=True)
class Plugin:
    """What a distribution offers: the specification of a plugin, and where it came from."""

    kind: Kind
    spec: PluginSpec
    distribution: str

    @property
    def missing(self) -> str | None:
        """Why this plugin cannot be used here and the command that mends it, or None. Imports nothing."""
        absent = [name for name in self.spec.requires if importlib.util.find_spec(name) is None]
        if not absent:
            return None
        command = f"pip install '{self.spec.extra}'" if self.spec.extra else f"pip install {' '.join(absent)}"
        return f"{self.kind} {self.spec.name} needs {', '.join(absent)}, which is not installed; run: {command}"


@dataclass(frozen=True)
class Problem:
    """A distribution's plugin that could not be taken, and why."""

    distribution: str
    entry_point: str
    reason: str

    def __str__(self) -> str:
        return f"{self.distribution} (entry point {self.entry_point}): {self.reason}"


class Registry:
    """All plugins that were found, by kind and name; `problems` lists those that were not taken."""

    def __init__(self, points: Iterable[EntryPoint]) -> None:
        self.problems: list[Problem] = []
        self._plugins: dict[tuple[Kind, str], Plugin] = {}
        for point in sorted(points, key=_own_first):
            self._admit(point)

    def plugins(self, kind: Kind) -> list[Plugin]:
        """Plugins of a kind in the order in which they were offered."""
        return [plugin for (of_kind, _), plugin in self._plugins.items() if of_kind == kind]

    def find(self, kind: Kind, name: str) -> Plugin:
        """The plugin of that name. Raises PluginError with the nearest names where there is none."""
        plugin = self._plugins.get((kind, name))
        if plugin is None:
            raise PluginError(f"no {_words(kind)} is called {name!r}; {self.suggestion(kind, name)}")
        return plugin

    def suggestion(self, kind: Kind, name: str) -> str:
        """What the writer of an unknown name may have meant."""
        names = [plugin.spec.name for plugin in self.plugins(kind)]
        near = difflib.get_close_matches(name, names, n=1)
        meant = f"did you mean {near[0]!r}? " if near else ""
        return f"{meant}installed: {', '.join(names) or 'none'}"

    def load(self, kind: Kind, name: str) -> Any:
        """The class behind a name, imported now.

        Raises PluginError where there is no such plugin, its module fails to import or it breaks the
        contract, and Unsupported, with the command that mends it, where it needs something not installed.
        """
        plugin = self.find(kind, name)
        if (missing := plugin.missing) is not None:
            raise Unsupported(missing)
        return _load(plugin)

    def create(self, kind: Kind, name: str, params: dict[str, Any]) -> Any:
        """An instance with these parameters, which are validated (pydantic.ValidationError)."""
        cls = self.load(kind, name)
        return cls(cls.params_type.model_validate(params))

    def _admit(self, point: EntryPoint) -> None:
        origin = f"{point.dist.name} {point.dist.version}" if point.dist else point.value
        try:
            module = importlib.import_module(point.module)
        except Exception as error:  # noqa: BLE001 - a stranger's module may raise anything
            self._report(origin, point, f"{point.module} does not import: {type(error).__name__}: {error}")
            return
        manager = pluggy.PluginManager(hooks.GROUP)
        manager.add_hookspecs(hooks)
        manager.register(module)
        found = False
        for kind in KINDS:
            found |= self._admit_kind(manager, kind, origin, point)
        known = {f"codecbench_{kind}s" for kind in KINDS}
        for name in sorted(_hook_names(module) - known):
            near = difflib.get_close_matches(name, known, n=1)
            meant = f"; did you mean {near[0]}?" if near else ""
            self._report(origin, point, f"{point.module} implements {name}, which is not a hook{meant}")
            found = True
        if not found:
            self._report(origin, point, f"{point.module} implements no hook; known: {', '.join(sorted(known))}")

    def _admit_kind(self, manager: pluggy.PluginManager, kind: Kind, origin: str, point: EntryPoint) -> bool:
        hook = getattr(manager.hook, f"codecbench_{kind}s")
        try:
            answers = hook()
        except Exception as error:  # noqa: BLE001 - a stranger's hook may raise anything
            self._report(origin, point, f"codecbench_{kind}s failed: {type(error).__name__}: {error}")
            return True
        for specs in answers:
            for spec in specs if isinstance(specs, list | tuple) else [specs]:
                self._admit_spec(kind, spec, origin, point)
        return bool(hook.get_hookimpls())

    def _admit_spec(self, kind: Kind, spec: object, origin: str, point: EntryPoint) -> None:
        if not isinstance(spec, PluginSpec):
            self._report(origin, point, f"codecbench_{kind}s returned {spec!r}; it returns a list of PluginSpec")
        elif not _NAME.fullmatch(spec.name):
            self._report(origin, point, f"{kind} name {spec.name!r} is not of the form [a-z][a-z0-9_]*")
        elif not _TARGET.fullmatch(spec.target):
            self._report(origin, point, f"{kind} {spec.name}: target {spec.target!r} is not package.module:Class")
        elif (kind, spec.name) in self._plugins:
            owner = self._plugins[kind, spec.name].distribution
            self._report(origin, point, f"{kind} {spec.name!r} is already offered by {owner}; left out")
        else:
            self._plugins[kind, spec.name] = Plugin(kind, spec, origin)

    def _report(self, origin: str, point: EntryPoint, reason: str) -> None:
        self.problems.append(Problem(origin, point.name, reason))


@functools.cache
def installed() -> Registry:
    """The registry of everything installed, read once a process."""
    return Registry(entry_points(group=hooks.GROUP))


def _load(plugin: Plugin) -> Any:
    module_name, _, class_name = plugin.spec.target.partition(":")
    where = f"{_words(plugin.kind)} {plugin.spec.name} of {plugin.distribution}"
    try:
        module = importlib.import_module(module_name)
    except Unsupported:
        raise
    except Exception as error:
        raise PluginError(f"{where}: {module_name} does not import: {type(error).__name__}: {error}") from error
    cls: Any = getattr(module, class_name, None)
    base_module, base_name = _BASES[plugin.kind]
    base = getattr(importlib.import_module(base_module), base_name)
    if not hasattr(module, class_name):
        near = difflib.get_close_matches(class_name, vars(module), n=1)
        meant = f"; did you mean {near[0]}?" if near else ""
        raise PluginError(f"{where}: {module_name} has no {class_name}{meant}")
    if not isinstance(cls, type) or not issubclass(cls, base):
        raise PluginError(f"{where}: {plugin.spec.target} is not a subclass of codecbench.{base_name}")
    name = getattr(cls, "name", None)
    if name != plugin.spec.name:
        raise PluginError(f"{where}: {plugin.spec.target} calls itself {name!r}")
    for attribute in dict.fromkeys(name for ancestor in base.__mro__ for name in inspect.get_annotations(ancestor)):
        if not hasattr(cls, attribute):
            raise PluginError(f"{where}: {plugin.spec.target} has no class attribute {attribute!r}")
    if left := sorted(getattr(cls, "__abstractmethods__", ())):
        raise PluginError(f"{where}: {plugin.spec.target} does not define {', '.join(left)}")
    return cls


def _hook_names(module: ModuleType) -> set[str]:
    return {
        name
        for name, value in vars(module).items()
        if name.startswith(f"{hooks.GROUP}_") and hasattr(value, f"{hooks.GROUP}_impl")
    }


def _own_first(point: EntryPoint) -> tuple[bool, str, str]:
    """Codecbench's own plugins come first, so that nobody can take one of their names."""
    distribution = point.dist.name if point.dist else ""
    return (distribution != "codecbench", distribution, point.name)


def _words(kind: Kind) -> str:
    return kind.replace("_", " ")
