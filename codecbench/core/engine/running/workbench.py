"""What a worker has at hand: plugins of the right version, opened sequences, frames, its own description."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterable
from dataclasses import replace
from typing import Any, Final

from codecbench.core.contracts.errors import DatasetError, PluginError
from codecbench.core.contracts.evaluator import PluginUse
from codecbench.core.contracts.executor import PATHS_VARIABLE
from codecbench.core.contracts.hooks import Kind
from codecbench.core.contracts.sequence import FrameSequence
from codecbench.core.engine.environment import describe_environment, environment_id
from codecbench.core.engine.planning.model import PluginSetting, SequenceEntry
from codecbench.core.engine.plugin_code import code_label, code_of
from codecbench.core.engine.registry import Registry, registry_of
from codecbench.core.engine.running.coding.decoding import SharedPictures
from codecbench.core.engine.running.frame_cache import CachedSequence, FrameCache
from codecbench.core.engine.running.sentinel import Sentinel, Tampering
from codecbench.core.engine.storage.bitstream_file import BitstreamFile

_OPEN_SEQUENCES: Final = 4


class Workbench:
    """What a worker keeps between tasks. Plugins of other distributions come with `join`."""

    def __init__(self) -> None:
        self._company: tuple[str, ...] = ()
        self.registry = registry_of(())
        self.environment_description = describe_environment()
        self.environment = environment_id(self.environment_description)
        self._sentinel: Sentinel | None = None
        self._cache = FrameCache()
        self._pictures = SharedPictures(0)
        self._sequences: dict[str, FrameSequence] = {}
        self._code: dict[str, str] = {}

    def join(self, company: tuple[str, ...]) -> None:
        """Import what these distributions offer; an executor gives a worker the tasks of one company only."""
        if company == self._company:
            return
        if company and self._sentinel is None:
            self._sentinel = Sentinel(self.registry)
        self.registry, self._company = registry_of(company), company
        self._code.clear()

    def check(self, company: tuple[str, ...]) -> None:
        """Raise Tampering where the company's code changed what this process computes with."""
        if company and self._sentinel is not None:
            self._sentinel.check(company)

    def is_sound(self, company: tuple[str, ...]) -> bool:
        """Whether `check` finds nothing; where memory is too full to look, that is not known, and so it is not."""
        try:
            self.check(company)
        except (Tampering, MemoryError):
            return False
        return True

    def code(self, settings: Iterable[PluginSetting]) -> dict[str, str]:
        """The code of these plugins by label, as it was before this process first imported any of it."""
        found = {}
        for setting in settings:
            label = code_label(setting.kind, setting.name)
            if label not in self._code:
                self._code[label] = code_of(self.registry.find(setting.kind, setting.name))
            found[label] = self._code[label]
        return {label: fingerprint for label, fingerprint in found.items() if fingerprint}

    def create(self, setting: PluginSetting) -> Any:
        """The plugin of a setting. Raises PluginError where another version of it is installed here."""
        instance = self.registry.create(setting.kind, setting.name, setting.params)
        if instance.version != setting.version:
            message = f"{setting.kind} {setting.name} is version {instance.version} on {platform.node()}"
            raise PluginError(f"{message} and {setting.version} in the plan; install the same version everywhere")
        return instance

    def sequence(self, entry: SequenceEntry, cache_bytes: int) -> FrameSequence:
        """The sequence, opened once, with frames kept up to `cache_bytes`.

        Raises DatasetError where it is no longer the one that was planned.
        """
        source = self._sequences.pop(entry.fingerprint, None)
        if source is None:
            source = self.create(replace(entry.dataset, params=_located(entry.dataset.params))).open()
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


class DeclaredPlugins:
    """Creates the plugins that an evaluator declared in `uses`, and no others: they are in the cell's identity."""

    def __init__(self, registry: Registry, uses: tuple[PluginUse, ...]) -> None:
        self._registry = registry
        self._declared = {(use.kind, use.name) for use in uses}

    def create(self, kind: Kind, name: str, params: dict[str, Any]) -> Any:
        if (kind, name) not in self._declared:
            raise PluginError(f"{kind} {name!r} is used but not declared; list it in the evaluator's `uses`")
        return self._registry.create(kind, name, params)


def _located(params: dict[str, Any]) -> dict[str, Any]:
    """Parameters with paths as this machine knows them."""
    pairs = [pair.split("=", 1) for pair in os.environ.get(PATHS_VARIABLE, "").split(os.pathsep) if "=" in pair]

    def located(value: Any) -> Any:
        for there, here in pairs:
            if isinstance(value, str) and (value == there or value.startswith(there.rstrip("/") + "/")):
                return here.rstrip("/") + value[len(there.rstrip("/")) :]
        return value

    return {name: located(value) for name, value in params.items()}
