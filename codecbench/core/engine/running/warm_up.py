"""Compile kernels ahead, in the workers of a run: those that its cells will call and the cache does not have.

A kernel that cannot be compiled ahead is compiled at its first call.
"""

from __future__ import annotations

import functools
import itertools
import logging
import os
from collections.abc import Collection, Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from codecbench.core.contracts.errors import CodecbenchError
from codecbench.core.contracts.executor import Finished, Task
from codecbench.core.contracts.hooks import KINDS, Kind
from codecbench.core.engine.hosting.confinement import VARIABLE, is_confinement_requested
from codecbench.core.engine.hosting.host import Host
from codecbench.core.engine.planning.model import Cell, PluginSetting
from codecbench.core.engine.plugins.registry import Registry

if TYPE_CHECKING:
    from codecbench.core.kernels.manifest import Entry

log = logging.getLogger("codecbench.run")

_Call: TypeAlias = tuple[Kind, str, str]
"""Kind and name of a plugin, and a package, module or function whose kernels it calls."""
_Kernels: TypeAlias = "dict[Entry, str]"
"""Kernels with the distribution of each, empty for codecbench."""


class WarmUp:
    """Kernels that are not in the cache, and the work that waits for them.

    origins: kernels in the order of compilation, with the distribution of each, empty for codecbench. Kernels of a
    later stage, which only longer work reaches, follow when all others are compiled, beside the first cells. needs:
    kernels called by each coding job or cell id. out: a folder that gets a copy of each compiled kernel.
    """

    def __init__(
        self,
        origins: _Kernels | None = None,
        needs: Mapping[str, frozenset[Entry]] | None = None,
        out: Path | None = None,
    ) -> None:
        self._origins, self._needs, self._out = origins or {}, needs or {}, out
        self._waiting = sorted(self._origins, key=lambda entry: entry.stage > 0)
        self._missing = {entry for entry in self._waiting if entry.stage == 0}
        self._under_way: dict[str, Entry] = {}
        self.total = len(self._waiting)
        self.done = self.failed = 0

    def __len__(self) -> int:
        return self.total - self.done

    @property
    def under_way(self) -> int:
        """Number of kernels being compiled."""
        return len(self._under_way)

    @property
    def seconds(self) -> float:
        """Seconds to compile all of them in one worker, as measured when their lists were made."""
        return sum(entry.seconds for entry in self._origins)

    @property
    def progress(self) -> str:
        """Progress in words; empty once it is over."""
        return f"compiling kernels, once: {self.done} of {self.total}" if self.done < self.total else ""

    def is_ready(self, id_: str) -> bool:
        """Whether all kernels that a coding job or cell calls are compiled."""
        return self._missing.isdisjoint(self._needs.get(id_, ()))

    def take(self) -> Task | None:
        """Return what to compile next; None while it has to wait, and at the end."""
        if not self._waiting or (self._waiting[0].stage > 0 and self._under_way):
            return None
        entry = self._waiting.pop(0)
        id_ = f"kernel {entry.kernel} {entry.build} {entry.arguments}"
        self._under_way[id_] = entry
        return Task(id_, compile_entry, (entry, self._out, self._origins[entry], is_confinement_requested()))

    def finish(self, finished: Finished) -> bool:
        """Note the end of a task; return whether it compiled a kernel. The run continues even if that failed."""
        entry = self._under_way.pop(finished.task_id, None)
        if entry is None:
            return False
        self._missing.discard(entry)
        self.done += 1
        if finished.status != "ok":
            self.failed += 1
            log.warning("%s is compiled at its first call: %s", entry.kernel, finished.reason)
        return True


def compile_entry(work: tuple[Entry, Path | str | None, str, bool]) -> None:
    """Compile a kernel into the cache, in a host if it is of others; copy it to a folder if one is given."""
    entry, out, distribution, confines = work
    if distribution:
        os.environ[VARIABLE] = "1" if confines else "0"
        host = Host(distribution, "encode", None, prints=True)
        try:
            return host.ask(compile_entry, (entry, out and str(out), "", confines))  # type: ignore[no-any-return]
        finally:
            host.end()
    entry.compile()
    if out is not None:
        entry.copy_to(Path(out))
    return None


