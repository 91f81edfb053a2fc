"""What a worker has at hand: plugins of the right version, opened sequences, frames, its own description."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import Any, Final

from codecbench.core.contracts.errors import DatasetError, PluginError
from codecbench.core.contracts.executor import PATHS_VARIABLE
from codecbench.core.contracts.hooks import Kind
from codecbench.core.contracts.sequence import FrameSequence
from codecbench.core.engine.hosting.remote import Remote
from codecbench.core.engine.planning.model import Cell, SequenceEntry
from codecbench.core.engine.plugins.registry import Registry, own
from codecbench.core.engine.running.coding.decoding import SharedPictures
from codecbench.core.engine.running.frame_cache import CachedSequence, FrameCache
from codecbench.core.engine.running.plugins import Plugins
from codecbench.core.engine.storage.bitstream_file import BitstreamFile
from codecbench.core.engine.storage.environment import describe_environment, environment_id

_OPEN_SEQUENCES: Final = 4


class Workbench(Plugins):
    """What a worker keeps between tasks. limit_s, registry: see `Plugins`."""

    def __init__(self, limit_s: Callable[[], float] | None = None, registry: Registry | None = None) -> None:
        super().__init__(registry or own(), limit_s)
        self._cache = FrameCache()
        self._pictures = SharedPictures(0)
        self._sequences: dict[str, FrameSequence] = {}

    @cached_property
    def environment_description(self) -> dict[str, Any]:
        """What this process computes on."""
        return describe_environment()

    @cached_property
    def environment(self) -> str:
        """The id of that."""
        return environment_id(self.environment_description)

    def sequence(self, entry: SequenceEntry, cache_bytes: int) -> FrameSequence:
        """The sequence, opened once, with frames kept up to `cache_bytes`.

        Raises DatasetError where it is no longer the one that was planned.
        """
        source = self._sequences.pop(entry.fingerprint, None)
        if source is None:
            setting = replace(entry.dataset, params=_located(entry.dataset.params))
            source = self.create(setting, entry.fingerprint)
            if not self.is_hosted(setting):
                source = source.open()
            if source.fingerprint != entry.fingerprint or len(source) != entry.frames:
                raise DatasetError(f"{entry.name} has changed since the plan was made; run the matrix again")
        self._sequences[entry.fingerprint] = source
        while len(self._sequences) > _OPEN_SEQUENCES:
            del self._sequences[next(iter(self._sequences))]
        self._cache.limit_bytes = cache_bytes
        return CachedSequence(source, entry.name, self._cache)

    def pictures(self, bitstreams: BitstreamFile, cache_bytes: int) -> SharedPictures:
        """What was decoded here of these bitstreams, with room for half of what frames may take."""
        return self._pictures.of(bitstreams.digest, cache_bytes // 2)

    def tidy(self, job_id: str = "") -> None:
        """End the hosts that served a piece of work; those of the sequences that are open stay, and of a coding job."""
        self.end(kept={*self._sequences, job_id})
        reading = {of for _, _, of in self._hosts}
        for entry in [entry for entry, source in self._sequences.items() if isinstance(source, Remote)]:
            if entry not in reading:  # its host has died
                del self._sequences[entry]


class DeclaredPlugins:
    """Creates the plugins that an evaluator declared in `uses`, and no others: they are in the cell's identity."""

    def __init__(self, plugins: Plugins, cell: Cell) -> None:
        self._plugins, self._cell = plugins, cell
        self._declared = {(use.kind, use.name): use for use in cell.evaluator.uses}

    def create(self, kind: Kind, name: str, params: dict[str, Any]) -> Any:
        use = self._declared.get((kind, name))
        if use is None:
            raise PluginError(f"{kind} {name!r} is used but not declared; list it in the evaluator's `uses`")
        if self._plugins.is_hosted(use):
            return self._plugins.create(replace(use, params=params), self._cell.id, self._cell.seed)
        return self._plugins.registry.create(kind, name, params)


def _located(params: dict[str, Any]) -> dict[str, Any]:
    """Parameters with paths as this machine knows them."""
    pairs = [pair.split("=", 1) for pair in os.environ.get(PATHS_VARIABLE, "").split(os.pathsep) if "=" in pair]

    def located(value: Any) -> Any:
        for there, here in pairs:
            if isinstance(value, str) and (value == there or value.startswith(there.rstrip("/") + "/")):
                return here.rstrip("/") + value[len(there.rstrip("/")) :]
        return value

    return {name: located(value) for name, value in params.items()}
