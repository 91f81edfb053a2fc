"""What a worker keeps at hand: plugins of the right version, open sequences, frames, its own description."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cached_property
from typing import Any, Final

from codecbench.core.contracts.errors import DatasetError, PluginError
from codecbench.core.contracts.executor import PATHS_VARIABLE
from codecbench.core.contracts.hooks import Kind
from codecbench.core.contracts.sequence import FrameSequence
from codecbench.core.engine.hosting.confinement import paths_in
from codecbench.core.engine.hosting.host import Host, Role
from codecbench.core.engine.hosting.remote import Remote, RemoteCodec
from codecbench.core.engine.planning.model import Cell, PluginSetting, SequenceEntry
from codecbench.core.engine.plugins.fingerprint import code_label, code_of
from codecbench.core.engine.plugins.registry import Registry, own_registry
from codecbench.core.engine.running.coding.decoding import SharedPictures
from codecbench.core.engine.running.frame_cache import CachedSequence, FrameCache
from codecbench.core.engine.storage.bitstream_file import BitstreamFile
from codecbench.core.engine.storage.environment import describe_environment, environment_id

_CREATED = "codecbench.core.engine.plugins.serving:create_plugin"
_ROLES: dict[str, Role] = {"dataset": "read", "codec": "decode"}
"""Role in which a plugin of a kind is created; all others evaluate."""


class PluginFactory:
    """Creates plugins from their settings: codecbench's own in this process, all others in hosts.

    registry: of codecbench's own plugins. limit_s: of hosts, see `Host`; None in workers, which are watched themselves
    and accept only plugins of the planned version. hosts_none: all plugins are created here, from `registry`.
    """

    hosts_none = False

    def __init__(self, registry: Registry, limit_s: Callable[[], float] | None = None) -> None:
        self.registry, self._limit_s = registry, limit_s
        self._hosts: dict[tuple[str, Role, str], Host] = {}
        self._code: dict[str, str] = {}

    def host(self, distribution: str, role: Role, of: str) -> Host:
        """Return a host that serves only `of`: the id of a piece of work, or a sequence's fingerprint."""
        return self._hosts.setdefault(
            (distribution, role, of), Host(distribution, role, self._limit_s, prints=self._limit_s is None)
        )

    def create(self, setting: PluginSetting, of: str, seed: int = 0, role: Role | None = None) -> Any:
        """Create the plugin of a setting; for a dataset in a host, return its open sequence.

        of, seed: see `host` and `serving.create_plugin`. role: in which a codec is created first.

        Raises PluginError if another version of it is installed here, and whatever its constructor raises.
        """
        if not self.is_hosted(setting):
            instance = self.registry.create(setting.kind, setting.name, setting.params)
            self.check(setting, instance.version)
            return instance
        role = role or _ROLES.get(setting.kind, "evaluate")
        remote_plugin = self._create_in_host(setting, role, of, seed)
        if setting.kind != "codec":
            return remote_plugin
        codecs = {role: remote_plugin}

        def codec_in(role: Role) -> Callable[[], Any]:
            return lambda: (
                codecs[role]
                if role in codecs
                else codecs.setdefault(role, self._create_in_host(setting, role, of, seed))
            )

        channel, number = remote_plugin.place
        return RemoteCodec(
            channel, number, setting.kind, remote_plugin.facts, encoding=codec_in("encode"), decoding=codec_in("decode")
        )

    def is_hosted(self, setting: PluginSetting) -> bool:
        """Whether the plugin of a setting is created in a host."""
        return bool(setting.distribution) and not self.hosts_none

    def code(self, settings: Iterable[PluginSetting]) -> dict[str, str]:
        """Return the code of the plugins created so far, by label, as it was before any of it was imported."""
        codes = {}
        for setting in settings:
            label = code_label(setting.kind, setting.name)
            if not self.is_hosted(setting) and label not in self._code:
                self._code[label] = code_of(self.registry.find(setting.kind, setting.name))
            codes[label] = self._code.get(label, "")
        return {label: fingerprint for label, fingerprint in codes.items() if fingerprint}

    def end(self, kept_ids: Iterable[str] = ()) -> None:
        """End the hosts, except those that serve one of `kept_ids`."""
        for key in [key for key, host in self._hosts.items() if key[2] not in kept_ids or not host.lives]:
            self._hosts.pop(key).end()

    def _create_in_host(self, setting: PluginSetting, role: Role, of: str, seed: int) -> Any:
        host = self.host(setting.distribution, role, of)
        shows = paths_in([setting.params]) if setting.kind == "dataset" else ()
        remote_plugin = host.ask(_CREATED, setting.kind, setting.name, setting.params, seed, shows=shows)
        self.check(setting, remote_plugin.facts["of_version"], remote_plugin.facts["code"])
        return remote_plugin

    def check(self, setting: PluginSetting, version: str, code: str = "") -> None:
        """Raise PluginError if a plugin's version is not the planned one. code: of a plugin in a host."""
        if code:
            self._code[code_label(setting.kind, setting.name)] = str(code)
        if self._limit_s is None and version != setting.version:
            message = f"{setting.kind} {setting.name} is version {version} on {platform.node()}"
            raise PluginError(f"{message} and {setting.version} in the plan; install the same version everywhere")


