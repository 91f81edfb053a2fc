"""The registry of installed plugins: what they are called, and how a name becomes a class.

Listing imports only hook modules, and those of other distributions in host processes. If a distribution fails to
import, exits, hangs, misspells a hook or offers a name that is taken, it is reported by name and version, and nothing
else is affected.
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
from codecbench.core.engine.hosting import HOSTED_VARIABLE, confinement, host
from codecbench.core.engine.plugins import offers
from codecbench.core.engine.plugins.entry_points import origin_of, own_plugins_first, points_by_origin
from codecbench.core.engine.plugins.plugin import OURS, Plugin, Problem, fault_of, kind_title, load_class
from codecbench.core.engine.text import describe_error

_CALLED = "codecbench.core.engine.plugins.serving:call_function"
_AT_ONCE = os.cpu_count() or 1
"""Maximum number of distributions that are asked at once what they offer."""
_MOST_PLUGINS = 1000
"""Maximum number of plugins of one kind from one hook."""
_MOST_LOSSES = 3
"""A plugin is not asked again after it has ended this many hosts, or after one timeout."""


class Registry:
    """All plugins, by kind and name; `problems` lists the rejected ones.

    points: entry points to import into this process. hosted: those of other distributions, whose plugins are imported
    in hosts.
    """

    def __init__(
        self, points: Iterable[EntryPoint], hosted: Mapping[str, list[EntryPoint]] = MappingProxyType({})
    ) -> None:
        self.problems: list[Problem] = []
        self.answers: dict[str, Any] = {}
        """Descriptions of settings by hosted plugins, see `planning.description.describe`."""
        self._plugins: dict[tuple[Kind, str], Plugin] = {}
        self._entry_points: dict[tuple[Kind, str], str] = {}
        self._classes: dict[tuple[Kind, str], Any] = {}
        self._losses: Counter[str] = Counter()
        self._given_up: dict[str, str] = {}
        self._hosts = {origin: host.Host(origin) for origin in hosted}
        offers_by_origin = {origin: offers.cached_offers(origin, hosted[origin]) for origin in sorted(hosted)}
        unknown = [self._hosts[origin] for origin, known in offers_by_origin.items() if known is None]
        for process in unknown[:_AT_ONCE]:
            process.start()  # they start while codecbench's own plugins are read
        for point in sorted(points, key=own_plugins_first):
            self._admit(point)
        if unknown:
            from concurrent.futures import ThreadPoolExecutor  # slow import: some milliseconds

            with ThreadPoolExecutor(_AT_ONCE) as pool:
                origins = [process.distribution for process in unknown]
                new_offers = pool.map(offers.ask_offers, unknown, map(hosted.__getitem__, origins))
                offers_by_origin |= zip(origins, new_offers, strict=True)
        for known in filter(None, offers_by_origin.values()):
            self._admit_hosted(known)
        for origin in self._hosts.keys() - {plugin.distribution for plugin in self._plugins.values()}:
            self._hosts.pop(origin).end()

    def plugins(self, kind: Kind) -> list[Plugin]:
        """Return the plugins of a kind in the order in which they were offered."""
        return [plugin for (of_kind, _), plugin in self._plugins.items() if of_kind == kind]

    def find(self, kind: Kind, name: str) -> Plugin:
        """Return a plugin by name. Raises PluginError with the nearest names if there is none."""
        plugin = self._plugins.get((kind, name))
        if plugin is None:
            raise PluginError(f"no {kind_title(kind)} is called {name!r}; {self.suggestion(kind, name)}")
        return plugin

    def maybe_broken(self, kind: Kind, name: str) -> str | None:
        """Explain an unknown name that may belong to a distribution whose names are unknown; otherwise None."""
        nameless = [str(problem) for problem in self.problems if problem.nameless]
        names = [plugin.spec.name for plugin in self.plugins(kind)]
        if not nameless or difflib.get_close_matches(name, names, n=1):
            return None
        return f"no {kind_title(kind)} is called {name!r}; it may belong to {'; or to '.join(nameless)}"

    def suggestion(self, kind: Kind, name: str) -> str:
        """Return what the writer of an unknown name may have meant."""
        names = [plugin.spec.name for plugin in self.plugins(kind)]
        nearest = difflib.get_close_matches(name, names, n=1)
        hint = f"did you mean {nearest[0]!r}? " if nearest else ""
        return f"{hint}installed: {', '.join(names) or 'none'}"

    def load(self, kind: Kind, name: str) -> Any:
        """Import the class behind a name into this process; for other distributions' plugins see `ask`.

        Raises PluginError if there is no such plugin, its module fails to import or it violates its contract. Raises
        Unsupported, with the command to install it, if a requirement is missing.
        """
        plugin = self.find(kind, name)
        if (missing := plugin.missing) is not None:
            raise Unsupported(missing)
        if (kind, name) not in self._classes:
            self._classes[kind, name] = load_class(kind, plugin.spec, plugin.title)
        return self._classes[kind, name]

    def create(self, kind: Kind, name: str, params: dict[str, Any]) -> Any:
        """Create an instance with these parameters, which are validated (pydantic.ValidationError)."""
        cls = self.load(kind, name)
        return cls(cls.params_type.model_validate(params))

    def entry_point(self, plugin: Plugin) -> str:
        """Return the name of the entry point that offered a plugin."""
        return self._entry_points[plugin.kind, plugin.spec.name]

    def ask(
        self, function: Callable[..., Any], *arguments: Any, of: Sequence[tuple[Kind, str]], times: float = 1
    ) -> Any:
        """Return `function(registry, *arguments)`, JSON types, for this plugin.

        For another distribution's plugin it is called in a host process and may take `times` the usual limit. Raises
        what the function raises, and PluginFault, which names the plugin, if a hosted one fails otherwise.
        """
        ((kind, name),) = of
        plugin = self.find(kind, name)
        if not plugin.hosted:
            return function(self, *arguments)
        title = plugin.title
        if title in self._given_up:
            raise host.PluginFault(self._given_up[title])
        qualified_name = f"{function.__module__}:{function.__qualname__}"
        try:
            shows = confinement.paths_in(arguments) if kind == "dataset" else ()
            return self._hosts[plugin.distribution].ask(_CALLED, qualified_name, *arguments, times=times, shows=shows)
        except host.PluginFault as fault:
            text = str(fault)
            message = " ".join((text if title in text else f"{title}: {text}").split())
            if isinstance(fault, host.PluginLoss):
                self._losses[title] += _MOST_LOSSES if isinstance(fault, host.PluginTimeout) else 1
            if self._losses[title] >= _MOST_LOSSES:
                self._given_up[title] = message
            raise host.PluginFault(message) from fault

    def _admit_hosted(self, known: offers.Offers) -> None:
        self.problems += known.problems
        for plugin, entry_point in known.plugins:
            self._take(plugin, entry_point)

    def _admit(self, point: EntryPoint) -> None:
        origin = origin_of(point)
        try:
            module = importlib.import_module(point.module)
        except Exception as error:  # noqa: BLE001 - foreign modules may raise anything
            reason = f"{point.module} does not import: {describe_error(error)}"
            self._report(origin, point, reason, nameless=True)
            return
        manager = pluggy.PluginManager(hooks.GROUP)
        manager.add_hookspecs(hooks)
        manager.register(module)
        has_hooks = False
        for kind in KINDS:
            has_hooks |= self._admit_kind(manager, kind, origin, point)
        hook_names = {f"codecbench_{kind}s" for kind in KINDS}
        for name in sorted(_hook_names(module) - hook_names):
            nearest = difflib.get_close_matches(name, hook_names, n=1)
            hint = f"; did you mean {nearest[0]}?" if nearest else ""
            self._report(origin, point, f"{point.module} implements {name}, which is not a hook{hint}")
            has_hooks = True
        if not has_hooks:
            self._report(origin, point, f"{point.module} implements no hook; known: {', '.join(sorted(hook_names))}")

    def _admit_kind(self, manager: pluggy.PluginManager, kind: Kind, origin: str, point: EntryPoint) -> bool:
        hook = getattr(manager.hook, f"codecbench_{kind}s")
        try:
            answers = hook()
        except Exception as error:  # noqa: BLE001 - foreign hooks may raise anything
            self._report(origin, point, f"codecbench_{kind}s failed: {describe_error(error)}", nameless=True)
            return True
        for answer in answers:
            specs = answer if isinstance(answer, list | tuple) else [answer]
            if len(specs) > _MOST_PLUGINS:
                reason = f"codecbench_{kind}s offers {len(specs):,} plugins; at most {_MOST_PLUGINS:,} are allowed"
                self._report(origin, point, reason, nameless=True)
                continue
            for spec in specs:
                self._admit_spec(kind, spec, origin, point)
        return bool(hook.get_hookimpls())

    def _admit_spec(self, kind: Kind, spec: object, origin: str, point: EntryPoint) -> None:
        if not isinstance(spec, PluginSpec):
            self._report(origin, point, f"codecbench_{kind}s returned {spec!r}; it must return a list of PluginSpec")
        elif (fault := fault_of(kind, spec)) is not None:
            self._report(origin, point, fault)
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
    """Return the registry of everything installed, cached; other distributions' plugins are imported in hosts."""
    points = points_by_origin()
    ours = points.pop(OURS, ())
    return Registry(ours, hosted={} if HOSTED_VARIABLE in os.environ else points)


@functools.cache
def own_registry() -> Registry:
    """Return the registry of codecbench's own plugins, cached."""
    return Registry(points_by_origin().get(OURS, ()))


def everything() -> Registry:
    """Return a registry that imports all installed plugins into this process: for plugin developers."""
    return Registry(point for points in points_by_origin().values() for point in points)


def loads(registry: Registry, kind: Kind, name: str) -> bool:
    """Return True if a plugin's module imports and meets its contract. Raises like `load`."""
    registry.load(kind, name)
    return True


def _hook_names(module: ModuleType) -> set[str]:
    return {
        name
        for name, value in vars(module).items()
        if name.startswith(f"{hooks.GROUP}_") and hasattr(value, f"{hooks.GROUP}_impl")
    }
