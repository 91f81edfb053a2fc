"""Which plugins are installed, what they are called, and how a name becomes a class.

Listing imports hook modules only, and those of other distributions than codecbench's in host processes. A
distribution that fails to import, exits, hangs, misspells a hook or offers a name that is taken is reported by name and
version, and takes nobody down with it.
"""

from __future__ import annotations

import difflib
import functools
import importlib
import os
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib.metadata import EntryPoint
from types import MappingProxyType, ModuleType
from typing import Any

import pluggy

from codecbench.core.contracts import hooks
from codecbench.core.contracts.errors import PluginError, Unsupported
from codecbench.core.contracts.hooks import KINDS, Kind, PluginSpec
from codecbench.core.engine.hosting.confinement import paths_in
from codecbench.core.engine.hosting.host import (
    HOSTED_VARIABLE,
    Host,
    PluginFault,
    PluginLoss,
    PluginTimeout,
)
from codecbench.core.engine.plugins.entry_points import origin_of, own_plugins_first, points_by_origin
from codecbench.core.engine.plugins.offers import Offers, ask_offers, cached_offers
from codecbench.core.engine.plugins.plugin import OURS, Plugin, Problem, fault_of, kind_title, load_class
from codecbench.core.engine.text import describe_error

_CALLED = "codecbench.core.engine.plugins.serving:call_function"
_AT_ONCE = os.cpu_count() or 1
"""So many distributions are asked at once what they offer."""
_MOST_PLUGINS = 1000
"""Of one kind from one hook."""
_MOST_LOSSES = 3
"""A plugin that has ended so many hosts, or kept one waiting for too long, is not asked again."""


