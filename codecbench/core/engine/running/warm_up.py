"""Kernels compiled ahead, in the workers of a run: those that its cells will call and the cache does not have.

What cannot be compiled ahead, for whatever reason, is compiled when it is first called.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

from codecbench.core.contracts.confinement import confines
from codecbench.core.contracts.errors import CodecbenchError
from codecbench.core.contracts.executor import Executor, Finished, Task
from codecbench.core.contracts.hooks import KINDS, Kind
from codecbench.core.engine.planning.model import Cell, PluginSetting
from codecbench.core.engine.registry import Registry

if TYPE_CHECKING:
    from codecbench.core.kernels.manifest import Entry

log = logging.getLogger("codecbench.run")

_Call: TypeAlias = tuple[Kind, str, str]
"""Kind and name of a plugin, and a package or module whose kernels it calls."""


class WarmUp:
    """Kernels that are not in the cache: those that coding calls, which come first, and those of evaluators.

    Those that only longer work comes to are compiled once all others are, beside the first cells. companies: the
    distributions that are imported to compile them. out: a folder that gets a copy of what is compiled.
    """

    def __init__(
        self,
        coding: Iterable[Entry] = (),
        evaluating: Iterable[Entry] = (),
        companies: Mapping[Entry, tuple[str, ...]] | None = None,
        out: Path | None = None,
    ) -> None:
        wanted = {True: list(coding), False: list(evaluating)}
        self._coding, self._evaluating = ([entry for entry in wanted[c] if entry.stage == 0] for c in (True, False))
        self._later = [entry for entries in wanted.values() for entry in entries if entry.stage > 0]
        self._companies, self._out = companies or {}, out
        self._under_way: dict[str, Entry] = {}
        self._executor: Executor[Any] | None = None
        self.total = len(self._coding) + len(self._evaluating) + len(self._later)
        self.done = self.failed = 0

    def __len__(self) -> int:
        return self.total - self.done

    @property
    def seconds(self) -> float:
        """What compiling them takes one worker, as it did where their lists were made."""
        return sum(entry.seconds for entry in (*self._coding, *self._evaluating, *self._later))

    @property
    def progress(self) -> str:
        """How far it is, for people; empty once it is over."""
        return f"compiling kernels, once: {self.done} of {self.total}" if self.done < self.total else ""

    def begin(self, executor: Executor[Any], meanwhile: Callable[[], None] = lambda: None) -> None:
        """Submit what comes first; `meanwhile` submits the work that waits for no more than the kernels of coding."""
        self._executor = executor
        self._submit(self._coding)
        meanwhile()
        self._submit(self._evaluating)
        self._submit_later()

    def took(self, finished: Finished) -> bool:
        """Whether a task that has ended was one of these. However it ended, the run goes on."""
        entry = self._under_way.pop(finished.task_id, None)
        if entry is None:
            return False
        self.done += 1
        if finished.status != "ok":
            self.failed += 1
            log.warning("%s is compiled at its first call: %s", entry.kernel, finished.reason)
        self._submit_later()
        return True

    def _submit_later(self) -> None:
        if not self._under_way and self._later:
            later, self._later = self._later, []
            self._submit(later)

    def _submit(self, entries: list[Entry]) -> None:
        """Earlier stages first, and of one stage the largest: no worker is left alone with a large one at the end."""
        assert self._executor is not None
        for entry in sorted(entries, key=lambda entry: (entry.stage, -entry.seconds)):
            id_ = f"kernel {entry.kernel} {entry.build} {entry.arguments}"
            self._under_way[id_] = entry
            company = self._companies.get(entry, ())
            work = entry, self._out
            self._executor.submit(Task(id_, compile_entry, work, company=company, confined=confines(company)))


def compile_entry(work: tuple[Entry, Path | None]) -> None:
    """Compile a kernel into the cache, and copy it into a folder where there is one."""
    entry, out = work
    entry.compile()
    if out is not None:
        entry.copy_to(out)


def kernels_to_compile(cells: Iterable[Cell], registry: Registry, out: Path | None = None) -> WarmUp:
    """What the cells will call and the cache does not have; with `out` all that they will call."""
    by_setting = {(cell.sequence.dataset, cell.codec, cell.evaluator): cell for cell in cells}
    coding: dict[_Call, None] = {}
    counted: dict[_Call, None] = {}
    evaluating: dict[_Call, None] = {}
    descriptions: dict[PluginSetting, dict[str, Any]] = {}

    def calls(setting: PluginSetting) -> dict[_Call, None]:
        if setting not in descriptions:
            descriptions[setting] = _description(registry, setting.kind, setting.name, setting.params)
        return {(setting.kind, setting.name, kernels): None for kernels in descriptions[setting]["kernels"]}

    for cell in by_setting.values():
        coding |= calls(cell.sequence.dataset) | calls(cell.codec)
        for plugin in (cell.evaluator, *cell.evaluator.uses):
            evaluating |= calls(plugin)
        if descriptions[cell.evaluator]["counts"]:
            counted |= calls(cell.codec)
    kept = out is not None
    first = missing(registry, coding, "fast", kept=kept)
    counting = missing(registry, counted, "counting", kept=kept)
    evaluated = missing(registry, evaluating, "fast", kept=kept)
    later = [entry for entry in evaluated if entry not in first]
    return WarmUp([*first], [*counting, *later], companies={**evaluated, **counting, **first}, out=out)


def all_kernels(registry: Registry, out: Path | None = None) -> WarmUp:
    """What any installed plugin may call and the cache does not have; with `out` all that they may call."""
    names: dict[_Call, None] = {}
    for plugin in (plugin for kind in KINDS for plugin in registry.plugins(kind)):
        asked = plugin.kind, plugin.spec.name
        names |= {(*asked, kernels): None for kernels in _description(registry, *asked)["kernels"]}
    entries = missing(registry, names, "fast", "counting", kept=out is not None)
    return WarmUp([*entries], companies=entries, out=out)


def missing(
    registry: Registry, calls: Collection[_Call], *builds: str, kept: bool = False
) -> dict[Entry, tuple[str, ...]]:
    """The listed kernels of packages and modules, in these builds, that the cache does not have, with their company.

    kept: also those that it has.
    """
    if not calls:
        return {}
    from codecbench.core.kernels.manifest import Entry  # loads numba, which a plan without kernels has no need of

    by_plugin: dict[tuple[Kind, str], list[str]] = {}
    for kind, name, kernels in calls:
        by_plugin.setdefault((kind, name), []).append(kernels)
    entries: dict[Entry, tuple[str, ...]] = {}
    for asked, names in by_plugin.items():
        company = registry.find(*asked).company
        try:
            answer = registry.ask(entries_missing, names, builds, kept, of=[asked])
        except CodecbenchError as error:
            log.warning("%s", error)
            continue
        for problem in answer["problems"]:
            log.warning("%s", problem)
        found = [Entry(**values) for values in answer["entries"]]
        entries |= {e: (company,) if company and not e.kernel.startswith("codecbench.") else () for e in found}
    return entries


def kernels_called(registry: Registry, kind: Kind, name: str, params: dict[str, Any] | None) -> dict[str, Any]:
    """`kernels`, the packages and modules that a setting names, and `counts`, whether it runs counting builds.

    params: None where the class alone is asked.
    """
    plugin = registry.load(kind, name) if params is None else registry.create(kind, name, params)
    counts = params is not None and bool(getattr(plugin, "counts_operations", False))
    return {"kernels": [str(kernels) for kernels in getattr(plugin, "kernels", ())], "counts": counts}


def entries_missing(_: Registry, names: list[str], builds: list[str], kept: bool) -> dict[str, Any]:
    """As JSON types: `entries` of manifests for these packages that the cache does not have, and `problems`.

    kept: also entries that the cache has.
    """
    from codecbench.core.kernels.manifest import ManifestError, listed

    entries: dict[Entry, None] = {}
    problems: list[str] = []
    for name in names:
        try:
            entries |= dict.fromkeys(e for e in listed(name) if e.build in builds and (not e.is_kept() or kept))
        except ManifestError as error:
            problems.append(str(error))
    return {"entries": [asdict(entry) for entry in entries], "problems": problems}


def _description(registry: Registry, kind: Kind, name: str, params: dict[str, Any] | None = None) -> dict[str, Any]:
    """What `kernels_called` says; nothing, with a line in the log, where the plugin cannot be asked."""
    try:
        found: dict[str, Any] = registry.ask(kernels_called, kind, name, params, of=[(kind, name)])
    except CodecbenchError as error:
        log.info("%s", error)
        return {"kernels": [], "counts": False}
    return found
