"""Plugins by their settings: codecbench's own are made in this process, all others in hosts."""

from __future__ import annotations

import platform
from collections.abc import Callable, Iterable
from typing import Any

from codecbench.core.contracts.errors import PluginError
from codecbench.core.engine.hosting.confinement import paths_named
from codecbench.core.engine.hosting.host import Host, Role
from codecbench.core.engine.planning.model import PluginSetting
from codecbench.core.engine.plugins.fingerprint import code_label, code_of
from codecbench.core.engine.plugins.registry import Registry

_CREATED = "codecbench.core.engine.plugins.serving:created"
_ROLES: dict[str, Role] = {"dataset": "read", "codec": "decode"}
"""In which a plugin of a kind is made; all others evaluate."""


class Plugins:
    """What was made of settings, and the hosts that it was made in.

    registry: of codecbench's own plugins. limit_s: of hosts, see `Host`; None in workers, which are watched themselves
    and take plugins of the planned version alone. hosts_none: all plugins are made here, and `registry` has them.
    """

    hosts_none = False

    def __init__(self, registry: Registry, limit_s: Callable[[], float] | None = None) -> None:
        self.registry, self._limit_s = registry, limit_s
        self._hosts: dict[tuple[str, Role, str], Host] = {}
        self._code: dict[str, str] = {}

    def host(self, distribution: str, role: Role, of: str) -> Host:
        """A host that serves nothing but `of`: the id of a piece of work, or a sequence's fingerprint."""
        return self._hosts.setdefault(
            (distribution, role, of), Host(distribution, role, self._limit_s, prints=self._limit_s is None)
        )

    def create(self, setting: PluginSetting, of: str, seed: int = 0, role: Role | None = None) -> Any:
        """The plugin of a setting; of a dataset in a host, the sequence, opened.

        of, seed: see `host` and `serving.created`. role: in which a codec is made first.

        Raises PluginError where another version of it is installed here, and what constructing it raises.
        """
        if not self.is_hosted(setting):
            instance = self.registry.create(setting.kind, setting.name, setting.params)
            self.check(setting, instance.version)
            return instance
        from codecbench.core.engine.hosting.remote import RemoteCodec

        role = role or _ROLES.get(setting.kind, "evaluate")
        made = self._made(setting, role, of, seed)
        if setting.kind != "codec":
            return made
        ends = {role: made}

        def end(role: Role) -> Callable[[], Any]:
            return lambda: ends[role] if role in ends else ends.setdefault(role, self._made(setting, role, of, seed))

        channel, number = made.place
        return RemoteCodec(channel, number, setting.kind, made.facts, encoding=end("encode"), decoding=end("decode"))

    def is_hosted(self, setting: PluginSetting) -> bool:
        """Whether the plugin of a setting is made in a host."""
        return bool(setting.distribution) and not self.hosts_none

    def code(self, settings: Iterable[PluginSetting]) -> dict[str, str]:
        """The code of these plugins by label, as it was before any of it was imported; of those made so far."""
        found = {}
        for setting in settings:
            label = code_label(setting.kind, setting.name)
            if not self.is_hosted(setting) and label not in self._code:
                self._code[label] = code_of(self.registry.find(setting.kind, setting.name))
            found[label] = self._code.get(label, "")
        return {label: fingerprint for label, fingerprint in found.items() if fingerprint}

    def end(self, kept: Iterable[str] = ()) -> None:
        """End the hosts, but those that serve what is named."""
        for key in [key for key, host in self._hosts.items() if key[2] not in kept or not host.lives]:
            self._hosts.pop(key).end()

    def _made(self, setting: PluginSetting, role: Role, of: str, seed: int) -> Any:
        host = self.host(setting.distribution, role, of)
        shows = paths_named([setting.params]) if setting.kind == "dataset" else ()
        made = host.ask(_CREATED, setting.kind, setting.name, setting.params, seed, shows=shows)
        self.check(setting, made.facts["of_version"], made.facts["code"])
        return made

    def check(self, setting: PluginSetting, version: str, code: str = "") -> None:
        """Raise PluginError where a plugin was made in another version than planned. code: of one in a host."""
        if code:
            self._code[code_label(setting.kind, setting.name)] = str(code)
        if self._limit_s is None and version != setting.version:
            message = f"{setting.kind} {setting.name} is version {version} on {platform.node()}"
            raise PluginError(f"{message} and {setting.version} in the plan; install the same version everywhere")
