"""Kernels compiled ahead, in the workers of a run: those that its cells will call and the cache does not have.

What cannot be compiled ahead, for whatever reason, is compiled when it is first called.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from typing import Any

from codecbench.core.contracts.errors import PluginError, Unsupported
from codecbench.core.contracts.executor import Executor, Finished, Task
from codecbench.core.contracts.hooks import KINDS
from codecbench.core.engine.planning.model import Cell
from codecbench.core.engine.registry import Registry
from codecbench.core.kernels.manifest import Entry, ManifestError, listed

log = logging.getLogger("codecbench.run")


class WarmUp:
    """Kernels that are not in the cache: those that coding calls, which come first, and those of evaluators.

    Those that only longer work comes to are compiled once all others are, beside the first cells.
    """

    def __init__(self, coding: Iterable[Entry] = (), evaluating: Iterable[Entry] = ()) -> None:
        wanted = {True: list(coding), False: list(evaluating)}
        self._coding, self._evaluating = ([entry for entry in wanted[c] if entry.stage == 0] for c in (True, False))
        self._later = [entry for entries in wanted.values() for entry in entries if entry.stage > 0]
        self._under_way: dict[str, Entry] = {}
        self._executor: Executor[Any] | None = None
        self.total = len(self._coding) + len(self._evaluating) + len(self._later)
        self.done = self.failed = 0

    def __len__(self) -> int:
        return self.total - self.done

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
            self._executor.submit(Task(id_, compile_entry, entry))


def compile_entry(entry: Entry) -> None:
    """Compile a kernel into the cache."""
    entry.compile()


def kernels_to_compile(cells: Iterable[Cell], registry: Registry) -> WarmUp:
    """What the cells will call and the cache does not have."""
    by_setting = {(cell.sequence.dataset, cell.codec, cell.evaluator): cell for cell in cells}
    coding: dict[str, None] = {}
    counted: dict[str, None] = {}
    evaluating: dict[str, None] = {}
    for cell in by_setting.values():
        codec = registry.load("codec", cell.codec.name)
        evaluator = registry.create("evaluator", cell.evaluator.name, cell.evaluator.params)
        used = [registry.load(use.kind, use.name) for use in evaluator.uses]
        coding |= dict.fromkeys((*registry.load("dataset", cell.sequence.dataset.name).kernels, *codec.kernels))
        evaluating |= dict.fromkeys(name for plugin in (evaluator, *used) for name in getattr(plugin, "kernels", ()))
        if evaluator.counts_operations:
            counted |= dict.fromkeys(codec.kernels)
    first = missing(coding, "fast")
    counting = missing(counted, "counting")
    later = [entry for entry in missing(evaluating, "fast") if entry not in first]
    return WarmUp(first, [*counting, *later])


def all_kernels(registry: Registry) -> WarmUp:
    """What any installed plugin may call and the cache does not have."""
    names: dict[str, None] = {}
    for plugin in (plugin for kind in KINDS for plugin in registry.plugins(kind)):
        try:
            names |= dict.fromkeys(getattr(registry.load(plugin.kind, plugin.spec.name), "kernels", ()))
        except (Unsupported, PluginError) as error:
            log.info("%s", error)
    return WarmUp(missing(names, "fast", "counting"))


def missing(names: Iterable[str], *builds: str) -> list[Entry]:
    """The listed kernels of packages and modules, in these builds, that the cache does not have."""
    entries: dict[Entry, None] = {}
    for name in names:
        try:
            entries |= dict.fromkeys(e for e in listed(name) if e.build in builds and not e.is_kept())
        except ManifestError as error:
            log.warning("%s", error)
    return list(entries)