def kernels_to_compile(cells: Iterable[Cell], registry: Registry, out: Path | None = None) -> WarmUp:
    """Return what the cells will call and the cache does not have; with `out` everything that they will call.

    Kernels of sequences come first, then those of one evaluator after another, so that codecs without kernels have
    results early, then those of codecs. Of each the largest come first, so that no worker is left alone with a large
    one.
    """

    @functools.cache
    def declared(setting: PluginSetting) -> tuple[tuple[str, ...], bool]:
        description = _description(registry, setting.kind, setting.name, setting.params)
        return tuple(description["kernels"]), description["counts"]

    @functools.cache
    def listed_for(kind: Kind, name: str, kernels: tuple[str, ...], build: str) -> _Kernels:
        return missing_kernels(
            registry, [(kind, name, kernel) for kernel in kernels], build, include_cached=out is not None
        )

    def kernels_of(*settings: PluginSetting, build: str = "fast") -> _Kernels:
        groups = (listed_for(setting.kind, setting.name, declared(setting)[0], build) for setting in settings)
        return {entry: origin for kernels in groups for entry, origin in kernels.items()}

    cells = list(cells)
    work = {cell.id: (cell.sequence.dataset, cell.codec, cell.evaluator) for cell in cells}
    kernels_by_key = {
        key: (
            kernels_of(key[0]),
            kernels_of(key[2], *key[2].uses),
            kernels_of(key[1]),
            kernels_of(key[1], build="counting") if declared(key[2])[1] else {},
        )
        for key in dict.fromkeys(work.values())
    }
    evaluators = dict.fromkeys(key[2] for key in kernels_by_key)
    ordered = _largest_first(kernels[0] for kernels in kernels_by_key.values())
    for evaluator in evaluators:
        ordered |= _largest_first(kernels[1] for key, kernels in kernels_by_key.items() if key[2] == evaluator)
    ordered |= _largest_first(kernels[2] for kernels in kernels_by_key.values())
    ordered |= _largest_first(kernels[3] for kernels in kernels_by_key.values())
    calls = {key: frozenset(itertools.chain(*kernels)) for key, kernels in kernels_by_key.items()}
    coding = {
        cell.job_id: frozenset(itertools.chain(*kernels_by_key[work[cell.id]][::2])) for cell in cells if cell.job_id
    }
    return WarmUp(ordered, {id_: calls[key] for id_, key in work.items()} | coding, out)


def _largest_first(groups: Iterable[_Kernels]) -> _Kernels:
    entries = {entry: origin for group in groups for entry, origin in group.items()}
    return dict(sorted(entries.items(), key=lambda item: -item[0].seconds))


def all_kernels(registry: Registry, out: Path | None = None) -> WarmUp:
    """Return what any installed plugin may call and the cache does not have; with `out` everything."""
    names: dict[_Call, None] = {}
    for plugin in (plugin for kind in KINDS for plugin in registry.plugins(kind)):
        plugin_key = plugin.kind, plugin.spec.name
        names |= {(*plugin_key, kernels): None for kernels in _description(registry, *plugin_key)["kernels"]}
    return WarmUp(
        _largest_first([missing_kernels(registry, names, "fast", "counting", include_cached=out is not None)]), out=out
    )


def missing_kernels(
    registry: Registry, calls: Collection[_Call], *builds: str, include_cached: bool = False
) -> _Kernels:
    """Return the listed kernels of these calls, in these builds, that the cache does not have.

    include_cached: also those that it has.
    """
    if not calls:
        return {}
    from codecbench.core.kernels.manifest import Entry  # loads numba, which a plan without kernels does not need

    by_plugin: dict[tuple[Kind, str], list[str]] = {}
    for kind, name, kernels in calls:
        by_plugin.setdefault((kind, name), []).append(kernels)
    entries: _Kernels = {}
    for asked, names in by_plugin.items():
        origin = registry.find(*asked).foreign
        try:
            answer = registry.ask(missing_entries, names, builds, include_cached, of=[asked])
        except CodecbenchError as error:
            log.warning("%s", error)
            continue
        for problem in answer["problems"]:
            log.warning("%s", problem)
        missing = [Entry(**values) for values in answer["entries"]]
        entries |= {e: "" if e.kernel.startswith("codecbench.") else origin for e in missing}
    return entries


def declared_kernels(registry: Registry, kind: Kind, name: str, params: dict[str, Any] | None) -> dict[str, Any]:
    """Return `kernels`, the packages and modules that a setting names, and `counts`, whether it runs counting builds.

    params: None to ask the class alone.
    """
    plugin = registry.load(kind, name) if params is None else registry.create(kind, name, params)
    counts = params is not None and bool(getattr(plugin, "counts_operations", False))
    return {"kernels": [str(kernels) for kernels in getattr(plugin, "kernels", ())], "counts": counts}


def missing_entries(_: Registry, names: list[str], builds: list[str], include_cached: bool) -> dict[str, Any]:
    """Return, as JSON types, `entries` of these packages' manifests that the cache does not have, and `problems`.

    include_cached: also entries that it has.
    """
    from codecbench.core.kernels.manifest import ManifestError, entries_of  # loads numba

    entries: dict[Entry, None] = {}
    problems: list[str] = []
    for name in names:
        try:
            entries |= dict.fromkeys(
                e for e in entries_of(name) if e.build in builds and (not e.is_cached() or include_cached)
            )
        except ManifestError as error:
            problems.append(str(error))
    return {"entries": [asdict(entry) for entry in entries], "problems": problems}


def _description(registry: Registry, kind: Kind, name: str, params: dict[str, Any] | None = None) -> dict[str, Any]:
    """Return `declared_kernels` of a plugin; if it cannot be asked, log that and return none."""
    try:
        description: dict[str, Any] = registry.ask(declared_kernels, kind, name, params, of=[(kind, name)])
    except CodecbenchError as error:
        log.info("%s", error)
        return {"kernels": [], "counts": False}
    return description