class Registry:
    """All plugins that were found, by kind and name; `problems` lists those that were not taken.

    points: imported in this process. hosted: those of other distributions, whose plugins are imported in hosts.
    """

    def __init__(
        self, points: Iterable[EntryPoint], hosted: Mapping[str, list[EntryPoint]] = MappingProxyType({})
    ) -> None:
        self.problems: list[Problem] = []
        self.told: dict[str, Any] = {}
        """What hosted plugins said of settings, see `planning.describe`."""
        self._plugins: dict[tuple[Kind, str], Plugin] = {}
        self._entry_points: dict[tuple[Kind, str], str] = {}
        self._classes: dict[tuple[Kind, str], Any] = {}
        self._losses: Counter[str] = Counter()
        self._given_up: dict[str, str] = {}
        self._hosts = {origin: Host(origin) for origin in hosted}
        known = {origin: cached_offers(origin, hosted[origin]) for origin in sorted(hosted)}
        asked = [self._hosts[origin] for origin, offers in known.items() if offers is None]
        for host in asked[:_AT_ONCE]:
            host.start()  # while our own are read
        for point in sorted(points, key=own_plugins_first):
            self._admit(point)
        if asked:
            from concurrent.futures import ThreadPoolExecutor  # which takes some milliseconds

            with ThreadPoolExecutor(_AT_ONCE) as pool:
                answers = pool.map(lambda host: ask_offers(host, hosted[host.distribution]), asked)
                known |= zip((host.distribution for host in asked), answers, strict=True)
        for offers in filter(None, known.values()):
            self._admit_hosted(offers)
        for origin in self._hosts.keys() - {plugin.distribution for plugin in self._plugins.values()}:
            self._hosts.pop(origin).end()

    def plugins(self, kind: Kind) -> list[Plugin]:
        """Plugins of a kind in the order in which they were offered."""
        return [plugin for (of_kind, _), plugin in self._plugins.items() if of_kind == kind]

    def find(self, kind: Kind, name: str) -> Plugin:
        """The plugin of that name. Raises PluginError with the nearest names where there is none."""
        plugin = self._plugins.get((kind, name))
        if plugin is None:
            raise PluginError(f"no {kind_title(kind)} is called {name!r}; {self.suggestion(kind, name)}")
        return plugin

    def maybe_broken(self, kind: Kind, name: str) -> str | None:
        """Why a name is unknown that may be of a distribution which never said its names; None for any other name."""
        nameless = [str(problem) for problem in self.problems if problem.nameless]
        names = [plugin.spec.name for plugin in self.plugins(kind)]
        if not nameless or difflib.get_close_matches(name, names, n=1):
            return None
        return f"no {kind_title(kind)} is called {name!r}; it may be of {'; or of '.join(nameless)}"

    def suggestion(self, kind: Kind, name: str) -> str:
        """What the writer of an unknown name may have meant."""
        names = [plugin.spec.name for plugin in self.plugins(kind)]
        near = difflib.get_close_matches(name, names, n=1)
        meant = f"did you mean {near[0]!r}? " if near else ""
        return f"{meant}installed: {', '.join(names) or 'none'}"

    def load(self, kind: Kind, name: str) -> Any:
        """The class behind a name, imported into this process now; see `ask` for what other distributions offer.

        Raises PluginError where there is no such plugin, its module fails to import or it breaks the
        contract, and Unsupported, with the command that mends it, where it needs something not installed.
        """
        plugin = self.find(kind, name)
        if (missing := plugin.missing) is not None:
            raise Unsupported(missing)
        if (kind, name) not in self._classes:
            self._classes[kind, name] = load_class(kind, plugin.spec, plugin.title)
        return self._classes[kind, name]

    def create(self, kind: Kind, name: str, params: dict[str, Any]) -> Any:
        """An instance with these parameters, which are validated (pydantic.ValidationError)."""
        cls = self.load(kind, name)
        return cls(cls.params_type.model_validate(params))

    def entry_point(self, plugin: Plugin) -> str:
        """The name of the entry point that offered a plugin."""
        return self._entry_points[plugin.kind, plugin.spec.name]

    def ask(
        self, function: Callable[..., Any], *arguments: Any, of: Sequence[tuple[Kind, str]], times: float = 1
    ) -> Any:
        """What `function(registry, *arguments)` returns of this plugin: JSON types.

        Where it is of another distribution it is called in a host process and may take `times` the usual limit.
        Raises what the function raises, and PluginFault, which names the plugin, where a hosted one fails otherwise.
        """
        ((kind, name),) = of
        plugin = self.find(kind, name)
        if not plugin.hosted:
            return function(self, *arguments)
        title = plugin.title
        if title in self._given_up:
            raise PluginFault(self._given_up[title])
        asked = f"{function.__module__}:{function.__qualname__}"
        try:
            shows = paths_in(arguments) if kind == "dataset" else ()
            return self._hosts[plugin.distribution].ask(_CALLED, asked, *arguments, times=times, shows=shows)
        except PluginFault as fault:
            text = str(fault)
            message = " ".join((text if title in text else f"{title}: {text}").split())
            if isinstance(fault, PluginLoss):
                self._losses[title] += _MOST_LOSSES if isinstance(fault, PluginTimeout) else 1
            if self._losses[title] >= _MOST_LOSSES:
                self._given_up[title] = message
            raise PluginFault(message) from fault

    def _admit_hosted(self, offers: Offers) -> None:
        self.problems += offers.problems
        for plugin, entry_point in offers.plugins:
            self._take(plugin, entry_point)

    def _admit(self, point: EntryPoint) -> None:
        origin = origin_of(point)
        try:
            module = importlib.import_module(point.module)
        except Exception as error:  # noqa: BLE001 - a stranger's module may raise anything
            reason = f"{point.module} does not import: {describe_error(error)}"
            self._report(origin, point, reason, nameless=True)
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
            self._report(origin, point, f"codecbench_{kind}s failed: {describe_error(error)}", nameless=True)
            return True
        for answer in answers:
            specs = answer if isinstance(answer, list | tuple) else [answer]
            if len(specs) > _MOST_PLUGINS:
                reason = f"codecbench_{kind}s offers {len(specs):,} plugins; at most {_MOST_PLUGINS:,} are taken"
                self._report(origin, point, reason, nameless=True)
                continue
            for spec in specs:
                self._admit_spec(kind, spec, origin, point)
        return bool(hook.get_hookimpls())

    def _admit_spec(self, kind: Kind, spec: object, origin: str, point: EntryPoint) -> None:
        if not isinstance(spec, PluginSpec):
            self._report(origin, point, f"codecbench_{kind}s returned {spec!r}; it returns a list of PluginSpec")
        elif (wrong := fault_of(kind, spec)) is not None:
            self._report(origin, point, wrong)
        else:
            self._take(Plugin(kind, spec, origin), point.name)

    def _take(self, plugin: Plugin, entry_point: str) -> None:
        kind, name = plugin.kind, plugin.spec.name
        if (kind, name) in self._plugins:
            owner = self._plugins[kind, name].distribution
            reason = f"{kind} {name!r} is already offered by {owner}; left out"
            self.problems.append(Problem(plugin.distribution, entry_point, reason))
        else:
            self._plugins[kind, name] = plugin
            self._entry_points[kind, name] = entry_point

    def _report(self, origin: str, point: EntryPoint, reason: str, nameless: bool = False) -> None:
        self.problems.append(Problem(origin, point.name, reason, nameless))


@functools.cache
def installed() -> Registry:
    """The registry of everything installed, read once a process; other distributions' plugins are imported in hosts."""
    points = points_by_origin()
    ours = points.pop(OURS, ())
    return Registry(ours, hosted={} if HOSTED_VARIABLE in os.environ else points)


@functools.cache
def own_registry() -> Registry:
    """The registry of codecbench's own plugins, read once a process."""
    return Registry(points_by_origin().get(OURS, ()))


def everything() -> Registry:
    """The registry of all that is installed, imported into this process: for who develops a plugin."""
    return Registry(point for points in points_by_origin().values() for point in points)


def loads(registry: Registry, kind: Kind, name: str) -> bool:
    """That a plugin's module imports and keeps the contract, found out where it is asked. Raises like `load`."""
    registry.load(kind, name)
    return True


def _hook_names(module: ModuleType) -> set[str]:
    return {
        name
        for name, value in vars(module).items()
        if name.startswith(f"{hooks.GROUP}_") and hasattr(value, f"{hooks.GROUP}_impl")
    }
