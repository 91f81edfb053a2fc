"""Kernels compiled ahead, in the workers of a run: those that its cells will call and the cache does not have.

What cannot be compiled ahead, for whatever reason, is compiled when it is first called.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

from codecbench.core.contracts.errors import PluginError, Unsupported
from codecbench.core.contracts.executor import Executor, Finished, Task
from codecbench.core.contracts.hooks import KINDS
from codecbench.core.engine.planning.model import Cell
from codecbench.core.engine.registry import Registry
from codecbench.core.kernels.manifest import Entry, ManifestError, listed

log = logging.getLogger("codecbench.run")


@dataclass
class WarmUp:
    """Kernels that are not in the cache: those that coding calls, which come first, and those of evaluators."""

    coding: list[Entry] = field(default_factory=list)
    evaluating: list[Entry] = field(default_factory=list)
    total: int = 0
    done: int = 0
    failed: int = 0
    _under_way: dict[str, Entry] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.coding) + len(self.evaluating)

    @property
    def progress(self) -> str:
        """How far it is, for people; empty once it is over."""
        return f"compiling kernels, once: {self.done} of {self.total}" if self.done < self.total else ""

    def begin(self, executor: Executor[Any], meanwhile: Callable[[], None] = lambda: None) -> None:
        """Submit everything; `meanwhile` submits the work that waits for no more than the kernels of coding."""
        self.total = len(self)
        self._submit(executor, self.coding)
        meanwhile()
        self._submit(executor, self.evaluating)

    def took(self, finished: Finished) -> bool:
        """Whether a task that has ended was one of these. However it ended, the run goes on."""
        entry = self._under_way.pop(finished.task_id, None)
        if entry is None:
            return False
        self.done += 1
        if finished.status != "ok":
            self.failed += 1
            log.warning("%s is compiled at its first call: %s", entry.kernel, finished.reason)
        return True

    def _submit(self, executor: Executor[Any], entries: list[Entry]) -> None:
        """Largest first, so that no worker is left alone with a large one at the end."""
        for entry in sorted(entries, key=lambda entry: -entry.seconds):
            id_ = f"kernel {entry.kernel} {entry.build} {entry.arguments}"
            self._under_way[id_] = entry
            executor.submit(Task(id_, compile_entry, entry))


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