_OPEN_SEQUENCES: Final = 4


class Workbench(PluginFactory):
    """What a worker keeps between tasks. limit_s, registry: see `PluginFactory`."""

    def __init__(self, limit_s: Callable[[], float] | None = None, registry: Registry | None = None) -> None:
        super().__init__(registry or own_registry(), limit_s)
        self._cache = FrameCache()
        self._pictures = SharedPictures(0)
        self._sequences: dict[str, FrameSequence] = {}

    @cached_property
    def environment_description(self) -> dict[str, Any]:
        """Description of what this process computes on."""
        return describe_environment()

    @cached_property
    def environment(self) -> str:
        """Id of that description."""
        return environment_id(self.environment_description)

    def sequence(self, entry: SequenceEntry, cache_bytes: int) -> FrameSequence:
        """Return the sequence, opened once, with frames cached up to `cache_bytes`.

        Raises DatasetError if it is no longer the planned one.
        """
        source = self._sequences.pop(entry.fingerprint, None)
        if source is None:
            setting = replace(entry.dataset, params=_translate_paths(entry.dataset.params))
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
        """Return the shared pictures of these bitstreams, with half the limit of the frame cache."""
        return self._pictures.of(bitstreams.digest, cache_bytes // 2)

    def tidy(self, job_id: str = "") -> None:
        """End the hosts that served a piece of work, except those of open sequences and of a coding job."""
        self.end({*self._sequences, job_id})
        served = {of for _, _, of in self._hosts}
        for entry in [entry for entry, source in self._sequences.items() if isinstance(source, Remote)]:
            if entry not in served:  # its host has died
                del self._sequences[entry]


class DeclaredPlugins:
    """Creates only plugins that an evaluator declared in `uses`, because these are in the cell's identity."""

    def __init__(self, plugins: PluginFactory, cell: Cell) -> None:
        self._plugins, self._cell = plugins, cell
        self._declared = {(use.kind, use.name): use for use in cell.evaluator.uses}

    def create(self, kind: Kind, name: str, params: dict[str, Any]) -> Any:
        use = self._declared.get((kind, name))
        if use is None:
            raise PluginError(f"{kind} {name!r} is used but not declared; list it in the evaluator's `uses`")
        if self._plugins.is_hosted(use):
            return self._plugins.create(replace(use, params=params), self._cell.id, self._cell.seed)
        return self._plugins.registry.create(kind, name, params)


def _translate_paths(params: dict[str, Any]) -> dict[str, Any]:
    """Return parameters with paths translated for this machine."""
    pairs = [pair.split("=", 1) for pair in os.environ.get(PATHS_VARIABLE, "").split(os.pathsep) if "=" in pair]

    def translate(value: Any) -> Any:
        for there, here in pairs:
            if isinstance(value, str) and (value == there or value.startswith(there.rstrip("/") + "/")):
                return here.rstrip("/") + value[len(there.rstrip("/")) :]
        return value

    return {name: translate(value) for name, value in params.items()}
